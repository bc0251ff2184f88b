"""Verdicts of any tool in the order of the truth; curves by hand and against scikit-learn; ties."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Interval,
    average_precision,
    best_f1,
    measure_pairs,
    pose_errors,
    precision_by_inliers,
    rank_pairs,
    recall_at_full_precision,
)
from gpgrad_core.evaluation.precision_recall import draw_weights, precision_recall, resample
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.types import Dataset, LoopClosure
from tests.core.evaluation.conftest import RIGHT, closure, report
from tests.support.laws import examples

# Few different scores, so that ties are common.
rankings = st.lists(st.tuples(st.integers(-3, 6), st.booleans()), min_size=1, max_size=40).filter(
    lambda rows: any(label for _, label in rows)
)


def split(rows: list[tuple[int, bool]]) -> tuple[np.ndarray, np.ndarray]:
    scores, labels = zip(*rows, strict=True)
    return np.array(scores, dtype=float), np.array(labels)


def test_a_curve_by_hand() -> None:
    # Right, wrong, right, wrong.
    curve = precision_recall(np.array([5.0, 4.0, 3.0, 1.0]), np.array([True, False, True, False]))
    assert curve.thresholds.tolist() == [5, 4, 3, 1]
    assert curve.precision.tolist() == [1, 1 / 2, 2 / 3, 1 / 2]
    assert curve.recall.tolist() == [1 / 2, 1 / 2, 1, 1]
    assert average_precision(curve) == pytest.approx(0.5 * 1 + 0.5 * 2 / 3)
    assert recall_at_full_precision(curve) == 0.5
    assert best_f1(curve) == (pytest.approx(0.8), 3.0)


def test_pairs_of_one_score_pass_together() -> None:
    positive = np.array([True, False, True, False])
    curve = precision_recall(np.array([5.0, 5.0, 3.0, 1.0]), positive)
    assert curve.thresholds.tolist() == [5, 3, 1]
    assert curve.precision.tolist() == [1 / 2, 2 / 3, 1 / 2]
    assert recall_at_full_precision(curve) == 0.0
    all_tied = precision_recall(np.zeros(4), positive)
    assert average_precision(all_tied) == 0.5  # no better than chance, whatever their order


def test_pairs_never_considered_rank_last() -> None:
    curve = precision_recall(np.array([2.0, -np.inf, -np.inf]), np.array([True, True, False]))
    assert curve.thresholds.tolist() == [2, -np.inf]
    assert average_precision(curve) == pytest.approx(0.5 + 0.5 * 2 / 3)


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
    curve = precision_recall(score, positive)
    precision, recall, thresholds = metrics.precision_recall_curve(positive, score)
    assert curve.thresholds.tolist() == thresholds[::-1].tolist()
    np.testing.assert_allclose(curve.precision, precision[-2::-1])
    np.testing.assert_allclose(curve.recall, recall[-2::-1])
    assert average_precision(curve) == pytest.approx(
        metrics.average_precision_score(positive, score)
    )
    f1, threshold = best_f1(curve)
    assert f1 == pytest.approx(metrics.f1_score(positive, score >= threshold))


@examples(40)
@given(rankings)
def test_a_resample_that_draws_each_pair_once_changes_nothing(rows: list[tuple[int, bool]]) -> None:
    score, positive = split(rows)
    curve = precision_recall(score, positive)
    same = resample(score, positive, np.ones((2, len(score))))
    assert same.average_precision == pytest.approx([average_precision(curve)] * 2)
    assert same.recall_at_full_precision == pytest.approx([recall_at_full_precision(curve)] * 2)
    assert same.f1 == pytest.approx([best_f1(curve)[0]] * 2)


@examples(40)
@given(rankings, st.integers(0, 2**31))
def test_a_pair_drawn_twice_counts_as_two(rows: list[tuple[int, bool]], seed: int) -> None:
    score, positive = split(rows)
    weights = np.random.default_rng(seed).integers(0, 4, (1, len(score)))
    drawn = np.repeat(np.arange(len(score)), weights[0])
    sampled = resample(score, positive, weights.astype(float))
    if positive[drawn].any():
        curve = precision_recall(score[drawn], positive[drawn])
        assert sampled.average_precision[0] == pytest.approx(average_precision(curve))
        assert sampled.recall_at_full_precision[0] == pytest.approx(recall_at_full_precision(curve))
        assert sampled.f1[0] == pytest.approx(best_f1(curve)[0])
    else:
        assert np.isnan(sampled.average_precision[0])
        assert np.isnan(sampled.recall_at_full_precision[0])


def test_a_pair_counts_as_often_as_both_its_submaps_are_drawn(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    weights = draw_weights(pairs, 4000, seed=1)
    assert weights.shape == (4000, len(pairs))
    # E[c_i c_j] = n (n - 1) / n² for two of n counts that add up to n.
    assert weights.mean(axis=0) == pytest.approx(np.full(len(pairs), 0.8), abs=0.06)
    # Where a submap is not drawn, none of its pairs is.
    with_first = pairs.database == 0
    absent = weights[:, with_first].sum(axis=1) == 0
    assert 0.2 < absent.mean() < 0.5  # (1 - 1/5)^5 = 0.33


def test_an_interval_is_the_middle_95_percent() -> None:
    samples = np.r_[np.arange(1001.0), np.nan]
    assert Interval.of(samples) == Interval(25.0, 975.0)
    assert Interval.of(np.array([np.nan])) is None
    assert Interval.of(np.zeros(0)) is None


def test_a_result_and_its_file_rank_alike(dataset: Dataset, result: DetectionResult) -> None:
    pairs = measure_pairs(dataset)
    direct = rank_pairs(result, dataset, pairs, "a")
    filed = rank_pairs(report_closures(dataset, result, PipelineParams()), dataset, pairs, "a")
    for name in ("score", "num_inliers", "accepted"):
        assert getattr(direct, name).tolist() == getattr(filed, name).tolist()
    assert direct.seconds == filed.seconds
    assert direct.notes == filed.notes == ()
    assert max(direct.score) == 9.0


def test_a_pair_may_stand_either_way_round(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    there = report(closure("003", "000", 2.0, RIGHT))
    back = report(closure("000", "003", 2.0, RIGHT.inverse()))
    for listed in (there, back):
        ranking = rank_pairs(listed, dataset, pairs, "other")
        (row,) = np.flatnonzero(np.isfinite(ranking.score))
        errors = pose_errors(ranking.T_database_query, pairs.T_database_query)
        assert errors.offset[row] == pytest.approx(0, abs=1e-12)
        assert errors.turn[row] == pytest.approx(0, abs=1e-12)


def test_pairs_that_are_not_listed_rank_last_and_are_told_of(dataset: Dataset) -> None:
    ranking = rank_pairs(report(closure("003", "000")), dataset, measure_pairs(dataset), "other")
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
def test_what_does_not_fit_is_refused(
    dataset: Dataset, pairs: list[LoopClosure], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        rank_pairs(report(*pairs), dataset, measure_pairs(dataset), "other")
