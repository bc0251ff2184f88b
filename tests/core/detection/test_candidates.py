"""Only the candidates are compared."""

import errno
from dataclasses import replace

import pytest

from gpgrad_core.detection import DetectionResult, PipelineParams, detect_loop_closures
from gpgrad_core.detection.consistency import own_registration
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import EvaluationParams, evaluate, run_methods
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods import find_method
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset
from tests.support.closures import content_of

PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.08, scale=0.2))
FEW = 2


@pytest.fixture(scope="module")
def demo() -> Dataset:
    whole = load_dataset(demo_path())
    some = (replace(submap, points=submap.points[::3]) for submap in whole.submaps[:8])
    return replace(whole, submaps=tuple(some))


@pytest.fixture(scope="module")
def memo() -> Memo:
    return Memo()


@pytest.fixture(scope="module")
def whole(demo: Dataset, memo: Memo) -> DetectionResult:
    return detect_loop_closures(demo, PARAMS, memo=memo, candidates="all")


@pytest.fixture(scope="module")
def few(demo: Dataset, memo: Memo) -> DetectionResult:
    return detect_loop_closures(demo, PARAMS, memo=memo, candidates=FEW)


@pytest.mark.slow
def test_chosen_pairs_have_the_registrations_that_they_have_among_all(
    demo: Dataset, whole: DetectionResult, few: DetectionResult
) -> None:
    names = [submap.id for submap in demo.submaps]
    of_all = {(closure.query_id, closure.database_id): closure for closure in whole.closures}
    assert len(few.closures) == sum(min(FEW, k) for k in range(len(names)))
    for closure in few.closures:
        same = of_all[closure.query_id, closure.database_id]
        # Verdicts may differ, because fewer other pairs speak.
        chosen, among_all = own_registration(closure), own_registration(same)
        assert chosen.score == among_all.score
        assert chosen.T_database_query == among_all.T_database_query
    pairs = [(one.query_id, one.database_id) for one in few.closures]
    assert pairs == sorted(pairs)
    accepted = {pair for pair, closure in of_all.items() if closure.accepted}
    found = {(one.query_id, one.database_id) for one in few.closures if one.accepted}
    assert len(found) >= 0.5 * len(accepted)


@pytest.mark.slow
def test_why_a_pair_was_looked_at(
    demo: Dataset, whole: DetectionResult, few: DetectionResult
) -> None:
    assert whole.shortlists == {}
    assert list(few.shortlists) == [submap.id for submap in demo.submaps[FEW + 1 :]]
    for query, best in few.shortlists.items():
        compared = {one.database_id for one in few.closures if one.query_id == query}
        assert {candidate.id for candidate in best} == compared
        assert best[0].votes >= best[1].votes
    assert "shortlist" in few.seconds
    assert "shortlist" not in whole.seconds


def test_few_submaps_are_all_compared(demo: Dataset, whole: DetectionResult, memo: Memo) -> None:
    for candidates in ("automatic", 7, 100):
        result = detect_loop_closures(demo, PARAMS, memo=memo, candidates=candidates)
        one, other = (
            content_of(report_closures(demo, replace(found, seconds={}), PARAMS))
            for found in (result, whole)
        )
        assert one == other


def test_true_pairs_that_were_not_compared_are_missed(
    demo: Dataset, whole: DetectionResult
) -> None:
    params = EvaluationParams(neighbours=0, num_resamples=0)
    true = [one for one in whole.closures if one.accepted]
    assert true
    kept = tuple(one for one in whole.closures if one is not true[0])
    both = evaluate(demo, {"all": whole, "few": replace(whole, closures=kept)}, params)
    for of_all, of_few in zip(both.methods[0].rules, both.methods[1].rules, strict=True):
        counted = of_all.accepted_true + of_all.missed
        assert counted == of_few.accepted_true + of_few.missed
        assert of_few.missed == of_all.missed + (of_all.accepted_true - of_few.accepted_true)
    missed = [method.rules[1].missed for method in both.methods]
    assert missed[1] == missed[0] + 1


def _no_room(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.slow
@pytest.mark.parametrize("room", [True, False], ids=["room", "no room"])
def test_processes_find_the_same_candidates(
    demo: Dataset, memo: Memo, monkeypatch: pytest.MonkeyPatch, room: bool
) -> None:
    for name in ("LEARN_FROM", "FEWEST_DESCRIPTORS"):  # else a vocabulary takes 64 submaps
        monkeypatch.setattr(f"gpgrad_core.detection.shortlist.{name}", 4)
    alone = detect_loop_closures(demo, PARAMS, memo=memo, candidates=FEW)
    if not room:
        monkeypatch.setattr("numpy.save", _no_room)
    with workers(2, 10**6) as executor:
        beside = detect_loop_closures(demo, PARAMS, executor=executor, candidates=FEW)
    assert list(beside.shortlists.items()) == list(alone.shortlists.items())
    similarities = [one.similarity for best in alone.shortlists.values() for one in best]
    assert any(similarities)
    one, other = (
        content_of(report_closures(demo, replace(found, seconds={}), PARAMS))
        for found in (beside, alone)
    )
    assert one == other


def test_a_method_without_keypoints_is_refused_before_the_work(demo: Dataset) -> None:
    for methods in (["chance"], ["gradient", "chance"]):
        with pytest.raises(InputError, match="method chance: the detector has no keypoints"):
            run_methods(demo, [find_method(name) for name in methods], PARAMS, candidates=3)
    found = run_methods(demo, [find_method("chance")], PARAMS)
    assert found["chance"].num_pairs_skipped == 0
