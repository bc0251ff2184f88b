"""Submap to gradient map: the grid, the laws of the fields, what the parameters do."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gpgrad_core.arrays import Array
from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.errors import InputError
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.mapping.gradient_map import (
    MapParams,
    NoiseModel,
    TerrainParams,
    fit_terrain,
    sample_map,
)
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Submap
from tests.support.ground import Ground, cloud, seen_from, submap

PARAMS = MapParams(length_scale=0.3, noise_std=0.05, resolution=0.1)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def assert_same_map(a: GradientMap, b: GradientMap) -> None:
    assert a.grid == b.grid
    for name in ("elevation", "variance", "slope"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_it_finds_the_ground_again() -> None:
    ground = Ground.random(3, shortest=2.0)
    xy = np.random.default_rng(3).uniform(0, 4, (3000, 2))
    noise = 0.03 * np.random.default_rng(4).standard_normal(len(xy))
    points = np.column_stack([xy, ground.height(xy) + noise])
    made = infer_gradient_map(
        Submap.from_points(points), MapParams(length_scale=0.5, noise_std=0.03)
    )
    inner = (slice(20, -20), slice(20, -20))
    truth = seen_from(ground, SE2(), made.grid)
    assert rms((made.elevation - truth.elevation)[inner]) < 0.01
    for made_slope, slope in zip(made.slope.T, truth.slope.T, strict=True):
        assert rms((made_slope - slope)[inner]) < 0.25 * rms(slope)


def test_a_new_resolution_needs_no_new_fit() -> None:
    ground = submap(4)
    posterior = fit_terrain(ground, PARAMS.terrain)
    assert PARAMS.terrain == replace(PARAMS, resolution=0.5).terrain
    for resolution in (0.05, 0.1):
        whole = infer_gradient_map(ground, replace(PARAMS, resolution=resolution))
        assert_same_map(sample_map(ground, posterior, resolution), whole)
    coarse, fine = (sample_map(ground, posterior, r) for r in (0.1, 0.05))
    rows, columns = coarse.grid.shape
    np.testing.assert_allclose(
        coarse.elevation[: rows - 1, : columns - 1],
        fine.elevation[::2, ::2][: rows - 1, : columns - 1],
        atol=1e-10,
    )


def test_signal_std_is_that_of_the_points_unless_given() -> None:
    ground = submap(4)
    assert infer_gradient_map(ground, PARAMS).signal_std == ground.points[:, 2].std()
    made = infer_gradient_map(ground, replace(PARAMS, signal_std=0.7))
    assert made.signal_std == 0.7
    assert made.length_scale == PARAMS.terrain.length_scale
    assert made.std.max() <= 0.7


def test_thinning_keeps_so_many_points_and_the_same_ones() -> None:
    ground = submap(4, 2000)
    thin = replace(PARAMS, max_points=200)
    assert_same_map(infer_gradient_map(ground, thin), infer_gradient_map(ground, thin))
    full = infer_gradient_map(ground, PARAMS)
    assert infer_gradient_map(ground, thin).variance.mean() > 1.5 * full.variance.mean()
    assert_same_map(infer_gradient_map(ground, replace(PARAMS, max_points=2000)), full)


def test_dense_clouds_are_binned_and_hardly_change() -> None:
    points = cloud(11, 12_000, (2.0, 2.0), noise=0.03)
    made = infer_gradient_map(
        Submap.from_points(points), MapParams(length_scale=0.5, noise_std=0.05, resolution=0.05)
    )
    kernel = SquaredExponential(made.signal_std, made.length_scale)
    elevation, variance, slope = fit_gp(points, kernel, 0.05, solver="lattice").sample(made.grid)
    assert rms(made.elevation - elevation) <= 0.02 * 0.05
    assert rms(made.slope - slope) <= 0.02 * rms(slope)
    assert np.abs(made.std / np.sqrt(variance) - 1).max() <= 0.04


def test_three_points_are_enough() -> None:
    points = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.1], [0.0, 1.0, 0.8]])
    made = infer_gradient_map(Submap.from_points(points), PARAMS)
    assert np.isfinite(made.elevation).all()
    assert made.elevation[0, 0] == pytest.approx(1.0, abs=0.05)


def test_a_wide_cloud_is_refused_before_any_work() -> None:
    points = cloud(0, 100, (10_000.0, 10_000.0))

    def never(fraction: float) -> None:
        raise AssertionError(fraction)

    with pytest.raises(InputError, match=r"submap moon spans .* cells at 0\.03 m"):
        infer_gradient_map(Submap.from_points(points, "moon"), progress=never)


# --- noise of points -----------------------------------------------------------------------


def test_each_noise_model_gives_each_point_its_noise() -> None:
    points = cloud(3, 3000, (4.0, 4.0), noise=0.03)
    given_std = np.linspace(0.01, 0.1, 3000)
    squared = np.sum(points[:, :2] ** 2, axis=1)
    submap = Submap.from_points(points, noise_std=given_std, ranges=np.sqrt(squared))

    def noise(**changes: Any) -> np.ndarray:
        return TerrainParams(**changes).noise.of_points(submap).std

    np.testing.assert_array_equal(noise(noise_std=0.07), 0.07)
    grown = noise(noise_std=0.03, noise_model="range", noise_growth=0.002)
    np.testing.assert_allclose(grown, 0.03 + 0.002 * squared)
    np.testing.assert_allclose(noise(noise_model="file", noise_factor=2.0), 2 * given_std)
    measured = noise(noise_model="measured")
    assert float(np.median(measured)) == pytest.approx(0.03, rel=0.1)
    np.testing.assert_allclose(noise(noise_model="measured", noise_factor=3.0), 3 * measured)


@pytest.mark.parametrize(("model", "lacks"), [("file", "noise_std"), ("range", "range")])
def test_a_cloud_that_lacks_what_a_noise_model_needs_is_refused(
    model: NoiseModel, lacks: str
) -> None:
    submap = Submap.from_points(cloud(3, 100), "crater")
    with pytest.raises(InputError, match=rf"crater gives no {lacks} .* choose another"):
        infer_gradient_map(submap, MapParams(noise_model=model).guessed)


@pytest.mark.parametrize("model", ["constant", "measured"])
def test_points_far_above_the_ground_hardly_move_the_map(model: NoiseModel) -> None:
    points = cloud(3, 6000, (5.0, 5.0), noise=0.03)
    clean = infer_gradient_map(Submap.from_points(points), MapParams(noise_model=model).guessed)
    wrong = np.random.default_rng(0).choice(len(points), 30, replace=False)
    spoilt = points.copy()
    spoilt[wrong, 2] += 0.5
    # Most of them would be left out of a cloud that is read.
    submap = replace(Submap.from_points(points), points=spoilt)
    params = MapParams(noise_model=model, signal_std=clean.signal_std).guessed
    made = infer_gradient_map(submap, params)
    told = params.terrain.noise.of_points(submap).outlying
    assert told[wrong].mean() > 0.85
    assert np.percentile(np.abs(made.elevation - clean.elevation), 95) < 0.05
