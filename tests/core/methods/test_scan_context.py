"""Scan contexts turn with the cloud by whole columns, and are compared as the paper says."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.rivals import height_between
from gpgrad_core.methods.scan_context import (
    RINGS,
    SECTORS,
    describe_contexts,
    distances,
    ring_key,
    scan_context,
)
from gpgrad_core.types import Submap
from tests.support.laws import examples

SEEDS = st.integers(0, 2**32 - 1)


def cloud(seed: int, num: int = 500) -> Array:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-6, 6, (num, 2)), rng.normal(0.0, 0.3, num)])


def turned(points: Array, yaw: float) -> Array:
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([points[:, :2] @ np.array([[c, s], [-s, c]]), points[:, 2]])


def test_a_bin_has_the_largest_height_of_its_points_and_none_is_zero() -> None:
    angle = 0.5 * 2 * np.pi / SECTORS  # the middle of the first sector beyond -pi
    direction = -np.array([np.cos(angle), np.sin(angle)])
    points = np.array([[*(2.5 * direction), z] for z in (-0.4, -0.1, -0.3)])
    points = np.vstack([points, [100.0, 0.0, 5.0]])  # beyond the last ring
    image = scan_context(points, np.zeros(2), 1.0)
    assert image.shape == (SECTORS, RINGS)
    assert image[0, 2] == -0.1
    assert np.count_nonzero(image) == 1


@examples(20)
@given(SEEDS, st.integers(0, SECTORS - 1))
def test_a_turn_by_whole_sectors_shifts_the_columns(seed: int, shift: int) -> None:
    points = cloud(seed)
    # Away from the edges of the sectors, where rounding decides.
    angle = SECTORS * np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    points = points[np.abs(angle - np.rint(angle)) > 1e-6]
    plain = scan_context(points, np.zeros(2), 0.3)
    other = scan_context(turned(points, 2 * np.pi * shift / SECTORS), np.zeros(2), 0.3)
    np.testing.assert_array_equal(other, np.roll(plain, shift, axis=0))
    np.testing.assert_allclose(ring_key(other), ring_key(plain), atol=1e-12)
    columns = plain / np.maximum(np.linalg.norm(plain, axis=1, keepdims=True), 1e-12)
    found = distances(
        np.roll(columns, shift, axis=0)[None].astype(np.float32), columns.astype(np.float32)
    )
    assert found.argmin() == shift
    empty = np.mean(~plain.any(axis=1))  # a column without points is like no other
    assert found.min() == pytest.approx(empty, abs=1e-5)


@examples(10)
@given(SEEDS)
def test_the_distance_is_that_of_the_paper_at_every_shift(seed: int) -> None:
    rng = np.random.default_rng(seed)
    query, database = rng.normal(size=(2, SECTORS, RINGS))
    lengths = [np.linalg.norm(one, axis=1, keepdims=True) for one in (query, database)]
    found = distances(
        (query / lengths[0])[None].astype(np.float32), (database / lengths[1]).astype(np.float32)
    )
    for shift in (0, 1, 17, SECTORS - 1):
        moved = np.roll(query, -shift, axis=0)
        cosines = np.sum(moved * database, axis=1) / (
            np.linalg.norm(moved, axis=1) * np.linalg.norm(database, axis=1)
        )
        assert found[0, shift] == pytest.approx(np.mean(1 - cosines), abs=1e-5)


def test_the_roots_lie_about_the_middle_of_the_points_the_nearest_first() -> None:
    points = cloud(3) + np.array([20.0, -10.0, 4.0])
    described = describe_contexts(
        Submap.from_points(points, "000"), PipelineParams(map=MapParams().guessed)
    )
    np.testing.assert_allclose(described.roots[0], points[:, :2].mean(axis=0))
    away = np.hypot(*(described.roots - described.roots[0]).T)
    assert np.all(np.diff(away) >= -1e-9)
    lengths = np.linalg.norm(described.contexts, axis=2)
    assert np.all((np.abs(lengths - 1) < 1e-5) | (lengths == 0))


def test_a_higher_place_is_found_to_be_higher() -> None:
    points = cloud(1)
    above, away = (points + np.array([x, 0.0, 0.7]) for x in (0.0, 100.0))
    assert height_between(points, above, np.eye(4), 0.3) == pytest.approx(0.7)
    assert height_between(points, away, np.eye(4), 0.3) == 0.0
