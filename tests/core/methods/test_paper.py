"""Algorithm 1 as printed, and ``--method paper`` step by step in NumPy alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams, detect_loop_closures, fit_submap
from gpgrad_core.detection.verdict import ClosureParams, classify
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.paper import (
    PaperDetector,
    PaperPair,
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
from gpgrad_core.types import Dataset, GradientMap, Grid, Matches, Submap
from tests.support.dense import (
    DensePosterior,
    fit_dense,
    infer_elevation,
    infer_slope,
    infer_variance,
)
from tests.support.ground import Ground, seen_from, submap
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


def test_if_every_motion_is_refused_the_one_with_the_most_inliers_is_shown() -> None:
    motion, rng = SE2(0.4, -0.3, 0.7), np.random.default_rng(0)
    at = rng.uniform(-1, 1, (8, 2))
    matches = Matches(np.tile(np.arange(8)[:, None], 2), np.zeros(8), at, motion.apply(at))
    query, database = a_map(SE2()), a_map(SE2())
    limits = ClosureParams(min_inliers=2, max_dissimilarity=1.0)
    found = register_as_printed(query, database, matches, RADIUS, 60, 0, limits)
    assert found.score == 0
    assert found.num_inliers == 8
    assert found.T_database_query is not None
    np.testing.assert_allclose(found.T_database_query.apply(at), matches.database_xy, atol=1e-9)
    assert found.dissimilarity == pytest.approx(ssd_metric(query, database, motion)[0])
    assert found.dissimilarity > 1.0
    assert "dissimilarity" in classify(found, limits).reason


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


PARAMS = paper_params(PipelineParams())
YAW, OFFSET = 0.6, (0.35, -0.2)
"""Where the query lies on the database."""


def bumps(xy: Array) -> Array:
    """A terrain of 60 bumps."""
    rng = np.random.default_rng(5)
    middles, heights = rng.uniform(-2.5, 2.5, (60, 2)), rng.normal(0, 0.15, 60)
    squared = np.sum((xy[:, None] - middles) ** 2, axis=2)
    return np.exp(-squared / (2 * 0.3**2)) @ heights


def seen(name: str, seed: int) -> Submap:
    """300 noisy points of the terrain; the query in its own frame."""
    rng = np.random.default_rng(seed)
    own = rng.uniform(-1.5, 1.5, (300, 2))
    world = SE2(*OFFSET, YAW).apply(own) if name == "001" else own
    z = bumps(world) + rng.normal(0, 0.01, 300)
    return Submap.from_points(np.column_stack([own, z]), id=name)


def log_likelihood(points: Array, length_scale: float, signal_std: float, noise: float) -> float:
    """Rasmussen & Williams, Eq. (5.8), per point."""
    posterior = fit_dense(points, SquaredExponential(signal_std, length_scale), noise)
    fit = (points[:, 2] - posterior.mean) @ posterior.weights
    log_determinant = 2 * np.log(np.diag(posterior.factor)).sum()
    return -0.5 * (fit + log_determinant) / len(points) - 0.5 * np.log(2 * np.pi)


def dense_of(submap: Submap, made: GradientMap, noise_std: float) -> DensePosterior:
    kernel = SquaredExponential(made.signal_std, made.length_scale)
    return fit_dense(submap.points, kernel, noise_std)


SUBMAPS = seen("001", 1), seen("000", 2)


@pytest.fixture(scope="module")
def pair() -> PaperPair:
    return register_paper_pair(*SUBMAPS, PARAMS, Memo())


def test_tuning_is_the_maximum_of_the_likelihood(pair: PaperPair) -> None:
    submap, terrain = SUBMAPS[0], pair.query_terrain
    own = np.array([terrain.length_scale, terrain.signal_std, terrain.noise_std])
    fit = fit_submap(submap, paper_start(PARAMS.map))
    assert fit.params == terrain
    before = log_likelihood(submap.points, np.sqrt(0.1), float(submap.points[:, 2].std()), 0.05)
    after = log_likelihood(submap.points, *own)
    assert fit.log_likelihood_before == pytest.approx(before, abs=1e-3)
    assert fit.log_likelihood_after == pytest.approx(after, abs=1e-5)
    for k in range(3):
        for factor in (0.9, 1.1):
            other = own * np.where(np.arange(3) == k, factor, 1.0)
            assert log_likelihood(submap.points, *other) < after


def test_fields_are_those_of_the_equations(pair: PaperPair) -> None:
    for one, made, terrain in (
        (SUBMAPS[0], pair.query_map, pair.query_terrain),
        (SUBMAPS[1], pair.database_map, pair.database_terrain),
    ):
        grid = made.grid
        assert grid.resolution == 0.03
        posterior = dense_of(one, made, terrain.noise_std)
        elevation = infer_elevation(posterior, grid.positions)
        variance = infer_variance(posterior, grid.positions)
        steepness = np.hypot(*infer_slope(posterior, grid.positions).T)
        scale = made.signal_std
        np.testing.assert_allclose(made.elevation.ravel(), elevation, atol=1e-3 * scale)
        np.testing.assert_allclose(made.std.ravel(), np.sqrt(variance), atol=5e-3 * scale)
        np.testing.assert_allclose(
            made.gradient.ravel(), steepness, atol=5e-3 * scale / made.length_scale
        )


def rigid(a: Array, b: Array) -> tuple[Array, Array]:
    """GetSE2Transform: centroids and SVD, without reflections."""
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = vt.T @ np.diag([1, np.linalg.det(vt.T @ u.T)]) @ u.T
    return turn, b.mean(0) - turn @ a.mean(0)


def test_matches_and_inliers_are_those_of_the_algorithm(pair: PaperPair) -> None:
    matches, found = pair.matches, pair.registration
    # Of each pair, each is the nearest of the other by L2.
    a, b = (
        side.descriptors.astype(float) for side in (pair.query_features, pair.database_features)
    )
    distance = np.linalg.norm(a[:, None] - b, axis=2)
    there, back = distance.argmin(axis=1), distance.argmin(axis=0)
    mutual = {(i, int(j)) for i, j in enumerate(there) if back[j] == i}
    assert {(int(i), int(j)) for i, j in matches.pairs} == mutual
    query, database = matches.query_xy, matches.database_xy
    n, sets = 0, set[bytes]()
    for a in range(len(matches)):
        for b in range(a):
            ends = query[[a, b]], database[[a, b]]
            # A motion of two pairs, in closed form: SVD would mirror half of them.
            gone, come = (np.subtract(*one) @ np.array([1, 1j]) for one in ends)
            turn = np.exp(1j * np.angle(come / gone))
            around = np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])
            there = (query - ends[0].mean(0)) @ around.T + ends[1].mean(0)
            inliers = np.linalg.norm(there - database, axis=1) <= 0.15
            if inliers.sum() > n:
                n, sets = int(inliers.sum()), set[bytes]()
            if inliers.sum() == n:
                sets.add(inliers.tobytes())
    assert found.num_inliers == n == found.score
    assert found.inliers.tobytes() in sets
    turn, offset = rigid(query[found.inliers], database[found.inliers])
    motion = found.T_database_query
    assert motion is not None
    np.testing.assert_allclose(motion.apply(query), query @ turn.T + offset, atol=1e-9)
    assert motion.yaw == pytest.approx(YAW, abs=0.1)
    np.testing.assert_allclose([motion.x, motion.y], OFFSET, atol=0.1)
    assert pair.closure.accepted
    assert n >= 5


def test_h_is_the_sum_over_the_common_cells(pair: PaperPair) -> None:
    found = pair.registration
    motion = found.T_database_query
    assert motion is not None
    of_query = dense_of(SUBMAPS[0], pair.query_map, pair.query_terrain.noise_std)
    of_database = dense_of(SUBMAPS[1], pair.database_map, pair.database_terrain.noise_std)
    cells = pair.database_map.grid.positions
    there = motion.inverse().apply(cells)
    grid = pair.query_map.grid
    low, high = grid.positions.min(axis=0), grid.positions.max(axis=0)
    common = ((there >= low) & (there <= high)).all(axis=1)
    # Eqs. (3)-(5) at the very place, in place of an interpolated image.
    v_q, v_d = infer_variance(of_query, there[common]), infer_variance(of_database, cells[common])
    slopes = infer_slope(of_query, there[common]), infer_slope(of_database, cells[common])
    difference = np.hypot(*slopes[0].T) - np.hypot(*slopes[1].T)
    terms = difference**2 / (v_q * v_d)
    assert found.dissimilarity == pytest.approx(np.sum(terms), rel=0.03)
    assert found.mean_dissimilarity == pytest.approx(np.mean(terms), rel=0.03)
    assert found.overlap_area == pytest.approx(common.sum() * 0.03**2, rel=0.01)


def test_the_detector_does_the_same_and_gives_each_submaps_own_numbers(pair: PaperPair) -> None:
    dataset = Dataset("bumps", SUBMAPS[::-1])
    result = detect_loop_closures(dataset, PARAMS, detector=PaperDetector(PARAMS, Memo()))
    (closure,) = result.closures
    assert closure.registration.T_database_query == pair.registration.T_database_query
    assert closure.registration.dissimilarity == pair.registration.dissimilarity
    own = result.hyperparameters
    for name, terrain in (("001", pair.query_terrain), ("000", pair.database_terrain)):
        assert own[name].length_scale == terrain.length_scale
        assert own[name].noise_std == terrain.noise_std
        assert own[name].signal_std == terrain.signal_std
    assert own["000"] != own["001"]
