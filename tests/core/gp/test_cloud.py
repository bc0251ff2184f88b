"""Bins: nothing lost, nothing moved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.gp.cloud import bin_points

seeds = st.integers(0, 2**32 - 1)
cells = st.floats(0.01, 5.0)


def random_points(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(0, 2, (rng.integers(1, 300), 3)) + 1000 * rng.normal(size=3)


@given(seeds, cells)
def test_each_mean_is_that_of_the_points_of_its_cell(seed: int, cell: float) -> None:
    points = random_points(seed)
    means, noise = bin_points(points, cell, 0.1)
    members: dict[tuple[float, float], list[np.ndarray]] = {}
    for point in points:
        x, y = np.floor((point[:2] - points[:, :2].min(axis=0)) / cell)
        members.setdefault((y, x), []).append(point)
    expected = [np.mean(member, axis=0) for _, member in sorted(members.items())]
    np.testing.assert_allclose(means, expected, rtol=1e-12)
    counts = [len(member) for _, member in sorted(members.items())]
    np.testing.assert_allclose(noise, 0.1 / np.sqrt(counts), rtol=1e-12)


@given(seeds)
def test_a_mean_weighs_its_points_by_their_precision(seed: int) -> None:
    points = random_points(seed)
    each = np.random.default_rng(seed).uniform(0.01, 1.0, len(points))
    (mean,), (noise,) = bin_points(points, 1e6, each)
    np.testing.assert_allclose(mean, each**-2 @ points / np.sum(each**-2), rtol=1e-9)
    assert noise == pytest.approx(np.sum(each**-2) ** -0.5)


@given(seeds, cells)
def test_order_and_place_do_not_matter(seed: int, cell: float) -> None:
    points = random_points(seed)
    shuffled = np.random.default_rng(seed + 1).permutation(points)
    for a, b in zip(bin_points(points, cell), bin_points(shuffled, cell), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
