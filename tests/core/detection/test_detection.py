"""The stages together: right places accepted, others refused, nothing run that need not be."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams, detect_loop_closures, register_pair
from gpgrad_core.evaluation import measure_pairs, pose_errors
from gpgrad_core.features import DetectorParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Cancelled
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, Submap
from tests.support.ground import Ground, look

PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))


class CountingMemo(Memo):
    """Notes which stages are run, rather than remembered."""

    def __init__(self) -> None:
        super().__init__()
        self.ran: list[str] = []

    def __call__(self, function, *arguments, **unkeyed):  # noqa: ANN001, ANN002, ANN003, ANN204
        def noted(*args: object, **kwargs: object) -> object:
            self.ran.append(function.__name__)
            return function(*args, **kwargs)

        noted.__module__, noted.__qualname__ = function.__module__, function.__qualname__
        return super().__call__(noted, *arguments, **unkeyed)

    def since(self) -> list[str]:
        ran, self.ran = self.ran, []
        return ran


GROUND = Ground.random(21, shortest=0.7, std=0.2)
T_WORLD_DATABASE = SE2(3.0, -2.0, 0.4)
T_WORLD_QUERY = SE2(4.5, -0.5, -2.3)


MEMO = Memo()


@cache
def seen() -> tuple[Submap, Submap]:
    """A query and a database's submap of the same place."""
    return look(GROUND, T_WORLD_QUERY, 2, "query"), look(GROUND, T_WORLD_DATABASE, 1, "database")


@pytest.mark.parametrize("detector", ["slope", "akaze", "sift"])
def test_a_place_seen_again_is_accepted_and_well_placed(detector: str) -> None:
    features = replace(PARAMS.features, detector=DetectorParams(detector))
    result = register_pair(*seen(), replace(PARAMS, features=features), MEMO)
    assert result.closure.accepted, result.closure.reason
    assert (result.closure.query_id, result.closure.database_id) == ("query", "database")
    found = result.registration.T_database_query
    assert found is not None
    error = (T_WORLD_DATABASE.inverse() @ T_WORLD_QUERY).inverse() @ found
    assert np.hypot(error.x, error.y) < 0.05
    assert abs(np.degrees(error.yaw)) < 1.0
    assert result.registration.correlation > 0.9


def stranger(seed: int = 31) -> Submap:
    return look(Ground.random(seed, shortest=0.7, std=0.2), SE2(), seed, "stranger")


@pytest.mark.parametrize("seed", [31, 32])
def test_other_ground_is_refused(seed: int) -> None:
    closure = register_pair(stranger(seed), seen()[1], PARAMS, MEMO).closure
    assert not closure.accepted, closure.reason


def test_the_same_again_runs_nothing_and_gives_the_same_objects() -> None:
    memo = CountingMemo()
    first = register_pair(*seen(), PARAMS, memo)
    assert sorted(memo.since()) == sorted(
        2 * ["fit_terrain", "sample_map", "detect_features", "select_trusted", "prepare"]
        + ["match_features", "search_candidates", "register_prepared"]
    )
    second = register_pair(*seen(), PARAMS, memo)
    assert memo.since() == []
    names = ("query_map", "database_map", "query_features", "database_features", "matches")
    for name in (*names, "registration"):
        assert getattr(first, name) is getattr(second, name)


MAP, FEATURES = PARAMS.map, PARAMS.features
MATCHING, REGISTRATION, CLOSURE = PARAMS.matching, PARAMS.registration, PARAMS.closure
MASKING = ["match_features", "prepare", "register_prepared", "search_candidates", "select_trusted"]
SAMPLING = ["detect_features", *MASKING, "sample_map"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "stages"),
    [
        (replace(PARAMS, closure=replace(CLOSURE, min_inliers=15)), []),
        (replace(PARAMS, closure=replace(CLOSURE, min_score=1.0)), []),
        (
            replace(PARAMS, registration=replace(REGISTRATION, inlier_radius=0.2)),
            ["register_prepared"],
        ),
        (
            replace(PARAMS, matching=replace(MATCHING, ratio=0.9)),
            ["match_features", "register_prepared"],
        ),
        (replace(PARAMS, features=replace(FEATURES, max_std_ratio=0.2)), MASKING),
        (replace(PARAMS, map=replace(MAP, resolution=0.1)), SAMPLING),
        (replace(PARAMS, map=replace(MAP, noise_std=0.1)), ["fit_terrain", *SAMPLING]),
    ],
    ids=["min_inliers", "min_score", "radius", "ratio", "mask", "resolution", "noise"],
)
def test_a_slider_runs_what_lies_downstream_of_it_and_going_back_runs_nothing(
    changed: PipelineParams, stages: list[str]
) -> None:
    memo = CountingMemo()
    first = register_pair(*seen(), PARAMS, memo)
    memo.since()
    moved = register_pair(*seen(), changed, memo)
    assert sorted(set(memo.since())) == sorted(stages)
    again = register_pair(*seen(), PARAMS, memo)
    assert memo.since() == []
    assert again.registration is first.registration
    fresh = register_pair(*seen(), changed, Memo())
    assert moved.registration.T_database_query == fresh.registration.T_database_query
    assert moved.registration.score == fresh.registration.score
    assert moved.closure.reason == fresh.closure.reason
    np.testing.assert_array_equal(moved.query_map.elevation, fresh.query_map.elevation)


def test_progress_rises_and_may_cancel_and_nothing_half_done_is_kept() -> None:
    memo, heard = CountingMemo(), list[float]()

    def stop(fraction: float) -> None:
        heard.append(fraction)
        if fraction > 0.45:
            raise Cancelled(fraction)

    with pytest.raises(Cancelled):
        register_pair(*seen(), PARAMS, memo, stop)
    assert memo.since().count("fit_terrain") == 2
    register_pair(*seen(), PARAMS, memo, heard.append)
    assert memo.since().count("fit_terrain") == 1  # the query's was whole, the other's was not
    assert heard[-1] == pytest.approx(1.0)


def test_detection_compares_every_pair_once_the_earlier_as_database() -> None:
    query, database = seen()
    dataset = Dataset("three", (database, query, stranger()))
    memo, heard = CountingMemo(), list[float]()
    coarse = replace(PARAMS, map=replace(PARAMS.map, resolution=0.1))
    result = detect_loop_closures(dataset, coarse, memo=memo, progress=heard.append)
    assert [(c.database_id, c.query_id) for c in result.closures] == [
        ("database", "query"),
        ("database", "stranger"),
        ("query", "stranger"),
    ]
    assert [closure.accepted for closure in result.closures] == [True, False, False]
    assert memo.since().count("fit_terrain") == 3
    assert heard == sorted(heard)
    assert heard[-1] == pytest.approx(1.0)
    assert set(result.seconds) == {"fit", "maps", "features", "pairs", "total"}
    parts = sum(result.seconds[name] for name in ("fit", "maps", "features", "pairs"))
    assert result.seconds["total"] == pytest.approx(parts)


@pytest.mark.slow
def test_the_demos_revisits_are_found_and_no_pair_that_does_not_meet() -> None:
    demo = load_dataset(demo_path())
    pairs = measure_pairs(demo)
    closures = {frozenset(c.pair): c for c in detect_loop_closures(demo).closures}
    of_pairs = [closures[pair] for pair in pairs.rows]
    accepted = np.array([closure.accepted for closure in of_pairs])
    assert (pairs.box_iou[accepted] > 0).all()
    motions = tuple(closure.registration.T_database_query for closure in of_pairs)
    errors = pose_errors(motions, pairs.T_database_query)
    assert errors.offset[accepted].max() < 0.3
    assert np.degrees(errors.turn[accepted]).max() < 3
    revisits = pairs.box_iou > 0.5
    assert accepted[revisits].all()
    assert np.sum(np.abs(pairs.relative_yaw[revisits]) > np.radians(120)) >= 4
