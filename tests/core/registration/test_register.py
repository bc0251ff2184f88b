"""Registration: known motions found among outliers or by hand, the dense check by its formulas."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.registration import RegistrationParams, refine, register
from gpgrad_core.registration.candidates import find_motions
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid, Matches
from tests.core.registration.synthetic import DATABASE, GRID, map_of
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
motions = st.builds(SE2, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-math.pi, math.pi))
KEYPOINTS = RegistrationParams(searched=0)
"""Without the exhaustive search, which needs no associations."""


def associations(
    seed: int, T_database_query: SE2, right: int, wrong: int, jitter: float = 0.02
) -> Matches:
    """Draw associations of which some obey the motion and the others nothing."""
    rng = np.random.default_rng(seed)
    query = rng.uniform(-3.5, 3.5, (right + wrong, 2))
    database = T_database_query.apply(query) + jitter * rng.standard_normal(query.shape)
    database[right:] = rng.uniform(-3.5, 3.5, (wrong, 2))
    order = rng.permutation(len(query))
    pairs = np.column_stack([np.arange(len(query))] * 2).astype(np.intp)
    return Matches(pairs, np.ones(len(query)), query[order], database[order])


NONE = associations(0, SE2(), 0, 0)


def assert_near(found: SE2 | None, true: SE2, offset: float, turn: float) -> None:
    assert found is not None
    middle = np.zeros((1, 2))
    assert np.hypot(*(found.apply(middle) - true.apply(middle))[0]) <= offset
    assert abs(math.remainder(found.yaw - true.yaw, math.tau)) <= turn


def test_hypotheses_are_as_good_where_the_frames_begin_far_away() -> None:
    true, away = SE2(0.4, -0.9, 2.0), np.array([4.0e5, -5.9e6])
    matches = associations(1, true, 20, 60)
    far = replace(matches, query_xy=matches.query_xy + away, database_xy=matches.database_xy - away)
    params = RegistrationParams()
    near_by, far_off = (find_motions(some, params, 0.1) for some in (matches, far))
    assert len(near_by) == len(far_off)
    corners = np.array([[-3.0, -3.0], [3.0, 2.0]])
    for one, other in zip(near_by, far_off, strict=True):
        moved = other.apply(corners + away) + away
        np.testing.assert_allclose(moved, one.apply(corners), atol=1e-6)
    assert_near(near_by[0], true, 0.05, 0.02)


@examples(5)
@given(seed=seeds, T_database_query=motions, right=st.integers(12, 60))
def test_any_motion_is_found_among_as_many_outliers_again_and_half(
    seed: int, T_database_query: SE2, right: int
) -> None:
    matches = associations(seed, T_database_query, right, right + right // 2)
    query = map_of(T_database_query)
    raised = replace(query, elevation=query.elevation + 7.0)
    result = register(raised, DATABASE, matches)
    assert_near(result.T_database_query, T_database_query, 0.03, 0.01)
    assert result.z_offset == pytest.approx(-7.0, abs=0.02)
    assert result.num_inliers >= right
    assert result.correlation > 0.97
    assert result.score > 3


@examples(5)
@given(T_database_query=motions)
def test_the_ground_alone_gives_the_motion(T_database_query: SE2) -> None:
    result = register(map_of(T_database_query), DATABASE, NONE)
    assert_near(result.T_database_query, T_database_query, 0.03, 0.01)
    assert result.score > 3


@examples(8)
@given(seed=seeds, num=st.integers(2, 60))
def test_inliers_are_one_to_one_and_within_the_radius(seed: int, num: int) -> None:
    rng = np.random.default_rng(seed)
    # Many keypoints share a position, as SIFT's with two orientations do.
    places = rng.uniform(-3, 3, (12, 2))
    query, database = (places[rng.integers(0, 12, num)] for _ in range(2))
    pairs = np.zeros((num, 2), np.intp)
    matches = Matches(pairs, np.ones(num), query, database)
    params = replace(KEYPOINTS, inlier_radius=0.8)
    result = register(DATABASE, DATABASE, matches, params)
    assert result.inliers.shape == (num,)
    if result.T_database_query is None:
        return
    for xy in (query, database):
        assert len(np.unique(xy[result.inliers], axis=0)) == result.num_inliers
    error = result.T_database_query.apply(query) - database
    assert np.hypot(*error[result.inliers].T).max(initial=0.0) <= 0.8
    assert result.num_inliers <= 12


TWO = np.array([[-1.0, 0.0], [1.0, 0.5]])


@pytest.mark.parametrize(
    ("query", "database"),
    [
        (np.zeros((0, 2)), np.zeros((0, 2))),
        (TWO[:1], TWO[:1]),
        *((TWO, TWO * stretch) for stretch in (0.0, 0.01, 3.0)),
        (np.ones((9, 2)), np.ones((9, 2))),
    ],
    ids=["none", "one", "to a place", "shrunk", "stretched", "all on one place"],
)
def test_what_no_rigid_motion_joins_gives_none(query: Array, database: Array) -> None:
    num = len(query)
    matches = Matches(np.zeros((num, 2), np.intp), np.ones(num), query, database)
    result = register(DATABASE, DATABASE, matches, KEYPOINTS)
    assert result.T_database_query is None
    assert result.inliers.tolist() == [False] * num
    assert (result.score, result.overlap_area, result.correlation) == (0.0, 0.0, 0.0)
    assert math.isinf(result.dissimilarity)


def test_two_associations_give_their_motion() -> None:
    true = SE2(0.3, -0.2, 1.0)
    matches = Matches(np.zeros((2, 2), np.intp), np.ones(2), TWO, true.apply(TWO))
    result = register(map_of(true), DATABASE, matches, KEYPOINTS)
    assert_near(result.T_database_query, true, 0.03, 0.01)
    assert result.num_inliers == 2


def test_the_same_seed_gives_the_same_answer_and_progress_reaches_one() -> None:
    matches = associations(3, SE2(0.5, 0.0, 2.0), 15, 150)
    params = RegistrationParams(trials=500, seed=7)
    query = map_of(SE2(0.5, 0.0, 2.0))
    heard: list[float] = []
    a, b = (register(query, DATABASE, matches, params, heard.append) for _ in range(2))
    assert a.T_database_query == b.T_database_query
    np.testing.assert_array_equal(a.inliers, b.inliers)
    assert (a.score, a.dissimilarity) == (b.score, b.dissimilarity)
    assert heard[-1] == 1.0
    other = register(query, DATABASE, matches, replace(params, seed=8))
    assert_near(other.T_database_query, SE2(0.5, 0.0, 2.0), 0.1, 0.05)


# --- dense check --------------------------------------------------------------------------


def test_untrusted_cells_are_left_out() -> None:
    half = DATABASE.variance.copy()
    half[:, :40] = DATABASE.signal_std**2
    masked = replace(DATABASE, variance=half)
    matches = associations(0, SE2(), 30, 0, jitter=0.0)
    whole = register(DATABASE, DATABASE, matches)
    for query, database in ((masked, DATABASE), (DATABASE, masked)):
        result = register(query, database, matches)
        assert result.overlap_area == pytest.approx(whole.overlap_area / 2, rel=0.05)
        assert result.correlation > 0.999


def test_maps_that_do_not_meet_share_nothing() -> None:
    away = SE2(30.0, 0.0, 0.0)
    matches = associations(0, away, 10, 0, jitter=0.0)
    result = register(DATABASE, DATABASE, matches, KEYPOINTS)
    assert (result.overlap_area, result.correlation, result.score) == (0.0, 0.0, 0.0)
    assert result.dissimilarity == 0.0
    assert result.covariance is None


@examples(6)
@given(T_database_query=motions)
def test_the_fields_of_the_check_are_their_formulas(T_database_query: SE2) -> None:
    """Cell by cell, with NumPy's own interpolation."""
    query = map_of(SE2(0.2, 0.1, 0.3))  # not the same ground under the motion: h is large
    matches = associations(0, T_database_query, 30, 0, jitter=0.0)
    result = register(query, DATABASE, matches, KEYPOINTS)
    assert result.T_database_query is not None
    pixels = GRID.to_pixel(result.T_database_query.inverse().apply(GRID.positions))
    inside = ((pixels >= 0) & (pixels <= 80)).all(axis=1)
    pixels = pixels[inside]
    low = np.minimum(np.floor(pixels).astype(int), 79)
    u, v = (pixels - low).T

    def sample(field: Array) -> Array:
        column, row = low.T
        return (
            (1 - u) * (1 - v) * field[row, column]
            + u * (1 - v) * field[row, column + 1]
            + (1 - u) * v * field[row + 1, column]
            + u * v * field[row + 1, column + 1]
        )

    there = np.column_stack([sample(query.slope[..., k]) for k in (0, 1)])
    here = DATABASE.slope.reshape(-1, 2)[inside]
    variances = sample(query.variance) * DATABASE.variance.ravel()[inside]
    h = np.sum((np.hypot(*there.T) - np.hypot(*here.T)) ** 2 / variances)
    turned = result.T_database_query.rotate(there)
    a, b = turned - turned.mean(axis=0), here - here.mean(axis=0)
    correlation = np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b))
    area = inside.sum() * 0.01
    # cv2.remap interpolates in 32nds of a pixel, and cells on the rim may fall either way.
    assert result.overlap_area == pytest.approx(area, rel=0.05)
    assert result.correlation == pytest.approx(correlation, abs=0.03)
    assert result.dissimilarity == pytest.approx(h, rel=0.06)


def test_thinning_leaves_the_fields_as_they_are() -> None:
    fine = Grid(GRID.origin, 0.05, (161, 161))
    true = SE2(0.4, -0.3, 0.6)
    matches = associations(0, true, 30, 0, jitter=0.0)
    coarse_result = register(map_of(true), DATABASE, matches)
    fine_result = register(map_of(true, grid=fine), map_of(SE2(), grid=fine), matches)
    assert fine_result.overlap_area == pytest.approx(coarse_result.overlap_area, rel=0.05)
    assert fine_result.correlation == pytest.approx(coarse_result.correlation, abs=0.02)


# --- from a motion set by hand --------------------------------------------------------------

near = st.floats(-0.25, 0.25)


@examples(6)
@given(x=near, y=near, yaw=st.floats(-0.08, 0.08), turn=st.floats(-math.pi, math.pi))
def test_a_slip_of_the_hand_is_undone(x: float, y: float, yaw: float, turn: float) -> None:
    true = SE2(0.8, -0.5, turn)
    found = refine(map_of(true), DATABASE, NONE, SE2(x, y, yaw) @ true)
    assert_near(found.T_database_query, true, 0.02, 0.01)
    assert found.correlation > 0.97
    assert found.covariance is not None


def test_without_common_ground_the_motion_stays() -> None:
    far = SE2(50.0, 0.0, 0.3)
    found = refine(map_of(SE2()), DATABASE, NONE, far)
    assert found.T_database_query == far
    assert found.score < 1.0
    assert found.overlap_area == 0.0
