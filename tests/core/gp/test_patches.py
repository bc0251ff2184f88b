"""Patches are as dense as they may be, as wide as they must be, and everywhere."""

import numpy as np
import pytest

from gpgrad_core.gp.patches import PATCH_POINTS, draw_patches

SIZE = 10.0


@pytest.fixture(scope="module")
def xy() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, SIZE, (20_000, 2))


def draw(xy: np.ndarray, radius: float = 0.0, seed: int = 0) -> list[np.ndarray]:
    return draw_patches(xy, 16, radius, np.random.default_rng(seed))


def test_a_small_cloud_is_one_patch() -> None:
    xy = np.random.default_rng(0).uniform(0, 1, (300, 2))
    (rows,) = draw(xy)
    assert sorted(rows) == list(range(300))


def test_dense_ones_leave_no_point_out(xy: np.ndarray) -> None:
    patches = draw(xy)
    assert len(patches) == 16
    for rows in patches:
        assert len(set(rows)) == PATCH_POINTS
        centre = xy[rows[0]]  # nearest first
        distances = np.hypot(*(xy - centre).T)
        assert np.sum(distances <= distances[rows].max()) == PATCH_POINTS


def test_wide_ones_reach_as_far_as_asked(xy: np.ndarray) -> None:
    for rows in draw(xy, 2.0):
        assert len(set(rows)) == PATCH_POINTS
        sides = np.ptp(xy[rows], axis=0)
        assert sides.max() > 1.9  # at a corner of the cloud it is a quarter of a disc
        assert sides.max() <= 4.0


def test_they_are_everywhere(xy: np.ndarray) -> None:
    middles = np.array([xy[rows].mean(axis=0) for rows in draw(xy)])
    quarters = {(x > SIZE / 2, y > SIZE / 2) for x, y in middles}
    assert len(quarters) == 4


def test_a_cloud_of_few_points_is_not_used_over_and_over() -> None:
    xy = np.random.default_rng(0).uniform(0, 3, (1000, 2))
    assert len(draw(xy)) == 4


def test_same_seed_same_patches(xy: np.ndarray) -> None:
    for a, b in zip(draw(xy, 1.5, 3), draw(xy, 1.5, 3), strict=True):
        np.testing.assert_array_equal(a, b)
    assert any((a != b).any() for a, b in zip(draw(xy, 0, 3), draw(xy, 0, 4), strict=True))
