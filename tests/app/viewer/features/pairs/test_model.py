from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app.viewer.features.pairs import model
from app.viewer.features.pairs.matrix import gather_all
from app.viewer.features.pairs.model import (
    RULES,
    PairsRun,
    compare_pairs,
    detect,
    judge,
)
from app.viewer.session.decisions import ACCEPTED, MISSED, NO_OVERLAP, REFUSED, RIGHT, WRONG_MOTION
from app.viewer.session.state import open_dataset, with_params
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.evaluation.rules import Rule
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Cancelled, parallel
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store
from gpgrad_core.types import Dataset
from tests.support.synthetic import (
    MISPLACED,
    PAIR_SCORES,
    closures_alone,
    make_compared,
    make_dataset,
)

BOX = next(iter(RULES.values()))
COMPARED = make_compared()
"""Four submaps; 003 truly lies on 000, and the boxes of some others touch."""
SMALL = replace(
    COMPARED.dataset,
    submaps=tuple(
        replace(submap, pose_true=submap.pose_odometry)
        for submap in make_dataset(num_points=200).submaps
    ),
)
COARSE = PipelineParams(map=MapParams(length_scale=0.5, noise_std=0.05, resolution=0.2))
MEMO = Memo()
"""Holds the maps of `SMALL`, which take longer than the comparisons."""


def run_of(dataset: Dataset, params: PipelineParams) -> PairsRun:
    return PairsRun(open_dataset(dataset, params))


def scores(run: PairsRun) -> dict[tuple[str, str], float]:
    return {closure.pair: closure.registration.score for closure in closures_alone(run)}


def outcomes(min_score: float, rule: Rule = BOX) -> dict[tuple[str, str], str]:
    return dict(judge(COMPARED, ClosureParams(0, min_score), rule).outcomes)


def test_thresholds_turn_verdicts_without_registering_anew() -> None:
    few = judge(COMPARED, ClosureParams(min_inliers=0, min_score=4.5), BOX)
    many = judge(COMPARED, ClosureParams(min_inliers=0, min_score=0.5), BOX)
    none = judge(COMPARED, ClosureParams(min_inliers=500, min_score=0.0), BOX)
    assert [judged.num_accepted for judged in (few, many, none)] == [1, 5, 0]
    for closure in few.closures:
        assert closure.registration is COMPARED.registered[closure.pair]


def test_outcomes_by_the_truth() -> None:
    accepting = outcomes(0.5)
    assert accepting["003", "000"] == RIGHT
    assert accepting["002", "000"] == NO_OVERLAP  # accepted, and truly far away
    assert accepting[MISPLACED] == WRONG_MOTION
    assert outcomes(5.5)["003", "000"] == MISSED
    assert outcomes(5.5)["002", "000"] == REFUSED


def test_the_operating_point_lies_on_the_curve() -> None:
    for min_score in (0.5, 2.5, 4.5):
        for min_inliers in (0, 12):
            check = judge(COMPARED, ClosureParams(min_inliers, min_score), BOX).check
            assert check is not None
            assert check.curve is not None
            at = np.flatnonzero(check.curve.thresholds >= min_score)[-1]
            assert check.precision == check.curve.precision[at]
            assert check.recall == check.curve.recall[at]


def test_figures_by_hand() -> None:
    judged = judge(COMPARED, ClosureParams(0, 0.5), BOX)
    check = judged.check
    assert check is not None
    # Of the pairs that the box rule judges only 003 -> 000 is true, and it has the highest score.
    assert check.recall == 1.0
    assert check.average_precision == 1.0
    accepted = {pair for pair, score in PAIR_SCORES.items() if score >= 0.5}
    assert check.precision == 1 / len(judged.truths.keys() & accepted)


def test_without_truth_there_are_verdicts_only() -> None:
    judged = judge(replace(COMPARED, truth=None), ClosureParams(0, 0.5), BOX)
    assert judged.check is None
    assert set(judged.outcomes.values()) == {ACCEPTED, REFUSED}
    assert judged.truths == {}
    assert np.isnan(gather_all(judged).overlaps).all()


def test_a_comparison_registers_all_pairs_and_measures_the_truth() -> None:
    told: list[float] = []
    run = run_of(SMALL, COARSE)
    compare_pairs(run, MEMO, told.append)
    assert len(closures_alone(run)) == 6
    assert run.truth is not None
    np.testing.assert_array_equal(run.truth.box_iou, measure_pairs(SMALL).box_iou)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow
def test_processes_compare_many_pairs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    params = PipelineParams(map=replace(PipelineParams().map, resolution=0.1))
    here, there = (run_of(COMPARED.dataset, params) for _ in range(2))
    compare_pairs(here, Memo())
    monkeypatch.setattr(model, "MANY_PAIRS", 6)
    monkeypatch.setattr(parallel, "WORTH_PROCESSES", 6)
    memo = Memo(store=Store(tmp_path / "store"))
    compare_pairs(there, memo)
    assert scores(there) == pytest.approx(scores(here))
    num_kept = sum(path.is_file() for path in (tmp_path / "store").rglob("*"))
    assert num_kept >= 6
    assert memo.num_bytes < 10_000_000  # the maps stay in the processes


def test_a_cancelled_run_goes_on_with_the_pairs_that_are_missing() -> None:
    whole, run = (run_of(SMALL, COARSE) for _ in range(2))
    compare_pairs(whole, MEMO)
    assert whole.num_left == 0

    def stop(fraction: float) -> None:  # noqa: ARG001
        if len(run.registered) >= 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        compare_pairs(run, Memo(), stop)
    num_done = len(run.registered)
    assert 2 <= num_done < run.num_pairs == 6
    part = judge(run.so_far(), ClosureParams(), BOX)
    assert len(part.closures) == num_done
    assert run.so_far().num_left == run.num_left == 6 - num_done
    assert part.check is not None  # the truth was measured before the first pair
    kept = dict(run.registered)
    compare_pairs(run, Memo())
    assert scores(run) == pytest.approx(scores(whole))
    assert all(run.registered[pair] is registration for pair, registration in kept.items())


def test_an_export_has_the_pairs_of_a_run_that_has_ended() -> None:
    run = PairsRun(open_dataset(SMALL, COARSE), 1)
    compare_pairs(run, MEMO)
    shown = judge(run, COARSE.closure, BOX)
    stricter = replace(COARSE, closure=ClosureParams(min_score=1e6))
    found = detect(replace(run, state=with_params(run.state, stricter)), MEMO)
    assert [closure.pair for closure in found.closures] == [row.pair for row in shown.closures]
    assert len(found.closures) == run.num_pairs == 3
    for closure, other in zip(found.closures, shown.closures, strict=True):
        assert closure.registration is other.registration
        assert not closure.accepted
    assert found.params is not None
    assert found.params.closure == stricter.closure
    assert found.shortlists.keys() == {"002", "003"}


def test_a_run_is_of_its_registration_parameters_and_candidates() -> None:
    run = run_of(COMPARED.dataset, PipelineParams())
    state = run.state
    other = with_params(state, replace(state.params, closure=ClosureParams(20, 9.0)))
    assert run.is_of(other)  # thresholds do not register
    assert run.registers_as(PairsRun(other))
    smoother = replace(state.params, map=replace(state.params.map, length_scale=0.5))
    assert not run.is_of(with_params(state, smoother))
    assert not run.registers_as(PairsRun(state, 5))
    assert not run.registers_as(run_of(make_dataset(), PipelineParams()))
