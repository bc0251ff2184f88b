"""Verdicts of any tool in the order of the truth; curves by hand and against scikit-learn; ties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Interval,
    average_precision,
    best_f1,
    pose_errors,
    precision_by_inliers,
    rank_pairs,
    recall_at_full_precision,
)
from gpgrad_core.evaluation.precision_recall import draw_weights, precision_recall, resample
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.types import LoopClosure
from tests.core.evaluation.squares import DATASET, PAIRS, RESULT, RIGHT, closure, report
from tests.support.laws import examples

# Few different scores, so that ties are common.
rankings = st.lists(st.tuples(st.integers(-3, 6), st.booleans()), min_size=1, max_size=40).filter(
    lambda rows: any(label for _, label in rows)
)


def split(rows: list[tuple[int, bool]]) -> tuple[np.ndarray, np.ndarray]:
    scores, labels = zip(*rows, strict=True)
    return np.array(scores, dtype=float), np.array(labels)


def test_where_nothing_passes_precision_is_unknown() -> None:
    curve = precision_by_inliers(np.array([3, 2, 0]), np.array([True, False, True]), most=4)
    assert curve.thresholds.tolist() == [1, 2, 3, 4]
    assert curve.precision.tolist()[:3] == [0.5, 0.5, 1.0]
    assert np.isnan(curve.precision[3])
    assert curve.recall.tolist() == [0.5, 0.5, 0.5, 0.0]
    assert recall_at_full_precision(curve) == 0.5


def test_nothing_to_recall_is_an_error() -> None:
    with pytest.raises(ValueError, match="at least one positive"):
        precision_recall(np.zeros(3), np.zeros(3, dtype=bool))


@examples(40)
@given(rankings)
def test_agrees_with_scikit_learn(rows: list[tuple[int, bool]]) -> None:
    # It takes a second to load, and all test processes import this module.
    from sklearn import metrics  # noqa: PLC0415

    score, positive = split(rows)
    # Pairs that were never considered rank last.
    score = np.maximum(score, -1.0)
    curve = precision_recall(np.where(score < 0, -np.inf, score), positive)
    precision, recall, thresholds = metrics.precision_recall_curve(positive, score)
    assert np.maximum(curve.thresholds, -1.0).tolist() == thresholds[::-1].tolist()
    np.testing.assert_allclose(curve.precision, precision[-2::-1])
    np.testing.assert_allclose(curve.recall, recall[-2::-1])
    assert average_precision(curve) == pytest.approx(
        metrics.average_precision_score(positive, score)
    )
    assert recall_at_full_precision(curve) == recall[:-1][precision[:-1] == 1].max(initial=0.0)
    f1, threshold = best_f1(curve)
    every = {at: metrics.f1_score(positive, score >= at) for at in thresholds}
    best = every[max(threshold, -1.0)]
    assert f1 == pytest.approx(max(every.values())) == pytest.approx(best)


@examples(40)
@given(rankings, st.integers(0, 2**31))
def test_a_pair_drawn_twice_counts_as_two(rows: list[tuple[int, bool]], seed: int) -> None:
    score, positive = split(rows)
    drawn_once = np.ones(len(score), int)
    some = np.random.default_rng(seed).integers(0, 4, len(score))
    sampled = resample(score, positive, np.array([drawn_once, some], float))
    for k, weights in enumerate((drawn_once, some)):
        drawn = np.repeat(np.arange(len(score)), weights)
        if not positive[drawn].any():
            assert np.isnan(sampled.average_precision[k])
            continue
        curve = precision_recall(score[drawn], positive[drawn])
        assert sampled.average_precision[k] == pytest.approx(average_precision(curve))
        assert sampled.recall_at_full_precision[k] == pytest.approx(recall_at_full_precision(curve))
        assert sampled.f1[k] == pytest.approx(best_f1(curve)[0])


def test_a_pair_counts_as_often_as_both_its_submaps_are_drawn() -> None:
    weights = draw_weights(PAIRS, 4000, seed=1)
    assert weights.shape == (4000, len(PAIRS))
    # E[c_i c_j] = n (n - 1) / n² for two of n counts that add up to n.
    assert weights.mean(axis=0) == pytest.approx(np.full(len(PAIRS), 0.8), abs=0.06)
    # Where a submap is not drawn, none of its pairs is.
    with_first = PAIRS.database == 0
    absent = weights[:, with_first].sum(axis=1) == 0
    assert 0.2 < absent.mean() < 0.5  # (1 - 1/5)^5 = 0.33


def test_an_interval_is_the_middle_95_percent() -> None:
    samples = np.r_[np.arange(1001.0), np.nan]
    assert Interval.of(samples) == Interval(25.0, 975.0)
    assert Interval.of(np.array([np.nan])) is None
    assert Interval.of(np.zeros(0)) is None


def test_a_result_and_its_file_rank_alike() -> None:
    direct = rank_pairs(RESULT, DATASET, PAIRS, "a")
    filed = rank_pairs(report_closures(DATASET, RESULT, PipelineParams()), DATASET, PAIRS, "a")
    for name in ("score", "num_inliers", "accepted"):
        assert getattr(direct, name).tolist() == getattr(filed, name).tolist()
    assert direct.seconds == filed.seconds
    assert direct.notes == filed.notes == ()
    assert max(direct.score) == 9.0


def test_a_pair_may_stand_either_way_round() -> None:
    there = report(closure("003", "000", 2.0, RIGHT))
    back = report(closure("000", "003", 2.0, RIGHT.inverse()))
    for listed in (there, back):
        ranking = rank_pairs(listed, DATASET, PAIRS, "other")
        (row,) = np.flatnonzero(np.isfinite(ranking.score))
        errors = pose_errors(ranking.T_database_query, PAIRS.T_database_query)
        assert errors.offset[row] == pytest.approx(0, abs=1e-12)
        assert errors.turn[row] == pytest.approx(0, abs=1e-12)


def test_pairs_that_are_not_listed_rank_last_and_are_told_of() -> None:
    ranking = rank_pairs(report(closure("003", "000")), DATASET, PAIRS, "other")
    assert np.isneginf(ranking.score).sum() == 9
    assert ranking.notes == ("other lists 1 of 10 pairs: the others rank last",)
    assert not ranking.accepted.any()


@pytest.mark.parametrize(
    ("pairs", "said"),
    [
        ([closure("007", "000")], r"other: pair 007, 000: squares has no submap '007'"),
        ([closure("001", "001")], r"a submap cannot close a loop with itself"),
        ([closure("001", "000"), closure("000", "001")], r"pair 000, 001: is listed twice"),
        ([closure("001", "000", float("nan"))], r"the score must be a finite number, got nan"),
        ([closure("001", "000", float("inf"))], r"the score must be a finite number, got inf"),
    ],
)
def test_what_does_not_fit_is_refused(pairs: list[LoopClosure], said: str) -> None:
    with pytest.raises(InputError, match=said):
        rank_pairs(report(*pairs), DATASET, PAIRS, "other")
