"""Noise measured from clouds whose noise is known; bins lose and move nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.gp.cloud import bin_points
from gpgrad_core.gp.noise import find_outliers, measure_noise
from gpgrad_core.se2 import SE2
from tests.support.ground import Ground, scatter
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
SIZE = (6.0, 6.0)


def noisy(seed: int, num: int, std: Array | float) -> Array:
    xy = scatter(seed, num, SIZE)
    noise = std * np.random.default_rng(seed + 1).standard_normal(num)
    return np.column_stack([xy, Ground.random(seed).height(xy) + noise])


@examples(15)
@given(seed=seeds, std=st.floats(0.01, 0.1), prior=st.floats(0.005, 0.5))
def test_even_noise_is_found_whatever_was_expected(seed: int, std: float, prior: float) -> None:
    measured = measure_noise(noisy(seed, 6000, std), 0.3, prior)
    assert float(np.median(measured.std)) == pytest.approx(std, rel=0.1)
    assert measured.outlying.mean() < 1e-3


def test_noise_does_not_depend_on_how_a_frame_is_turned() -> None:
    points, xy = noisy(3, 6000, 0.03), np.random.default_rng(4).uniform(0, 6, (100, 2))
    frame = SE2(60.0, -300.0, 1.34)
    there = np.column_stack([frame.apply(points[:, :2]), points[:, 2]])
    here, other = (measure_noise(each, 0.3, 0.05) for each in (points, there))
    # Rounding may move a point to the next cell.
    assert np.isclose(other.std, here.std, rtol=1e-3).mean() > 0.98
    assert np.isclose(other.std_at(frame.apply(xy)), here.std_at(xy), rtol=1e-3).mean() > 0.98


@examples(10)
@given(seed=seeds)
def test_noise_that_grows_with_range_is_found_near_and_far(seed: int) -> None:
    def grown(xy: Array) -> Array:
        return 0.01 + 0.002 * np.sum(xy**2, axis=1)

    xy = scatter(seed, 8000, SIZE)
    measured = measure_noise(noisy(seed, 8000, grown(xy)), 0.3, 0.05)
    at = np.random.default_rng(seed).uniform(0.5, 5.5, (200, 2))
    ratio = measured.std_at(at) / grown(at)
    assert float(np.median(ratio)) == pytest.approx(1.0, abs=0.1)
    assert np.percentile(ratio, 5) > 0.6
    assert np.percentile(ratio, 95) < 1.6


@examples(10)
@given(seed=seeds, height=st.floats(0.5, 50.0))
def test_outliers_are_told_and_do_not_spoil_their_neighbours(seed: int, height: float) -> None:
    points = noisy(seed, 6000, 0.03)
    clean = measure_noise(points, 0.3, 0.05)
    wrong = np.random.default_rng(seed).choice(6000, 60, replace=False)
    points[wrong, 2] += height
    measured = measure_noise(points, 0.3, 0.05)
    # The others lie in cells of too few points to have a plane.
    assert measured.outlying[wrong].mean() > 0.85
    right = np.setdiff1d(np.arange(6000), wrong)
    assert measured.outlying[right].mean() < 0.005
    told = wrong[measured.outlying[wrong]]
    assert np.percentile(measured.std[told], 5) > 0.4 * height
    np.testing.assert_allclose(np.median(measured.std[right]), np.median(clean.std), rtol=0.1)


def test_given_noise_is_kept_but_for_outliers() -> None:
    points = noisy(3, 6000, 0.03)
    points[7, 2] += 2.0
    given_std = np.full(6000, 0.03)
    found = find_outliers(points, 0.3, given_std)
    assert np.flatnonzero(found.outlying).tolist() == [7]
    assert found.std[7] > 1.0
    np.testing.assert_array_equal(np.delete(found.std, 7), 0.03)


@pytest.mark.parametrize("num", [3, 10, 60])
def test_sparse_clouds_keep_what_was_expected(num: int) -> None:
    """Two points to a length-scale tell slope from noise no more than nothing does."""
    points = noisy(5, num, 0.02)
    measured = measure_noise(points, 0.1, 0.05)
    assert not measured.outlying.any()
    assert np.isfinite(measured.std).all()
    np.testing.assert_allclose(measured.std, 0.05, rtol=1e-6)


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
