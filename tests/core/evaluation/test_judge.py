"""The verb: counts, leads and intervals of detections made by hand."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Accepted,
    EvaluationParams,
    Interval,
    MethodVerdict,
    Ranked,
    evaluate,
)
from tests.core.evaluation.squares import DATASET, RESULT, closure, report

QUICK = EvaluationParams(num_resamples=0)


def verdict(**changes: float) -> MethodVerdict:
    (method,) = evaluate(DATASET, {"mine": RESULT}, replace(QUICK, **changes)).methods
    return method


def ranked(detections: dict[str, DetectionResult], num_resamples: int, seed: int) -> list[Ranked]:
    """How well each method ranks the pairs by the first rule."""
    params = EvaluationParams(num_resamples=num_resamples)
    methods = evaluate(DATASET, detections, params, seed=seed).methods
    return [method.rules[0].ranked for method in methods if method.rules[0].ranked is not None]


def with_scores(scores: list[float]) -> DetectionResult:
    closures = tuple(
        replace(pair, registration=replace(pair.registration, score=score))
        for pair, score in zip(RESULT.closures, scores, strict=True)
    )
    return replace(RESULT, closures=closures)


def test_verdicts_by_both_rules() -> None:
    box, surface = verdict().rules
    assert (box.accepted_true, box.accepted_false, box.missed) == (1, 1, 0)
    assert (box.accepted_grey, box.accepted_grey_near) == (1, 1)
    assert (surface.accepted_true, surface.accepted_false, surface.missed) == (2, 1, 0)
    assert surface.accepted_grey == 0
    for rule in (box, surface):
        assert rule.ranked.average_precision.value == 1.0
        assert rule.ranked.recall_at_full_precision.value == 1.0
        assert rule.near == 1.0
    assert (box.ranked.f1.value, box.ranked.f1.threshold) == (1.0, 9.0)
    assert box.pose_error.count == 1
    assert box.pose_error.median_offset == pytest.approx(0.05)
    assert box.pose_error.median_turn == pytest.approx(0.02)


def test_breakdowns_count_every_touching_and_every_true_pair() -> None:
    box, surface = verdict().rules
    assert sum(counts.pairs for counts in box.by_overlap) == 2  # 03 and 04; 34 are neighbours
    assert sum(counts.pairs for counts in box.by_yaw) == 1
    assert box.by_yaw[-1].pairs == 1  # turned about
    assert sum(counts.pairs for counts in surface.by_yaw) == 2
    assert surface.by_yaw[0].pairs == 1  # 04 is not turned


def test_neighbours_count_where_asked_for() -> None:
    box, _ = verdict(neighbours=0).rules
    assert box.missed == 1  # 34, which is true and was not accepted
    assert box.near == 0.5


def test_methods_are_set_against_the_first() -> None:
    worst = with_scores([-pair.registration.score for pair in RESULT.closures])
    leads = [
        one.lead for one in ranked({"good": RESULT, "bad": worst, "again": RESULT}, 1000, seed=0)
    ]
    assert leads[0] is None
    assert leads[1].value == pytest.approx(1 - 1 / 5)  # the true pair comes last of five
    assert 0 <= leads[1].interval.low < leads[1].value <= leads[1].interval.high
    assert (leads[2].value, leads[2].interval) == (0.0, Interval(0.0, 0.0))


def test_the_same_seed_gives_the_same_intervals_and_no_resamples_none() -> None:
    noisy = {"m": with_scores([float(k % 3) for k in range(10)])}
    first, again, other = (
        ranked(noisy, 50, seed)[0].average_precision.interval for seed in (1, 1, 2)
    )
    assert first == again != other
    _, second = ranked({"a": RESULT, "b": RESULT}, 0, seed=1)
    assert second.average_precision.interval is None
    assert second.lead.interval is None


def test_without_true_pairs_false_ones_are_still_counted() -> None:
    box, surface = verdict(min_overlap=0.95).rules
    assert box.ranked is None
    assert (box.near, box.pose_error.median_offset) == (None, None)
    assert (box.accepted_true, box.accepted_false, box.accepted_grey) == (0, 1, 2)
    assert surface.ranked is not None


def test_in_a_notebook_shares_are_shown_where_there_are_true_pairs() -> None:
    for min_overlap, missing in ((0.95, 2), (0.5, 0)):
        params = replace(QUICK, min_overlap=min_overlap)
        html = evaluate(DATASET, {"mine": RESULT}, params)._repr_html_()
        assert html.count(">mine<") == 1
        assert html.count(">n/a<") == missing
        assert html.count("1.000") == 2 - missing


def test_an_outside_file_is_judged_like_a_method() -> None:
    outside = report(closure("003", "000", 2.0, accepted=True))
    evaluation = evaluate(DATASET, {"outside": outside}, QUICK)
    box = evaluation.methods[0].rules[0]
    assert (box.accepted_true, box.accepted_false) == (1, 0)
    assert box.pose_error.median_offset == np.inf  # accepted, and placed nowhere
    assert evaluation.notes == ("outside lists 1 of 10 pairs: the others rank last",)


def test_true_pairs_that_were_not_compared_are_missed() -> None:
    fewer = replace(RESULT, closures=tuple(c for c in RESULT.closures if c.pair != ("003", "000")))
    both = evaluate(DATASET, {"all": RESULT, "few": fewer}, QUICK).methods
    for of_all, of_few in zip(both[0].rules, both[1].rules, strict=True):
        assert of_few.missed == of_all.missed + 1
        assert of_few.accepted_true + of_few.missed == of_all.accepted_true + of_all.missed


def test_names_for_files_are_plain_and_different() -> None:
    names = ("a b", "a/b", "../", "µ-1")
    evaluation = evaluate(DATASET, dict.fromkeys(names, report(closure("003", "000"))), QUICK)
    assert evaluation.file_names == ("a_b", "a_b_2", "method", "µ-1")


def test_nothing_to_judge_is_refused() -> None:
    with pytest.raises(InputError, match="nothing to evaluate"):
        evaluate(DATASET, {})


def test_a_closure_is_right_only_if_its_motion_is() -> None:
    accepted = verdict().accepted
    assert accepted == Accepted(right=2, wrong_motion=0, no_overlap=1)
    assert accepted.count == 3
    # A hand's breadth off is wrong for who asks for less.
    for changes in ({"max_offset_error": 0.02}, {"max_turn_error": 0.5}):
        assert verdict(**changes).accepted == Accepted(right=1, wrong_motion=1, no_overlap=1)
