"""Every pair or every candidate once, and the same answer whatever does the work."""

import errno
import multiprocessing
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from gpgrad_core.detection import (
    DetectionResult,
    Pairs,
    PipelineParams,
    StagedDetector,
    detect_loop_closures,
)
from gpgrad_core.detection.consistency import own_registration
from gpgrad_core.detection.shortlist import Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import run_methods
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import METHODS, find_method
from gpgrad_core.run import Cancelled
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, Features, Registration, Submap
from tests.support.cancelling import cancelling
from tests.support.closures import content_of, verdicts_of
from tests.support.ground import submap

PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05))
DATASET = Dataset("five", tuple(submap(k // 2, 900, (6.0, 6.0)) for k in range(5)))


def numbered(count: int) -> list[Submap]:
    return [replace(DATASET.submaps[0], id=str(k)) for k in range(count)]


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
    submaps = numbered(count)
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
    assert verdicts_of(beside.closures) == verdicts_of(alone.closures)
    assert set(beside.seconds) == {"fit", "maps", "features", "pairs", "total"}
    assert max(closure.registration.num_inliers for closure in alone.closures) > 5


def test_a_submap_beside_itself_is_no_pair() -> None:
    name = DATASET.submaps[0].id
    with pytest.raises(InputError, match=f"{name} beside itself is no pair"):
        detect_loop_closures(DATASET, PARAMS, only=[(name, name)])


class Keyed(StagedDetector[Submap, Submap]):
    """A detector with keypoints that depend on the submap alone, as its registrations do."""

    def compare(self, query: Submap, database: Submap) -> Registration:
        apart = abs(int(query.id) - int(database.id))
        motion = SE2(0.1 * apart, 0.0, 0.0)
        return Registration(motion, np.ones(9, bool), np.inf, 9.0, 0.9, 1.0 + apart)

    def keypoints(self, extracted: Submap) -> Features:
        rng = np.random.default_rng(int(extracted.id) % 3)
        ones, positions = np.ones(40), rng.uniform(-3, 3, (40, 2))
        return Features(positions, ones, ones, ones, rng.normal(size=(40, 16)).astype(np.float32))


@pytest.mark.parametrize("candidates", [1, "all"])
@pytest.mark.parametrize("first", [0, 3, 6])
def test_a_table_is_the_same_however_it_is_filled(candidates: Candidates, first: int) -> None:
    submaps = numbered(6)
    whole = Pairs(submaps, PARAMS, Keyed(), candidates=candidates)
    whole.compare()
    table = Pairs(submaps[:first], PARAMS, Keyed(), candidates=candidates)
    table.compare()
    for one in submaps[first:]:
        table.add(one)
    assert verdicts_of(table.judge()) == verdicts_of(whole.judge())
    assert table.shortlists == whole.shortlists
    assert table.accepted == whole.accepted != {}


def test_a_table_compares_only_what_is_missing() -> None:
    detector = Noting()
    table = Pairs(numbered(5), PARAMS, detector)
    with pytest.raises(Cancelled):
        table.compare(progress=cancelling(0.8))
    assert 0 < len(detector.seen) < 10
    table.compare()
    assert len(set(detector.seen)) == len(table) == 10
    assert len(detector.seen) <= 11  # the one that was cancelled twice


def test_a_submap_that_is_not_added_leaves_no_trace() -> None:
    *known, new = numbered(4)
    table = Pairs(known, PARAMS, Noting())
    table.compare()
    before = verdicts_of(table.judge())
    with pytest.raises(Cancelled):
        table.add(new, progress=cancelling())
    assert verdicts_of(table.judge()) == before
    assert len(table.add(new)) == 3


SCALED = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.08, scale=0.2))
FEW = 2
MEMO = Memo()


@pytest.fixture(scope="module")
def demo() -> Dataset:
    whole = load_dataset(demo_path())
    some = (replace(submap, points=submap.points[::3]) for submap in whole.submaps[:8])
    return replace(whole, submaps=tuple(some))


@pytest.mark.slow
def test_chosen_pairs_have_the_registrations_that_they_have_among_all(
    demo: Dataset,
) -> None:
    whole, few = (
        detect_loop_closures(demo, SCALED, memo=MEMO, candidates=candidates)
        for candidates in ("all", FEW)
    )
    names = [submap.id for submap in demo.submaps]
    of_all = {(closure.query_id, closure.database_id): closure for closure in whole.closures}
    assert len(few.closures) == sum(min(FEW, k) for k in range(len(names)))
    for closure in few.closures:
        same = of_all[closure.query_id, closure.database_id]
        # Verdicts may differ, because fewer other pairs speak.
        chosen, among_all = own_registration(closure), own_registration(same)
        assert chosen.score == among_all.score
        assert chosen.T_database_query == among_all.T_database_query
    pairs = [one.pair for one in few.closures]
    assert pairs == sorted(pairs)
    assert list(few.shortlists) == names[FEW + 1 :]
    chosen = {(query, one.id) for query, best in few.shortlists.items() for one in best}
    assert chosen == {pair for pair in pairs if pair[0] in few.shortlists}
    assert ("shortlist" in few.seconds, "shortlist" in whole.seconds) == (True, False)
    accepted = {pair for pair, closure in of_all.items() if closure.accepted}
    found = {(one.query_id, one.database_id) for one in few.closures if one.accepted}
    assert len(found) >= 0.5 * len(accepted)


@pytest.mark.slow
@pytest.mark.parametrize("room", [True, False], ids=["room", "no room"])
def test_processes_find_the_same_candidates(
    demo: Dataset, monkeypatch: pytest.MonkeyPatch, room: bool
) -> None:
    for name in ("LEARN_FROM", "FEWEST_DESCRIPTORS"):  # else a vocabulary takes 64 submaps
        monkeypatch.setattr(f"gpgrad_core.detection.shortlist.{name}", 4)
    alone = detect_loop_closures(demo, SCALED, memo=MEMO, candidates=FEW)
    if not room:
        no_room = OSError(errno.ENOSPC, "No space left on device")
        monkeypatch.setattr("numpy.save", Mock(side_effect=no_room))
    with workers(2, 10**6) as executor:
        beside = detect_loop_closures(demo, SCALED, executor=executor, candidates=FEW)
    assert list(beside.shortlists.items()) == list(alone.shortlists.items())
    similarities = [one.similarity for best in alone.shortlists.values() for one in best]
    assert any(similarities)
    one, other = (
        content_of(report_closures(demo, replace(found, seconds={}), SCALED))
        for found in (beside, alone)
    )
    assert one == other


def test_a_method_without_keypoints_is_refused_before_the_work() -> None:
    for methods in (["chance"], ["gradient", "chance"]):
        with pytest.raises(InputError, match="method chance: the detector has no keypoints"):
            run_methods(DATASET, [find_method(name) for name in methods], SCALED, candidates=3)
    found = run_methods(DATASET, [find_method("chance")], SCALED)
    assert found["chance"].num_pairs_skipped == 0
