"""Algorithm 1 as printed: against a loop that is the print, and h against its own formula."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gpgrad_core.methods.paper import paper_params, register_as_printed, ssd_metric
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import GradientMap, Grid, Matches
from tests.core.features.maps import seen_from
from tests.core.ground import Ground

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


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(0, 20))
def test_it_is_the_printed_loop(seed: int, right: int, wrong: int) -> None:
    matches = associations(seed, right, wrong, SE2(0.4, -0.3, 0.7))
    query, database = a_map(SE2(0.4, -0.3, 0.7)), a_map(SE2())
    found = register_as_printed(query, database, matches, RADIUS, 60, seed)
    best, motion = 0, None
    generator = np.random.default_rng(seed)
    if len(matches) >= 2:
        first = generator.integers(len(matches), size=60)
        second = generator.integers(len(matches) - 1, size=60)
        for a, b in zip(first, second + (second >= first), strict=True):
            pair = fit_se2(matches.query_xy[[a, b]], matches.database_xy[[a, b]])
            errors = np.hypot(*(pair.apply(matches.query_xy) - matches.database_xy).T)
            inliers = errors <= RADIUS
            if inliers.sum() > max(best, 1):
                best = int(inliers.sum())
                motion = fit_se2(matches.query_xy[inliers], matches.database_xy[inliers])
    assert found.num_inliers == best == found.score
    assert (found.T_database_query is None) == (motion is None)
    if motion is not None and found.T_database_query is not None:
        np.testing.assert_allclose(
            [found.T_database_query.x, found.T_database_query.y, found.T_database_query.yaw],
            [motion.x, motion.y, motion.yaw],
            atol=1e-9,
        )
        h, area = ssd_metric(query, database, motion)
        assert found.dissimilarity == pytest.approx(h)
        assert found.overlap_area == pytest.approx(area)


def test_it_finds_the_motion() -> None:
    motion = SE2(0.4, -0.3, 2.5)
    matches = associations(0, 12, 25, motion)
    found = register_as_printed(a_map(motion), a_map(SE2()), matches, RADIUS, 2000, 0)
    assert found.T_database_query is not None
    assert found.inliers[:12].all()
    assert found.T_database_query.yaw == pytest.approx(2.5, abs=0.05)
    np.testing.assert_allclose(
        [found.T_database_query.x, found.T_database_query.y], [0.4, -0.3], atol=0.05
    )


def test_h_is_its_formula_and_lowest_where_the_maps_meet() -> None:
    motion = SE2(0.5, 0.2)  # by whole cells: nothing to interpolate
    query, database = a_map(motion), a_map(SE2())
    h, area = ssd_metric(query, database, SE2(0.3, 0.2))
    there = (query.gradient[:-2, :-3] - database.gradient[2:, 3:]) ** 2
    expected = np.sum(there / (query.variance[:-2, :-3] * database.variance[2:, 3:]))
    # Cells on the last row or column may or may not count, by rounding.
    assert h == pytest.approx(expected, rel=0.1)
    assert area == pytest.approx(there.size * 0.01, rel=0.06)
    assert ssd_metric(query, database, motion)[0] < 1e-3 * h
    assert ssd_metric(query, database, SE2(40.0, 0.0)) == (np.inf, 0.0)


def test_the_parameters_are_the_papers() -> None:
    asked = replace(PipelineParams(), registration=RegistrationParams(seed=7))
    params = paper_params(asked)
    assert (params.map.max_points, params.map.resolution) == (5000, 0.03)
    assert params.map.length_scale**2 == pytest.approx(0.1, rel=0.01)
    assert params.map.signal_std is None
    assert params.features.detector.name == "surf"
    assert params.closure.min_inliers == 5
    assert params.closure.min_score == 0
    assert params.registration.seed == 7
