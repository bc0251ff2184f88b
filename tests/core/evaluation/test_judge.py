"""The verb: counts, leads and intervals of detections made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import Accepted, EvaluationParams, Interval, evaluate
from gpgrad_core.types import Dataset
from tests.core.evaluation.conftest import closure, report

QUICK = EvaluationParams(num_resamples=0)


def test_verdicts_by_both_rules(dataset: Dataset, result: DetectionResult) -> None:
    (method,) = evaluate(dataset, {"mine": result}, QUICK).methods
    box, surface = method.rules
    assert (box.accepted_true, box.accepted_false, box.missed) == (1, 1, 0)
    assert (box.accepted_grey, box.accepted_grey_near) == (1, 1)
    assert (surface.accepted_true, surface.accepted_false, surface.missed) == (2, 1, 0)
    assert surface.accepted_grey == 0
    for verdict in (box, surface):
        assert verdict.ranked.average_precision.value == 1.0
        assert verdict.ranked.recall_at_full_precision.value == 1.0
        assert verdict.near == 1.0
    assert (box.ranked.f1.value, box.ranked.f1.threshold) == (1.0, 9.0)
    assert box.pose_error.count == 1
    assert box.pose_error.median_offset == pytest.approx(0.05)
    assert box.pose_error.median_turn == pytest.approx(0.02)


def test_breakdowns_count_every_touching_and_every_true_pair(
    dataset: Dataset, result: DetectionResult
) -> None:
    evaluation = evaluate(dataset, {"mine": result})
    box, surface = evaluation.methods[0].rules
    assert sum(counts.pairs for counts in box.by_overlap) == 2  # 03 and 04; 34 are neighbours
    assert sum(counts.pairs for counts in box.by_yaw) == 1
    assert box.by_yaw[-1].pairs == 1  # turned about
    assert sum(counts.pairs for counts in surface.by_yaw) == 2
    assert surface.by_yaw[0].pairs == 1  # 04 is not turned


def test_neighbours_count_where_asked_for(dataset: Dataset, result: DetectionResult) -> None:
    params = EvaluationParams(neighbours=0)
    box = evaluate(dataset, {"mine": result}, params).methods[0].rules[0]
    assert box.missed == 1  # 34, which is true and was not accepted
    assert box.near == 0.5


def test_methods_are_set_against_the_first(dataset: Dataset, result: DetectionResult) -> None:
    worst = replace(
        result,
        closures=tuple(
            replace(pair, registration=replace(pair.registration, score=-pair.registration.score))
            for pair in result.closures
        ),
    )
    evaluation = evaluate(dataset, {"good": result, "bad": worst, "again": result})
    leads = [method.rules[0].ranked.lead for method in evaluation.methods if method.rules[0].ranked]
    assert leads[0] is None
    assert leads[1].value == pytest.approx(1 - 1 / 5)  # the true pair comes last of five
    assert 0 <= leads[1].interval.low < leads[1].value <= leads[1].interval.high
    assert (leads[2].value, leads[2].interval) == (0.0, Interval(0.0, 0.0))


def test_the_same_seed_gives_the_same_intervals(dataset: Dataset, result: DetectionResult) -> None:
    noisy = DetectionResult(
        tuple(
            replace(pair, registration=replace(pair.registration, score=float(k % 3)))
            for k, pair in enumerate(result.closures)
        ),
        {},
    )
    params = EvaluationParams(num_resamples=50)

    def interval(seed: int) -> object:
        ranked = evaluate(dataset, {"m": noisy}, params, seed=seed).methods[0].rules[0].ranked
        return ranked.average_precision.interval

    assert interval(1) == interval(1) != interval(2)


def test_without_true_pairs_false_ones_are_still_counted(
    dataset: Dataset, result: DetectionResult
) -> None:
    evaluation = evaluate(dataset, {"mine": result}, EvaluationParams(min_overlap=0.95))
    box, surface = evaluation.methods[0].rules
    assert box.ranked is None
    assert (box.near, box.pose_error.median_offset) == (None, None)
    assert (box.accepted_true, box.accepted_false, box.accepted_grey) == (0, 1, 2)
    assert surface.ranked is not None


def test_no_resamples_no_intervals(dataset: Dataset, result: DetectionResult) -> None:
    evaluation = evaluate(dataset, {"a": result, "b": result}, EvaluationParams(num_resamples=0))
    ranked = evaluation.methods[1].rules[0].ranked
    assert ranked.average_precision.interval is None
    assert ranked.lead.interval is None


def test_an_outside_file_is_judged_like_a_method(dataset: Dataset) -> None:
    outside = report(closure("003", "000", 2.0, accepted=True))
    evaluation = evaluate(dataset, {"outside": outside})
    box = evaluation.methods[0].rules[0]
    assert (box.accepted_true, box.accepted_false) == (1, 0)
    assert box.pose_error.median_offset == np.inf  # accepted, and placed nowhere
    assert evaluation.notes == ("outside lists 1 of 10 pairs: the others rank last",)


def test_names_for_files_are_plain_and_different(dataset: Dataset) -> None:
    names = ("a b", "a/b", "../", "µ-1")
    evaluation = evaluate(dataset, dict.fromkeys(names, report(closure("003", "000"))))
    assert evaluation.file_names == ("a_b", "a_b_2", "method", "µ-1")


def test_nothing_to_judge_is_refused(dataset: Dataset) -> None:
    with pytest.raises(InputError, match="nothing to evaluate"):
        evaluate(dataset, {})


def test_a_closure_is_right_only_if_its_motion_is(
    dataset: Dataset, result: DetectionResult
) -> None:
    def accepted(**changes: float) -> Accepted:
        (method,) = evaluate(dataset, {"mine": result}, replace(QUICK, **changes)).methods
        return method.accepted

    assert accepted() == Accepted(right=2, wrong_motion=0, no_overlap=1)
    assert accepted().count == 3
    # A hand's breadth off is wrong for who asks for less.
    for changes in ({"max_offset_error": 0.02}, {"max_turn_error": 0.5}):
        assert accepted(**changes) == Accepted(right=1, wrong_motion=1, no_overlap=1)
