"""The pipeline over any finite cloud and any permitted parameters: a result or a refusal.

``tests.long.quality.any_cloud`` runs thousands of the same, with limits of time and memory.
"""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gpgrad_core.detection import (
    PipelineParams,
    automatic,
    detect_loop_closures,
    infer_gradient_map,
    register_pair,
    resolve_parameters,
)
from gpgrad_core.errors import InputError
from gpgrad_core.features import DetectorParams, FeatureParams, check_detector
from gpgrad_core.gp import solution
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.mapping import gradient_map
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Grid, Submap
from tests.support.clouds import KINDS, draw_params, draw_submaps, run_pipeline
from tests.support.laws import examples
from tests.support.refusal import assert_refused

seeds = st.integers(0, 2**32 - 1)


@pytest.mark.slow
@examples(15)
@given(kind=st.sampled_from(list(KINDS)), seed=seeds)
@example("one spot", 4)
@example("far away", 31)
@example("one spot", 40)
def test_every_stage_runs_or_the_cloud_is_refused(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = draw_params(rng)
    with contextlib.suppress(InputError):
        pair = draw_submaps(kind, rng, 100, with_noise=params.map.noise_model == "file")
        run_pipeline(*pair, params)


def submap(xy: np.ndarray, relief: float = 0.1) -> Submap:
    heights = relief * np.random.default_rng(0).standard_normal(len(xy))
    return Submap.from_points(np.column_stack([xy, heights]))


def uniform(n: int, width: float, height: float) -> np.ndarray:
    return np.random.default_rng(0).uniform(0, (width, height), (n, 2))


FIXED = MapParams(length_scale=0.3, noise_std=0.05, scale=0.3)
BLOB = np.random.default_rng(1).standard_normal((60, 2))
ODD = {
    "one corner of a length-scale": (uniform(600, 6, 6), MapParams(length_scale=50.0).guessed),
    "a strip of no height": (uniform(600, 0.01, 0.01), FIXED),
    "two blobs 141 m apart": (
        np.vstack([BLOB, BLOB + 100]),
        MapParams(length_scale=0.3, resolution=0.1).guessed,
    ),
    "two blobs 1 km apart": (
        np.vstack([BLOB, BLOB + np.array([1000.0, 0.0])]),
        MapParams(length_scale=1.0, resolution=0.3).guessed,
    ),
    "a kilometre of road": (uniform(300, 1000, 0.3), FIXED),
    "five points": (uniform(5, 4, 4), FIXED),
    "a wall": (uniform(500, 1e-5, 8), FIXED),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ODD)
def test_what_once_failed_is_mapped_and_registered(name: str) -> None:
    xy, of_map = ODD[name]
    features = FeatureParams(max_std_ratio=1.0)
    cloud = submap(xy)
    run_pipeline(cloud, cloud, PipelineParams(map=of_map, features=features))


EXTREME = {
    "three": uniform(3, 1, 1),
    "duplicate": np.repeat(uniform(4, 1, 1), 50, axis=0),
    "one spot": uniform(50, 1e-6, 1e-6),
    "wide": uniform(50, 1e5, 1e5),
    "far away": uniform(50, 1, 1) + 1e8,
    "far apart": np.vstack([BLOB, BLOB + 1000]),
}


@pytest.mark.parametrize("name", EXTREME)
@pytest.mark.parametrize(
    "relief",
    [
        *(pytest.param(relief, marks=pytest.mark.nightly) for relief in (0.0, 1e4)),
        pytest.param(0.1, marks=pytest.mark.slow),
    ],
)
def test_automatic_parameters_bear_any_cloud(name: str, relief: float) -> None:
    params = resolve_parameters([submap(EXTREME[name], relief)])
    assert params.map.scale is not None
    assert params.registration.inlier_radius is not None


# --- refusals before the work -----------------------------------------------------------------


def never(*_args: object, **_flags: object) -> None:
    raise AssertionError


def test_too_many_points_are_refused_before_the_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gradient_map, "MOST_POINTS", 500)
    monkeypatch.setattr(automatic, "fit_parameters", never)
    large = replace(submap(uniform(600, 4, 4)), id="large")
    for refused in (
        lambda: infer_gradient_map(large),
        lambda: resolve_parameters([submap(uniform(50, 4, 4)), large]),
        lambda: detect_loop_closures(Dataset("d", (large, replace(large, id="other")))),
    ):
        assert_refused(refused, "large has 600 points", "max_points (--map.max-points) to that")


def test_a_fit_that_would_take_long_names_what_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    xy = uniform(3000, 4, 4)
    points = np.column_stack([xy, 0.1 * np.sin(9 * xy[:, 0])])

    def fit(length_scale: float, rows: slice = slice(None)) -> None:
        fit_gp(points[rows], SquaredExponential(0.1, length_scale), 0.05)

    fit(0.1)
    monkeypatch.setattr(solution, "MOST_SECONDS", 0.095)
    with pytest.raises(InputError, match=r"3,000 points .* would take about .*at most") as caught:
        fit(0.1)
    message = str(caught.value)
    fit(float(message.split("raise the length-scale to ")[1].split(" m", maxsplit=1)[0]))
    fewer = message.split("max_points to ")[1].split(" or", maxsplit=1)[0]
    fit(0.1, slice(int(fewer.replace(",", ""))))


def test_what_needs_gigabytes_is_refused_before_the_work() -> None:
    grid = Grid((0.0, 0.0), 0.03, (3334, 3334))
    kaze = "detector kaze would need 5.9 GB"
    assert_refused(lambda: check_detector(grid, DetectorParams("kaze")), kaze, "use the detector")
    check_detector(grid, DetectorParams("slope"))
    pair, params = (submap(BLOB), submap(uniform(50, 200, 200))), PipelineParams(map=FIXED)
    many = "more than the 12,000,000 allowed"
    assert_refused(lambda: register_pair(*pair, params, Memo(), never), many)


@pytest.mark.slow
def test_a_fit_draws_from_large_clouds() -> None:
    large = submap(uniform(301_000, 10, 10))
    few = resolve_parameters([large]).map
    assert few.noise_std == pytest.approx(0.1, rel=0.05)
