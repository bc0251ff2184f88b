"""The model of the noise, and its numbers, are found by the points alone."""

from collections.abc import Callable

import numpy as np
import pytest

from gpgrad_core.arrays import Array
from gpgrad_core.gp.likelihood import Hyperparameters, Patch, log_marginal_likelihood
from gpgrad_core.mapping.fitting import fit_parameters
from gpgrad_core.mapping.gradient_map import MapParams, TerrainParams
from gpgrad_core.mapping.sensor_noise import noise_over_range
from gpgrad_core.types import Submap

NOISE_STD, GROWTH = 0.01, 0.001


def see(noise: Callable[[Array], Array], seed: int = 0, wild: float = 0.0) -> list[Submap]:
    """See a place of smooth ground; a share of the points is wild."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-4, 4, (3500, 2))
    x, y = (xy + 3 * seed).T
    z = 0.3 * np.sin(1.1 * x) * np.cos(0.8 * y) + 0.1 * np.sin(2.1 * x + 1.7 * y)
    z += noise(xy) * rng.standard_normal(len(xy))
    z += 0.3 * rng.standard_normal(len(xy)) * (rng.uniform(size=len(xy)) < wild)
    return [Submap.from_points(np.column_stack([xy, z]), ranges=np.hypot(*xy.T))]


def by_range(xy: Array) -> Array:
    return NOISE_STD + GROWTH * np.sum(xy**2, axis=1)


def fit(submaps: list[Submap]) -> TerrainParams:
    return fit_parameters(submaps, choose=True).params


def test_a_point_is_predicted_from_the_others() -> None:
    rng = np.random.default_rng(3)
    xy, heights, noise = rng.uniform(0, 1, (12, 2)), rng.normal(size=12), rng.uniform(0.1, 0.3, 12)
    patch = Patch(xy, heights, noise)
    found = log_marginal_likelihood(patch, Hyperparameters(0.4, 0.8, 1.0))
    distances = np.sum((xy[:, None] - xy) ** 2, axis=-1)
    covariance = 0.64 * np.exp(-0.5 * distances / 0.16)
    for k in range(12):
        rest = np.arange(12) != k
        noisy = covariance[np.ix_(rest, rest)] + np.diag(noise[rest] ** 2)
        weights = np.linalg.solve(noisy, covariance[rest, k])
        assert found.residual[k] == pytest.approx(heights[k] - weights @ heights[rest], abs=1e-6)
        assert found.variance[k] == pytest.approx(0.64 - weights @ covariance[rest, k], abs=1e-6)


@pytest.mark.parametrize("wild", [pytest.param(0.0, marks=pytest.mark.slow), 0.01])
def test_noise_that_grows_with_range_is_found_with_its_numbers(wild: float) -> None:
    found = fit(see(by_range, wild=wild))
    assert found.noise_model == "range"
    for distance in (0.0, 3.0, 6.0):
        noise = found.noise_std + found.noise_growth * distance**2
        assert noise == pytest.approx(NOISE_STD + GROWTH * distance**2, rel=0.15)


def test_constant_noise_stays_what_is_most_likely() -> None:
    submaps = see(lambda xy: np.full(len(xy), 0.03))
    found = fit(submaps)
    assert found == fit_parameters(submaps).params
    assert found.noise_model == "constant"
    assert found.noise_std == pytest.approx(0.03, rel=0.05)


def test_noise_that_differs_by_place_is_measured() -> None:
    (submap,) = see(lambda xy: 0.02 * np.exp(0.4 * xy[:, 0]))
    found = fit([submap])
    assert found.noise_model == "measured"
    ratio = found.noise.of_points(submap).std / (0.02 * np.exp(0.4 * submap.points[:, 0]))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.3)
    # From one end to the other the noise grows 55 times.
    assert np.mean((ratio > 0.5) & (ratio < 2)) > 0.8


def test_a_given_noise_is_constant_and_nothing_is_chosen() -> None:
    given = MapParams(length_scale=0.3, noise_std=0.05)
    assert given.noise_model == "auto"
    assert not given.chooses_noise
    assert given.terrain.noise_model == "constant"
    assert MapParams().chooses_noise
    assert not MapParams(noise_model="constant").chooses_noise


def test_the_model_lies_amid_what_is_measured() -> None:
    (submap,) = see(by_range)
    params = TerrainParams(0.6, NOISE_STD, noise_model="range", noise_growth=GROWTH)
    shown = noise_over_range(submap, params)
    assert np.all(np.diff(shown.ranges) >= 0)
    np.testing.assert_allclose(shown.modelled, NOISE_STD + GROWTH * shown.ranges**2)
    ratio = shown.measured / shown.modelled
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
