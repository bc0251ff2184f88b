"""Verdicts of any tool, brought into the order of the truth."""

import numpy as np
import pytest

from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import measure_pairs, pose_errors, rank_pairs
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.types import Dataset, LoopClosure
from tests.core.evaluation.conftest import RIGHT, record, report


def test_a_result_and_its_file_rank_alike(dataset: Dataset, result: DetectionResult) -> None:
    pairs = measure_pairs(dataset)
    direct = rank_pairs(result, dataset, pairs, "a")
    filed = rank_pairs(report_closures(dataset, result, PipelineParams()), dataset, pairs, "a")
    assert direct.score.tolist() == filed.score.tolist()
    assert direct.num_inliers.tolist() == filed.num_inliers.tolist()
    assert direct.accepted.tolist() == filed.accepted.tolist()
    assert direct.seconds == filed.seconds
    assert direct.notes == filed.notes == ()
    assert max(direct.score) == 9.0


def test_a_pair_may_stand_either_way_round(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    there = report(record("003", "000", 2.0, RIGHT))
    back = report(record("000", "003", 2.0, RIGHT.inverse()))
    for listed in (there, back):
        ranking = rank_pairs(listed, dataset, pairs, "other")
        (row,) = np.flatnonzero(np.isfinite(ranking.score))
        errors = pose_errors(ranking.T_database_query, pairs.T_database_query)
        assert errors.offset[row] == pytest.approx(0, abs=1e-12)
        assert errors.turn[row] == pytest.approx(0, abs=1e-12)


def test_pairs_that_are_not_listed_rank_last_and_are_told_of(dataset: Dataset) -> None:
    ranking = rank_pairs(report(record("003", "000")), dataset, measure_pairs(dataset), "other")
    assert np.isneginf(ranking.score).sum() == 9
    assert ranking.notes == ("other lists 1 of 10 pairs: the others rank last",)
    assert not ranking.accepted.any()


@pytest.mark.parametrize(
    ("pairs", "said"),
    [
        ([record("007", "000")], r"other: pair 007, 000: squares has no submap '007'"),
        ([record("001", "001")], r"a submap cannot close a loop with itself"),
        ([record("001", "000"), record("000", "001")], r"pair 000, 001: is listed twice"),
        ([record("001", "000", float("nan"))], r"the score must be a finite number, got nan"),
        ([record("001", "000", float("inf"))], r"the score must be a finite number, got inf"),
    ],
)
def test_what_does_not_fit_is_refused(
    dataset: Dataset, pairs: list[LoopClosure], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        rank_pairs(report(*pairs), dataset, measure_pairs(dataset), "other")
