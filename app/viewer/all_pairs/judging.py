"""All pairs of a dataset: registered once, then judged anew whenever a threshold moves."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from math import comb, radians

import numpy as np

from app.viewer.methods import METHODS, MethodName
from app.viewer.outcomes import ACCEPTED, MISSED, NO_OVERLAP, REFUSED, RIGHT, WRONG_MOTION
from app.viewer.state import ViewState
from gpgrad_core.evaluation.overlap import TruePairs, measure_pairs
from gpgrad_core.evaluation.pose_error import (
    MAX_TURN,
    MotionClasses,
    classify_motions,
    pose_errors,
)
from gpgrad_core.evaluation.precision_recall import (
    PrecisionRecall,
    average_precision,
    precision_recall,
)
from gpgrad_core.evaluation.ranking import Ranking, rank_pairs
from gpgrad_core.evaluation.rules import EvaluationParams, Labels, Rule
from gpgrad_core.fitting import representative
from gpgrad_core.loop_closure import ClosureParams
from gpgrad_core.pipeline import (
    DetectionResult,
    MapDetector,
    PipelineParams,
    detect_loop_closures,
    judge_pair,
    resolve_parameters,
    store_for_run,
    with_store,
)
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.threads import num_workers
from gpgrad_core.shortlist import Candidates, num_wanted
from gpgrad_core.types import Dataset, LoopClosure

RULES: dict[str, Rule] = {rule.name: rule for rule in EvaluationParams().rules}
"""By name, when a pair counts as truly the same place."""


@dataclass(frozen=True, eq=False)
class ComparedPairs:
    """All pairs of a dataset with their registrations.

    Attributes:
        dataset: Whose pairs.
        params: That they were registered with.
        result: The registrations.
        truth: How far the pairs truly overlap; None where fewer than two true poses are known.
        method: That registered them.
    """

    dataset: Dataset
    params: PipelineParams
    result: DetectionResult
    truth: TruePairs | None
    method: MethodName = "gradient"

    def is_of(self, state: ViewState) -> bool:
        """Say whether a state would give the same registrations; most thresholds do not matter."""
        registered_by = METHODS[self.method].registered_by
        return (
            state.dataset is self.dataset
            and state.method == self.method
            and registered_by(state.given) == registered_by(self.params)
        )


@dataclass(frozen=True, eq=False)
class TruthCheck:
    """How the verdicts agree with the truth by one rule.

    Attributes:
        rule: When a pair is true.
        labels: What it says of the pairs, in the order of the truth.
        curve: Over the threshold on the score, the one on inliers as it is; None where no pair
            is true.
        precision: At the thresholds as they are; NaN where no judged pair is accepted.
        recall: At the thresholds as they are.
        average_precision: Area under the curve.
    """

    rule: Rule
    labels: Labels
    curve: PrecisionRecall | None
    precision: float
    recall: float
    average_precision: float


@dataclass(frozen=True, eq=False)
class JudgedPairs:
    """All pairs, judged at some thresholds.

    Attributes:
        compared: The pairs that were judged.
        closures: Every pair with its verdict, as `DetectionResult` orders them.
        check: The comparison with the truth, where that is known.
        outcomes: Of each closure: `RIGHT`, `WRONG_MOTION` or `NO_OVERLAP` if it was accepted and
            the truth is known, `MISSED` if it was wrongly refused, and else `ACCEPTED` or
            `REFUSED`.
        truths: What the truth says of each closure: `TRUE`, `APART`, or `UNKNOWN` where it is not
            known, or where the rule leaves the pair out.
    """

    compared: ComparedPairs
    closures: tuple[LoopClosure, ...]
    check: TruthCheck | None
    outcomes: tuple[str, ...]
    truths: tuple[str, ...]

    @property
    def num_skipped(self) -> int:
        """Number of pairs that were not compared."""
        return comb(len(self.compared.dataset.submaps), 2) - len(self.closures)

    @property
    def num_accepted(self) -> int:
        """Number of pairs accepted as loop closures."""
        return sum(closure.accepted for closure in self.closures)


IMAGES = Memo(200_000_000)
"""Keypoints of camera images, which are made when images are first asked for their verdict."""
MANY_PAIRS = 1000
"""From this number on, pairs are compared in processes of their own. That is faster, and leaves
this one to the pages."""
OF_A_PROCESS = 500_000_000
"""Bytes of results that each of them keeps; views and registrations are in the store."""
TRUE, APART, UNKNOWN = "true", "apart", "unknown"


def compare_pairs(
    dataset: Dataset,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
    candidates: Candidates = "automatic",
    method: MethodName = "gradient",
) -> ComparedPairs:
    """Register the pairs of a dataset, and measure how far they truly overlap.

    Args:
        dataset: Submaps in order.
        params: Of all stages.
        memo: Shared with whatever else needs maps of the same submaps.
        progress: Called from this thread; may raise Cancelled.
        candidates: With how many earlier submaps a submap is compared; see
            `detect_loop_closures`.
        method: That registers them.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    num_pairs = sum(num_wanted(candidates, k) for k in range(len(dataset.submaps)))
    detect = _detect_here if num_pairs < MANY_PAIRS else _detect_in_processes
    result = detect(dataset, params, memo, part(progress, 0.0, 0.97), candidates, method)
    truth = None
    if sum(submap.pose_true is not None for submap in dataset.submaps) >= 2:
        truth = measure_pairs(dataset, part(progress, 0.97, 1.0))
    return ComparedPairs(dataset, params, result, truth, method)


def _detect_here(
    dataset: Dataset,
    params: PipelineParams,
    memo: Memo,
    progress: Progress,
    candidates: Candidates,
    method: MethodName,
) -> DetectionResult:
    """Compare in threads, which leave what they make in the memo."""
    make = METHODS[method].detector
    with ThreadPoolExecutor(num_workers(), thread_name_prefix="all-pairs") as executor:
        return detect_loop_closures(
            dataset,
            params,
            detector=None if make is None else make(params, memo),
            candidates=candidates,
            executor=executor,
            memo=memo,
            progress=progress,
        )


def _detect_in_processes(
    dataset: Dataset,
    params: PipelineParams,
    memo: Memo,
    progress: Progress,
    candidates: Candidates,
    method: MethodName,
) -> DetectionResult:
    """Compare as ``gpgrad detect`` does; what it has compared is taken from the same store."""
    submaps = dataset.submaps
    some = [submaps[k] for k in representative(len(submaps))]
    make = METHODS[method].detector
    if make is None:
        params = resolve_parameters(some, params, memo)
    with (
        store_for_run(memo.store, len(submaps)) as store,
        workers(num_workers(), MANY_PAIRS) as executor,
    ):
        return detect_loop_closures(
            dataset,
            params,
            detector=with_store((make or MapDetector)(params, Memo(OF_A_PROCESS)), store),
            candidates=candidates,
            executor=executor,
            progress=progress,
        )


def judge(compared: ComparedPairs, thresholds: ClosureParams, rule: Rule) -> JudgedPairs:
    """Judge every pair, and compare the verdicts with the truth.

    Args:
        compared: The registered pairs.
        thresholds: Of the verdict.
        rule: When a pair is truly the same place.
    """
    submaps = {submap.id: submap for submap in compared.dataset.submaps}
    params = replace(compared.params, closure=thresholds)
    closures = tuple(
        judge_pair(
            submaps[closure.query_id],
            submaps[closure.database_id],
            closure.registration,
            params,
            IMAGES,
        )
        for closure in compared.result.closures
    )
    if compared.truth is None:
        plain = tuple(ACCEPTED if closure.accepted else REFUSED for closure in closures)
        return JudgedPairs(compared, closures, None, plain, len(closures) * (UNKNOWN,))
    truth = compared.truth
    labels = rule.label(truth)
    ranking = rank_pairs(DetectionResult(closures, {}), compared.dataset, truth, "all pairs")
    turn = np.pi if truth.positions_only else radians(MAX_TURN)
    errors = pose_errors(ranking.T_database_query, truth.T_database_query, max_turn=turn)
    classes = classify_motions(errors, truth.surface_overlap)
    check = _check(ranking, thresholds, rule, labels)
    rows = tuple(truth.rows.get(frozenset((one.query_id, one.database_id))) for one in closures)
    outcomes = _outcomes(rows, closures, labels, classes)
    return JudgedPairs(compared, closures, check, outcomes, _truths(rows, labels))


def _check(ranking: Ranking, thresholds: ClosureParams, rule: Rule, labels: Labels) -> TruthCheck:
    # A pair with too few inliers is not accepted at any score: then the curve runs through the
    # point at which the thresholds stand.
    could_pass = (ranking.num_inliers >= thresholds.min_inliers) & np.array(
        [motion is not None for motion in ranking.T_database_query], dtype=np.bool_
    )
    score = np.where(could_pass, ranking.score, -np.inf)[labels.judged]
    positive = labels.positive[labels.judged]
    accepted = ranking.accepted[labels.judged]
    right, named, total = int(np.sum(accepted & positive)), int(accepted.sum()), int(positive.sum())
    if total == 0:
        return TruthCheck(rule, labels, None, np.nan, np.nan, np.nan)
    full = precision_recall(score, positive)
    reached = full.thresholds > -np.inf
    curve = PrecisionRecall(full.thresholds[reached], full.precision[reached], full.recall[reached])
    return TruthCheck(
        rule,
        labels,
        curve,
        right / named if named else np.nan,
        right / total,
        average_precision(full),
    )


def _outcomes(
    rows: tuple[int | None, ...],
    closures: tuple[LoopClosure, ...],
    labels: Labels,
    classes: MotionClasses,
) -> tuple[str, ...]:
    found: list[str] = []
    for row, closure in zip(rows, closures, strict=True):
        if row is None:
            found.append(ACCEPTED if closure.accepted else REFUSED)
        elif not closure.accepted:
            found.append(MISSED if labels.judged[row] and labels.positive[row] else REFUSED)
        elif classes.right[row]:
            found.append(RIGHT)
        else:
            found.append(WRONG_MOTION if classes.wrong_motion[row] else NO_OVERLAP)
    return tuple(found)


def _truths(rows: tuple[int | None, ...], labels: Labels) -> tuple[str, ...]:
    return tuple(
        UNKNOWN
        if row is None or not labels.judged[row]
        else TRUE
        if labels.positive[row]
        else APART
        for row in rows
    )
