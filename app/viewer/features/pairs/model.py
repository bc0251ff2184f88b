"""The pairs of a session: a run that registers them, and what thresholds and truth make of each.

Matrix, scores, lists, pose graph and best pair show what is computed here once.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from math import comb, radians

import numpy as np
from jaxtyping import Float

from app.viewer.session.decisions import ACCEPTED, MISSED, NO_OVERLAP, REFUSED, RIGHT, WRONG_MOTION
from app.viewer.session.methods import METHODS
from app.viewer.session.news import Verdicts
from app.viewer.session.state import ViewState, same_search
from gpgrad_core.detection import (
    DetectionResult,
    MapDetector,
    Pairs,
    resolve_parameters,
    store_for_run,
    with_store,
)
from gpgrad_core.detection.pairs import PHASES as DETECTION_PHASES
from gpgrad_core.detection.shortlist import Candidates, num_candidates
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.evaluation.overlap import TruePairs, measure_pairs
from gpgrad_core.evaluation.precision_recall import (
    PrecisionRecall,
    Ranking,
    average_precision,
    precision_recall,
    rank_pairs,
)
from gpgrad_core.evaluation.rules import (
    MAX_TURN,
    EvaluationParams,
    Labels,
    Rule,
    classify_motions,
    pose_errors,
)
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import Array, Dataset, LoopClosure, PairOfIds, Registration

RULES: dict[str, Rule] = {rule.name: rule for rule in EvaluationParams().rules}
"""By name, when a pair counts as truly the same place."""
TRUTH_SHARE, FIT_SHARE = 0.03, 0.07
"""Parts of the progress that the truth and the fit of the parameters take."""
PHASES: dict[str, float] = {
    "measuring the truth": TRUTH_SHARE,
    "fitting parameters": TRUTH_SHARE + FIT_SHARE,
    **{
        name: TRUTH_SHARE + FIT_SHARE + (1.0 - TRUTH_SHARE - FIT_SHARE) * end
        for name, end in DETECTION_PHASES.items()
    },
}
"""The fraction at which each phase of comparing all pairs ends."""
MANY_PAIRS = 1000
"""From this number on, pairs are compared in processes of their own. That is faster, and leaves
this one to the pages."""
OF_A_PROCESS = 500_000_000
"""Bytes of results that each of them keeps; views and registrations are in the store."""
TOP_SHARE = 0.995
"""Scores above those of this share of the pairs have the last colour: a few are far above."""
TRUE, APART, UNKNOWN = "true", "apart", "unknown"


@dataclass(eq=False)
class PairsRun:
    """All pairs with the parameters of the moment of their request."""

    state: ViewState  # of the session at that moment
    candidates: Candidates = "automatic"
    # what was registered so far; a run that was cancelled goes on from there
    registered: dict[PairOfIds, Registration] = field(default_factory=dict[PairOfIds, Registration])
    # how far the pairs truly overlap, once that is measured; None without two true poses
    truth: TruePairs | None = None
    table: Pairs | None = None  # of what was registered, to be judged
    has_ended: bool = False  # whether every pair was compared

    @property
    def dataset(self) -> Dataset:
        return self.state.dataset

    @property
    def num_pairs(self) -> int:
        return sum(num_candidates(self.candidates, k) for k in range(len(self.dataset.submaps)))

    @property
    def num_left(self) -> int:
        return 0 if self.has_ended else self.num_pairs - len(self.registered)

    def is_of(self, state: ViewState) -> bool:
        """Whether a state would give the same registrations; most thresholds do not matter."""
        registered_by = METHODS[self.state.method].registered_by
        return same_search(self.state, state) and (
            registered_by(self.state.given) == registered_by(state.given)
        )

    def registers_as(self, other: "PairsRun") -> bool:
        """Whether another run registers the same pairs with the same parameters."""
        return self.candidates == other.candidates and self.is_of(other.state)

    def so_far(self) -> "PairsRun":
        """Make a snapshot, with a table of the pairs that were registered so far."""
        registered = dict(self.registered)
        table = Pairs.of(self.dataset.submaps, registered, self.state.given)
        return replace(self, registered=registered, table=table)


def compare_pairs(run: PairsRun, memo: Memo, progress: Progress = silent) -> None:
    """Measure how far the pairs of a dataset truly overlap, and register those that are missing.

    The run has every pair as soon as that is compared, and the truth before the first one; then the
    progress hook is called, from this thread.
    """
    if run.truth is None and len(run.dataset.true_poses) >= 2:
        run.truth = measure_pairs(run.dataset, part(progress, 0.0, TRUTH_SHARE))
    _register(run, memo, progress, TRUTH_SHARE)


def detect(run: PairsRun, memo: Memo, progress: Progress = silent) -> DetectionResult:
    """All pairs of a run as its thresholds judge them; `compare_pairs` without the truth."""
    _ = run.state.pair  # refuses one submap alone
    if run.table is None:
        _register(run, memo, progress)
    return _verdicts(run, run.state.given.closure)


def _verdicts(run: PairsRun, thresholds: ClosureParams) -> DetectionResult:
    assert run.table is not None
    found = run.table.result(run.table.judge(thresholds))
    return replace(found, params=replace(run.table.params, closure=thresholds))


def _register(run: PairsRun, memo: Memo, progress: Progress, begun: float = 0.0) -> None:
    """Register the missing pairs of a run, of whose progress a part has passed."""
    params, submaps = run.state.given, run.dataset.submaps
    make, numbers = METHODS[run.state.method].detector, params
    fitting, begun = part(progress, begun, begun + FIT_SHARE), begun + FIT_SHARE
    if make is None:
        numbers = resolve_parameters(submaps, params, memo, fitting)
    table = partial(
        Pairs, submaps, numbers, candidates=run.candidates, memo=memo, registered=run.registered
    )
    rest = part(progress, begun, 1.0)
    if run.num_pairs < MANY_PAIRS:  # in threads, which leave what they make in the memo
        with ThreadPoolExecutor(num_workers(), thread_name_prefix="all-pairs") as executor:
            pairs = table(None if make is None else make(numbers, memo))
            pairs.compare(None, executor, rest)
    else:  # as ``gpgrad detect`` does; what it has compared is taken from the same store
        with (
            store_for_run(memo.store, len(submaps)) as store,
            workers(num_workers(), MANY_PAIRS) as executor,
        ):
            pairs = table(with_store((make or MapDetector)(numbers, Memo(OF_A_PROCESS)), store))
            pairs.compare(None, executor, rest)
    if params.closure.images != "off":
        _ = list(pairs.judge())  # an image that cannot be read stops the run
    # Without what was extracted of the submaps.
    whole = Pairs.of(submaps, dict(run.registered), numbers)
    whole.seconds, whole.shortlists = pairs.seconds, pairs.shortlists
    whole.hyperparameters = pairs.hyperparameters
    run.table, run.has_ended = whole, True


@dataclass(frozen=True, eq=False)
class TruthCheck:
    """How the verdicts agree with the truth by one rule."""

    # over the threshold on the score, the one on inliers as it is; None where no pair is true
    curve: PrecisionRecall | None
    precision: float  # at the thresholds as they are; NaN where no judged pair is accepted
    recall: float  # at the thresholds as they are
    average_precision: float


@dataclass(frozen=True, eq=False)
class JudgedPairs:
    """The verdicts on the pairs of a run at some thresholds, compared with the truth.

    An outcome is `RIGHT`, `WRONG_MOTION` or `NO_OVERLAP` if the pair was accepted and there is a
    truth, `MISSED` if it was wrongly refused, and else `ACCEPTED` or `REFUSED`.
    """

    run: PairsRun
    rule: Rule  # when a pair is true
    verdicts: Verdicts
    # `TRUE` or `APART`; not of pairs without a truth, or that the rule leaves out
    truths: Mapping[PairOfIds, str]
    check: TruthCheck | None  # None without a truth

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """Every pair with its verdict, as `DetectionResult` orders them."""
        return self.verdicts.found.closures

    @property
    def outcomes(self) -> Mapping[PairOfIds, str]:
        return self.verdicts.outcomes

    @property
    def ranked(self) -> list[LoopClosure]:
        return sorted(self.closures, key=lambda closure: -closure.registration.score)

    @property
    def scores(self) -> Float[Array, "p"]:
        return np.array([closure.registration.score for closure in self.closures], np.float64)

    @property
    def top_score(self) -> float:
        """The score that has the last colour; 1 without any."""
        return (float(np.quantile(self.scores, TOP_SHARE)) if self.closures else 0.0) or 1.0

    @property
    def num_skipped(self) -> int:
        return comb(len(self.run.dataset.submaps), 2) - len(self.closures)

    @property
    def num_accepted(self) -> int:
        return sum(closure.accepted for closure in self.closures)


def judge(run: PairsRun, thresholds: ClosureParams, rule: Rule) -> JudgedPairs:
    """Judge every pair of a run's table, and compare the verdicts with the truth."""
    found, truth, check = _verdicts(run, thresholds), run.truth, None
    truths, if_accepted = dict[PairOfIds, str](), dict[PairOfIds, str]()
    if truth is not None:
        labels = rule.label(truth)
        ranking = rank_pairs(found, run.dataset, truth, "all pairs")
        errors = pose_errors(
            ranking.T_database_query,
            truth.T_database_query,
            max_turn=np.pi if truth.positions_only else radians(MAX_TURN),
            centres=truth.centres[truth.query],
        )
        motions = classify_motions(errors, truth.surface_overlap)
        check = _check(ranking, thresholds, labels)
        for closure in found.closures:
            row = truth.rows.get(frozenset(closure.pair))
            if row is None:
                continue
            wrong = WRONG_MOTION if motions.wrong_motion[row] else NO_OVERLAP
            if_accepted[closure.pair] = RIGHT if motions.right[row] else wrong
            if labels.judged[row]:
                truths[closure.pair] = TRUE if labels.positive[row] else APART
    outcomes = {
        closure.pair: if_accepted.get(closure.pair, ACCEPTED)
        if closure.accepted
        else (MISSED if truths.get(closure.pair) == TRUE else REFUSED)
        for closure in found.closures
    }
    params = replace(run.state.given, closure=thresholds)
    return JudgedPairs(run, rule, Verdicts(run.state, params, found, outcomes), truths, check)


def _check(ranking: Ranking, thresholds: ClosureParams, labels: Labels) -> TruthCheck:
    # A pair with too few inliers is not accepted at any score: then the curve runs through the
    # point at which the thresholds stand.
    could_pass = (ranking.num_inliers >= thresholds.min_inliers) & np.array(
        [motion is not None for motion in ranking.T_database_query], dtype=np.bool_
    )
    score = np.where(could_pass, ranking.score, -np.inf)[labels.judged]
    positive = labels.positive[labels.judged]
    if not positive.any():
        return TruthCheck(None, np.nan, np.nan, np.nan)
    full = precision_recall(score, positive)
    reached = full.thresholds > -np.inf
    curve = PrecisionRecall(full.thresholds[reached], full.precision[reached], full.recall[reached])
    now = precision_recall(ranking.accepted[labels.judged].astype(np.float64), positive, [1.0])
    return TruthCheck(curve, now.precision[0], now.recall[0], average_precision(full))
