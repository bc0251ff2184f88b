"""Algorithm 1 as printed, against a loop that is the print, and what the memo keeps of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.detection import PipelineParams, fit_submap
from gpgrad_core.detection.verdict import ClosureParams, classify
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.paper import (
    paper_params,
    paper_start,
    register_as_printed,
    register_paper_pair,
    ssd_metric,
    tune,
)
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import GradientMap, Grid, Matches
from tests.core.features.maps import seen_from
from tests.support.ground import Ground, submap
from tests.support.laws import examples

GRID = Grid((-2.0, -2.0), 0.1, (41, 41))
RADIUS = 0.15


def a_map(T_world_map: SE2) -> GradientMap:
    return seen_from(Ground.random(3), T_world_map, GRID)


def associations(seed: int, right: int, wrong: int, motion: SE2) -> Matches:
    rng = np.random.default_rng(seed)
    query = rng.uniform(-2, 2, (right + wrong, 2))
    database = motion.apply(query) + rng.normal(0, 0.03, query.shape)
    database[right:] = rng.uniform(-2, 2, (wrong, 2))
    pairs = np.column_stack([np.arange(right + wrong)] * 2)
    return Matches(pairs, np.zeros(len(pairs)), query, database)


@examples(15)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 12),
    st.integers(0, 20),
    st.sampled_from([None, 1e2, 1e4, 1e6]),
)
def test_it_is_the_printed_loop(
    seed: int, right: int, wrong: int, max_dissimilarity: float | None
) -> None:
    matches = associations(seed, right, wrong, SE2(0.4, -0.3, 0.7))
    query, database = a_map(SE2(0.4, -0.3, 0.7)), a_map(SE2())
    limits = ClosureParams(min_inliers=2, max_dissimilarity=max_dissimilarity)
    found = register_as_printed(
        query, database, matches, RADIUS, 60, seed, None if max_dissimilarity is None else limits
    )
    best, motion = 0, None
    generator = np.random.default_rng(seed)
    if len(matches) >= 2:
        first = generator.integers(len(matches), size=60)
        second = generator.integers(len(matches) - 1, size=60)
        for a, b in zip(first, second + (second >= first), strict=True):
            pair = fit_se2(matches.query_xy[[a, b]], matches.database_xy[[a, b]])
            errors = np.hypot(*(pair.apply(matches.query_xy) - matches.database_xy).T)
            inliers = errors <= RADIUS
            if inliers.sum() <= max(best, 1):
                continue
            fitted = fit_se2(matches.query_xy[inliers], matches.database_xy[inliers])
            h, _ = ssd_metric(query, database, fitted)
            if max_dissimilarity is None or h <= max_dissimilarity:  # AcceptTransformation
                best, motion = int(inliers.sum()), fitted
    assert found.score == best
    if motion is None:  # of refused motions, the one with the most inliers is shown
        verdict = classify(found, limits)
        assert not verdict.accepted
        shown = found.T_database_query is not None
        assert ("dissimilarity" in verdict.reason) == shown
        return
    assert found.num_inliers == best
    assert found.T_database_query is not None
    np.testing.assert_allclose(
        [found.T_database_query.x, found.T_database_query.y, found.T_database_query.yaw],
        [motion.x, motion.y, motion.yaw],
        atol=1e-9,
    )
    h, num_cells = ssd_metric(query, database, motion)
    assert found.dissimilarity == pytest.approx(h)
    assert found.mean_dissimilarity == pytest.approx(h / num_cells)
    assert found.overlap_area == pytest.approx(0.01 * num_cells)


def test_h_is_lowest_where_the_maps_meet_and_infinite_apart() -> None:
    motion = SE2(0.5, 0.2)
    query, database = a_map(motion), a_map(SE2())
    assert ssd_metric(query, database, motion)[0] < 1e-3 * ssd_metric(query, database, SE2())[0]
    assert ssd_metric(query, database, SE2(40.0, 0.0)) == (np.inf, 0)


def test_the_parameters_are_the_papers() -> None:
    asked = replace(PipelineParams(), registration=RegistrationParams(seed=7))
    params = paper_params(asked)
    assert (params.map.max_points, params.map.resolution) == (5000, 0.03)
    assert params.map.length_scale is params.map.noise_std is params.map.signal_std is None
    assert paper_start(params.map).length_scale ** 2 == pytest.approx(0.1, rel=0.01)
    assert params.matching.ratio == 1
    assert params.features.detector.name == "surf"
    assert params.closure.min_inliers == 5
    assert params.closure.min_score == 0
    assert params.registration.seed == 7
    assert paper_params(params) == params
    closure = ClosureParams(min_inliers=9, max_dissimilarity=1e6)
    asked = PipelineParams(map=MapParams(length_scale=0.2, noise_std=0.01), closure=closure)
    params = paper_params(asked)
    assert params.map == replace(asked.map, max_points=5000)
    assert params.closure == replace(closure, min_score=0.0, others="off")


def test_fixed_hyperparameters_are_not_fitted_and_a_fit_is_kept_for_later_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bumps, memo = submap(3, 200), Memo(store=Store(tmp_path))
    params = paper_params(PipelineParams()).map
    assert tune(bumps, replace(params, length_scale=0.2), memo).length_scale == 0.2
    both = tune(bumps, replace(params, length_scale=0.2, noise_std=0.01), memo)
    assert (both.length_scale, both.noise_std, both.signal_std) == (0.2, 0.01, None)
    assert not memo.holds(fit_submap, bumps, paper_start(params), ())
    first = tune(bumps, params, memo)
    assert first.length_scale != paper_start(params).length_scale
    assert memo.holds(fit_submap, bumps, paper_start(params), ())
    monkeypatch.setattr("gpgrad_core.detection.automatic.fit_parameters", None)
    assert tune(bumps, params, Memo(store=Store(tmp_path))) == first


def test_a_threshold_runs_only_what_it_touches() -> None:
    query, database, memo = submap(3, 200), submap(4, 200), Memo()
    params = paper_params(PipelineParams())
    first = register_paper_pair(query, database, params, memo)
    moved = {
        "closure": replace(params.closure, min_inliers=7),
        "registration": replace(params.registration, inlier_radius=0.3),
        "features": replace(params.features, max_std_ratio=0.2),
    }
    for name, group in moved.items():
        again = register_paper_pair(query, database, replace(params, **{name: group}), memo)
        assert again.query_map is first.query_map
        assert again.database_map is first.database_map
        assert (again.registration is first.registration) == (name == "closure")
        assert (again.query_features is first.query_features) == (name != "features")
