"""What the points were drawn with is found again; and nothing that cannot be used."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.fitting import MOST_SUBMAPS, fit_parameters
from gpgrad_core.mapping.gradient_map import MapParams, TerrainParams
from gpgrad_core.params import check_bounds
from gpgrad_core.run import Cancelled
from gpgrad_core.types import Submap
from tests.support.cancelling import cancelling
from tests.support.ground import submap

WAVES = 500


def draw(
    seed: int, num: int, side: float, truth: TerrainParams, *, told: float | None = None
) -> Submap:
    """Draw points on a terrain that is, but for the number of its waves, the GP itself.

    With `told`, each point has a noise of its own, of which the submap tells so many times.
    """
    assert truth.signal_std is not None
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, side, (num, 2))
    # The spectral density of the squared exponential is a Gaussian of width 1 / length_scale.
    phases = xy @ rng.normal(0, 1 / truth.length_scale, (2, WAVES)) + rng.uniform(
        0, 2 * np.pi, WAVES
    )
    heights = truth.signal_std * np.sqrt(2 / WAVES) * np.cos(phases).sum(axis=1)
    noise = truth.noise_std * (np.ones(num) if told is None else rng.uniform(0.3, 2, num))
    points = np.column_stack([xy, heights + noise * rng.standard_normal(num)])
    return Submap.from_points(
        points, f"drawn-{seed}", noise_std=None if told is None else told * noise
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "length_scale", "signal_std", "noise_std"),
    [
        (5.0, 0.4, 0.2, 0.03),
        (3.0, 0.12, 0.05, 0.01),
        (2.5, 1.0, 0.3, 0.02),  # the nearest 500 points reach 0.7 m
    ],
)
def test_hyperparameters_are_found_again(
    side: float, length_scale: float, signal_std: float, noise_std: float
) -> None:
    truth = TerrainParams(length_scale, noise_std, signal_std=signal_std)
    found = fit_parameters([draw(seed, 1000, side, truth) for seed in range(3, 7)]).params
    assert found.signal_std is not None
    assert found.length_scale == pytest.approx(length_scale, rel=0.15)
    assert found.noise_std == pytest.approx(noise_std, rel=0.1)
    # Terrain of a few length-scales shows little of how high it goes.
    assert found.signal_std == pytest.approx(signal_std, rel=0.35)


@pytest.mark.slow
def test_length_scales_beyond_the_densest_patches_are_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gpgrad_core.mapping.fitting.PATCHES", 6)
    truth = TerrainParams(0.8, 0.02, signal_std=0.2)
    found = fit_parameters([draw(5, 8000, 2.5, truth)])  # the nearest 500 reach 0.35 m
    assert found.params.length_scale == pytest.approx(0.8, rel=0.15)
    assert found.params.noise_std == pytest.approx(0.02, rel=0.05)


def test_noise_that_each_point_tells_gets_a_factor() -> None:
    truth = TerrainParams(0.4, 0.03, signal_std=0.2)
    start = TerrainParams(noise_model="file")
    found = fit_parameters([draw(6, 700, 3.5, truth, told=0.5)], start).params
    assert found.noise_factor == pytest.approx(2.0, rel=0.1)
    assert found.length_scale == pytest.approx(0.4, rel=0.2)
    assert found.noise_std == start.noise_std


def test_a_growing_noise_keeps_its_shape() -> None:
    start = TerrainParams(noise_model="range", noise_growth=0.01)
    ground = submap(0, 400)
    ground = replace(ground, ranges=np.hypot(*ground.points[:, :2].T))
    found = fit_parameters([ground], start).params
    assert found.noise_growth / start.noise_growth == pytest.approx(
        found.noise_std / start.noise_std
    )
    assert found.noise_std < start.noise_std


def test_it_says_how_far_it_came_and_never_goes_back() -> None:
    ground = submap(1)
    first = fit_parameters([ground])
    assert first.log_likelihood_after > first.log_likelihood_before
    assert first.num_points == 2 * 800 + 400  # four patches of 500
    assert first.submap_ids == ("ground-1",)
    again = fit_parameters([ground], first.params)
    assert again.log_likelihood_after >= first.log_likelihood_after - 1e-9
    assert again.num_evaluations < first.num_evaluations


def test_of_many_submaps_some_are_taken_from_all_along() -> None:
    found = fit_parameters([replace(submap(0, 60), id=str(k)) for k in range(15)])
    assert found.submap_ids == ("0", "2", "4", "6", "8", "10", "12", "14")
    assert len(found.submap_ids) == MOST_SUBMAPS


def test_threads_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    results = []
    for threads in ("1", "2"):
        monkeypatch.setenv("GPGRAD_THREADS", threads)
        results.append(fit_parameters([submap(2, 600), submap(3, 300)], seed=5))
    assert results[0] == results[1]


def test_progress_grows_and_may_cancel() -> None:
    told: list[float] = []
    fit_parameters([submap(4, 100)], progress=told.append)
    assert told == sorted(told)
    assert told[0] == 0
    assert told[-1] == 1
    with pytest.raises(Cancelled):
        fit_parameters([submap(4, 100)], progress=cancelling(0.2))


def plane(slope: float, noise: float) -> Submap:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 4, (600, 2))
    heights = slope * xy[:, 0] + noise * rng.standard_normal(len(xy))
    return Submap.from_points(np.column_stack([xy, heights]), "plane")


@pytest.mark.parametrize(("slope", "noise"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.01), (1.0, 0.001)])
def test_what_is_found_on_a_plane_makes_a_map(slope: float, noise: float) -> None:
    ground = plane(slope, noise)
    found = fit_parameters([ground]).params
    check_bounds(found)
    made = infer_gradient_map(
        ground, MapParams(found.length_scale, found.noise_std, signal_std=found.signal_std)
    )
    inner = made.slope[20:-20, 20:-20, 0]
    np.testing.assert_allclose(inner, slope, atol=0.02)


def test_what_cannot_be_fitted_is_refused() -> None:
    with pytest.raises(InputError, match="give one submap or more"):
        fit_parameters([])
    with pytest.raises(InputError, match="gives no noise_std"):
        fit_parameters([submap(0)], TerrainParams(noise_model="file"))
