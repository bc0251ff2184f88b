"""Every pair once, and the same answer whatever does the work."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gpgrad_core.detection import (
    DetectionResult,
    Pairs,
    PipelineParams,
    StagedDetector,
    detect_loop_closures,
)
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, Registration, Submap
from tests.support.ground import submap

PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))
DATASET = Dataset("five", tuple(submap(k // 2, 900, (6.0, 6.0)) for k in range(5)))


class Noting:
    """A detector of no stages that notes which pairs it is shown."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, str]] = []

    def __call__(self, query: Submap, database: Submap) -> Registration:
        self.seen.append((query.id, database.id))
        score = float(len(self.seen))
        return Registration(SE2(1.0, 2.0, 0.5), np.ones(9, bool), np.inf, 0.0, 0.0, score)


@pytest.mark.parametrize("count", [0, 1, 2, 7, 30])
@pytest.mark.parametrize("parallel", [False, True])
def test_any_detector_is_shown_every_pair_once(count: int, parallel: bool) -> None:
    submaps = [replace(DATASET.submaps[0], id=str(k)) for k in range(count)]
    detector = Noting()
    with ThreadPoolExecutor(3) if parallel else nullcontext() as executor:
        pairs = Pairs(submaps, PARAMS, detector)
        pairs.compare(executor=executor)
    expected = [(i, j) for i in range(count) for j in range(i)]
    assert [(int(one.query_id), int(one.database_id)) for one in pairs.judge()] == expected
    assert sorted(detector.seen) == sorted((str(i), str(j)) for i, j in expected)


def test_a_detector_from_outside_is_judged_by_the_same_rule() -> None:
    asked = replace(PARAMS, closure=replace(PARAMS.closure, min_inliers=9, min_score=3.0))
    result = detect_loop_closures(DATASET, asked, detector=Noting())
    assert [closure.accepted for closure in result.closures] == 2 * [False] + 8 * [True]
    assert result.closures[0].reason.startswith("score 1 < 3: no ground of both")


@pytest.mark.parametrize("name", sorted(name for name in METHODS if METHODS[name].installed))
def test_methods_are_prepared_once_a_submap(name: str) -> None:
    method = METHODS[name]
    assert isinstance(method.detector(method.adapt(PARAMS), Memo()), StagedDetector)


def in_one_process() -> Executor:
    return ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))


@pytest.fixture(scope="module")
def alone() -> DetectionResult:
    return detect_loop_closures(DATASET, PARAMS)


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [lambda: ThreadPoolExecutor(1), lambda: ThreadPoolExecutor(4), in_one_process],
    ids=["thread", "threads", "process"],
)
def test_the_answer_does_not_depend_on_who_does_the_work(
    alone: DetectionResult, make: Callable[[], Executor]
) -> None:
    with make() as executor:
        beside = detect_loop_closures(DATASET, PARAMS, executor=executor)
    assert content(beside) == content(alone)
    assert set(beside.seconds) == {"fit", "maps", "features", "pairs", "total"}
    assert max(closure.registration.num_inliers for closure in alone.closures) > 5


def content(result: DetectionResult) -> list[tuple[Any, ...]]:
    return [
        (
            closure.query_id,
            closure.database_id,
            closure.accepted,
            closure.reason,
            closure.registration.T_database_query,
            closure.registration.score,
            closure.registration.dissimilarity,
            closure.registration.inliers.tolist(),
        )
        for closure in result.closures
    ]


def test_a_submap_beside_itself_is_no_pair() -> None:
    name = DATASET.submaps[0].id
    with pytest.raises(InputError, match=f"{name} beside itself is no pair"):
        detect_loop_closures(DATASET, PARAMS, only=[(name, name)])
