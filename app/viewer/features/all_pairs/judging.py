"""All pairs of a dataset: registered once, then judged anew whenever a threshold moves."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from math import comb, radians

import numpy as np
from jaxtyping import Float

from app.viewer.features.desk import FIT_SHARE, TRUTH_SHARE
from app.viewer.session.decisions import ACCEPTED, MISSED, NO_OVERLAP, REFUSED, RIGHT, WRONG_MOTION
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.state import ViewState, same_search
from gpgrad_core.arrays import Array
from gpgrad_core.detection import (
    DetectionResult,
    MapDetector,
    Pairs,
    PipelineParams,
    resolve_parameters,
    store_for_run,
    with_store,
)
from gpgrad_core.detection.shortlist import Candidates, num_wanted
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
    MotionClasses,
    Rule,
    classify_motions,
    pose_errors,
)
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import Dataset, LoopClosure, Registration

RULES: dict[str, Rule] = {rule.name: rule for rule in EvaluationParams().rules}
"""By name, when a pair counts as truly the same place."""


@dataclass(frozen=True, eq=False)
class ComparedPairs:
    """All pairs of a dataset with their registrations.

    Attributes:
        dataset: Whose pairs.
        params: That they were registered with.
        pairs: The table of them, which judges them.
        truth: How far the pairs truly overlap; None where fewer than two true poses are known.
        method: That registered them.
        num_left: Largest number of pairs that are still to be registered.
    """

    dataset: Dataset
    params: PipelineParams
    pairs: Pairs
    truth: TruePairs | None
    method: MethodName = "gradient"
    num_left: int = 0

    def is_of(self, state: ViewState) -> bool:
        """Say whether a state would give the same registrations; most thresholds do not matter."""
        registered_by = METHODS[self.method].registered_by
        return (
            state.dataset is self.dataset
            and state.method == self.method
            and registered_by(state.given) == registered_by(self.params)
        )


@dataclass(eq=False)
class PairsRun:
    """All pairs with the parameters of the moment at which they were asked for.

    Attributes:
        state: The session at that moment.
        candidates: With how many earlier submaps a submap is compared.
        registered: What was registered so far, by the ids (query, database). A run that was
            cancelled goes on from there.
        truth: How far the pairs truly overlap, once that is measured.
        table: All of its pairs, once they are compared.
    """

    state: ViewState
    candidates: Candidates = "automatic"
    registered: dict[tuple[str, str], Registration] = field(
        default_factory=dict[tuple[str, str], Registration]
    )
    truth: TruePairs | None = None
    table: Pairs | None = None

    @property
    def num_pairs(self) -> int:
        """Largest number of pairs that it compares."""
        return sum(num_wanted(self.candidates, k) for k in range(len(self.state.dataset.submaps)))

    @property
    def num_left(self) -> int:
        """Largest number of pairs that are still to be compared."""
        return self.num_pairs - len(self.registered)

    def registers_as(self, other: "PairsRun") -> bool:
        """Say whether another run registers the same pairs with the same parameters."""
        registered_by = METHODS[self.state.method].registered_by
        return (
            same_search(self.state, other.state)
            and self.candidates == other.candidates
            and registered_by(self.state.given) == registered_by(other.state.given)
        )

    def so_far(self) -> ComparedPairs:
        """Give the pairs that were registered so far."""
        state = self.state
        pairs = Pairs.of(state.dataset.submaps, dict(self.registered), state.given)
        return ComparedPairs(
            state.dataset, state.given, pairs, self.truth, state.method, self.num_pairs - len(pairs)
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


MANY_PAIRS = 1000
"""From this number on, pairs are compared in processes of their own. That is faster, and leaves
this one to the pages."""
OF_A_PROCESS = 500_000_000
"""Bytes of results that each of them keeps; views and registrations are in the store."""
TRUE, APART, UNKNOWN = "true", "apart", "unknown"


def compare_pairs(run: PairsRun, memo: Memo, progress: Progress = silent) -> ComparedPairs:
    """Measure how far the pairs of a dataset truly overlap, and register those that are missing.

    Args:
        run: What to compare. It has every pair as soon as that is compared, and the truth before
            the first one; then the progress hook is called.
        memo: Shared with whatever else needs maps of the same submaps.
        progress: Called from this thread; may raise Cancelled.

    Raises:
        InputError: If a submap's map cannot be made, or an image cannot be read.
    """
    state = run.state
    dataset = state.dataset
    if run.truth is None and len(dataset.true_poses) >= 2:
        run.truth = measure_pairs(dataset, part(progress, 0.0, TRUTH_SHARE))
    pairs = _register(run, memo, progress, TRUTH_SHARE)
    return ComparedPairs(dataset, state.given, pairs, run.truth, state.method)


def detect(run: PairsRun, memo: Memo, progress: Progress = silent) -> DetectionResult:
    """Give all pairs of a run as its thresholds judge them; `compare_pairs` without the truth."""
    _ = run.state.pair  # refuses one submap alone
    pairs, thresholds = run.table or _register(run, memo, progress), run.state.given.closure
    return result_of(pairs, tuple(pairs.judge(thresholds)), thresholds)


def result_of(
    pairs: Pairs, closures: tuple[LoopClosure, ...], thresholds: ClosureParams
) -> DetectionResult:
    """Make the result of verdicts under some thresholds."""
    return replace(pairs.result(closures), params=replace(pairs.params, closure=thresholds))


def _register(run: PairsRun, memo: Memo, progress: Progress, begun: float = 0.0) -> Pairs:
    """Register the missing pairs of a run, of whose progress a part has passed."""
    params, submaps = run.state.given, run.state.dataset.submaps
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
    run.table = whole = Pairs.of(submaps, dict(run.registered), numbers)
    whole.seconds, whole.shortlists = pairs.seconds, pairs.shortlists
    whole.hyperparameters = pairs.hyperparameters
    return whole


def judge(compared: ComparedPairs, thresholds: ClosureParams, rule: Rule) -> JudgedPairs:
    """Judge every pair, and compare the verdicts with the truth."""
    closures = tuple(compared.pairs.judge(thresholds))
    if compared.truth is None:
        plain = tuple(ACCEPTED if closure.accepted else REFUSED for closure in closures)
        return JudgedPairs(compared, closures, None, plain, len(closures) * (UNKNOWN,))
    truth = compared.truth
    labels = rule.label(truth)
    ranking = rank_pairs(DetectionResult(closures, {}), compared.dataset, truth, "all pairs")
    turn = np.pi if truth.positions_only else radians(MAX_TURN)
    errors = pose_errors(
        ranking.T_database_query,
        truth.T_database_query,
        max_turn=turn,
        centres=truth.centres[truth.query],
    )
    classes = classify_motions(errors, truth.surface_overlap)
    check = _check(ranking, thresholds, rule, labels)
    rows = tuple(truth.rows.get(frozenset(closure.pair)) for closure in closures)
    outcomes = tuple(
        _outcome(row, closure, labels, classes) for row, closure in zip(rows, closures, strict=True)
    )
    truths = tuple(
        (TRUE if labels.positive[row] else APART)
        if row is not None and labels.judged[row]
        else UNKNOWN
        for row in rows
    )
    return JudgedPairs(compared, closures, check, outcomes, truths)


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


def _outcome(row: int | None, closure: LoopClosure, labels: Labels, classes: MotionClasses) -> str:
    """Say what became of a pair; its row is that of the truth, None where that is not known."""
    if row is None:
        return ACCEPTED if closure.accepted else REFUSED
    if not closure.accepted:
        return MISSED if labels.judged[row] and labels.positive[row] else REFUSED
    if classes.right[row]:
        return RIGHT
    return WRONG_MOTION if classes.wrong_motion[row] else NO_OVERLAP


# The cells of a matrix: a pair in each, or a block of pairs where many are. A page draws a few
# thousand cells well, and no more.

MOST_GROUPS = 60
"""Rows of a matrix. More submaps are gathered in groups of equal size."""
WORST_FIRST = (NO_OVERLAP, WRONG_MOTION, MISSED, RIGHT, ACCEPTED, REFUSED)
"""A cell of several pairs has the colour of its worst."""


@dataclass(frozen=True)
class Cell:
    """The pairs of one cell.

    Attributes:
        query: Id of the query of the pair with the highest score.
        database: Id of its database submap.
        score: Its score.
        outcome: The worst outcome of all pairs of the cell.
        num_pairs: Number of them.
    """

    query: str
    database: str
    score: float
    outcome: str
    num_pairs: int


@dataclass(frozen=True, eq=False)
class PairCells:
    """Cells by rows (queries) and columns (database submaps).

    Attributes:
        rows: Ids of the submaps in each row, in the dataset's order.
        columns: Ids of the submaps in each column.
        cells: By (row, column); where no pair was compared there is none.
        overlaps: Highest true overlap (rows, columns) of the pairs whose query is in the column and
            whose database submap is in the row, mirrored to `cells`; NaN where it is not known.
    """

    rows: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[str, ...], ...]
    cells: Mapping[tuple[int, int], Cell]
    overlaps: Float[Array, "rows columns"]

    @property
    def has_blocks(self) -> bool:
        """Whether a cell stands for several pairs."""
        return any(len(group) > 1 for group in (*self.rows, *self.columns))

    def place(self, query: str, database: str) -> tuple[int, int] | None:
        """Find the cell of a pair (row, column); None if it is not in this matrix."""
        row = next((k for k, group in enumerate(self.rows) if query in group), None)
        column = next((k for k, group in enumerate(self.columns) if database in group), None)
        return None if row is None or column is None else (row, column)


def gather_all(judged: JudgedPairs) -> PairCells:
    """Put all pairs of a dataset into at most `MOST_GROUPS` rows and columns."""
    ids = [submap.id for submap in judged.compared.dataset.submaps]
    size = max(1, -(-len(ids) // MOST_GROUPS))
    groups = tuple(tuple(ids[k : k + size]) for k in range(0, len(ids), size))
    return gather(judged, groups, groups)


def gather_block(judged: JudgedPairs, whole: PairCells, pair: tuple[str, str]) -> PairCells | None:
    """Show the pairs of one block one by one.

    Args:
        judged: All pairs with their verdicts.
        whole: What `gather_all` made of them.
        pair: (query, database) of a pair in the block, the later submap first.

    Returns:
        The pairs of the block; None where every cell of the whole is a single pair, or where the
        pair is of another dataset.
    """
    place = whole.place(*pair)
    if place is None or not whole.has_blocks:
        return None
    rows, columns = whole.rows[place[0]], whole.columns[place[1]]
    return gather(judged, tuple((name,) for name in rows), tuple((name,) for name in columns))


def gather(
    judged: JudgedPairs, rows: Sequence[tuple[str, ...]], columns: Sequence[tuple[str, ...]]
) -> PairCells:
    """Put the pairs of some submaps into cells."""
    row_of = {name: k for k, group in enumerate(rows) for name in group}
    column_of = {name: k for k, group in enumerate(columns) for name in group}
    worst = {outcome: rank for rank, outcome in enumerate(WORST_FIRST)}
    best: dict[tuple[int, int], LoopClosure] = {}
    outcomes: dict[tuple[int, int], str] = {}
    counts: dict[tuple[int, int], int] = {}
    for closure, outcome in zip(judged.closures, judged.outcomes, strict=True):
        row, column = row_of.get(closure.query_id), column_of.get(closure.database_id)
        if row is None or column is None:
            continue
        at = row, column
        counts[at] = counts.get(at, 0) + 1
        if at not in best or closure.registration.score > best[at].registration.score:
            best[at] = closure
        if at not in outcomes or worst[outcome] < worst[outcomes[at]]:
            outcomes[at] = outcome
    cells = {
        at: Cell(
            closure.query_id,
            closure.database_id,
            closure.registration.score,
            outcomes[at],
            counts[at],
        )
        for at, closure in best.items()
    }
    overlaps = _overlaps(judged, row_of, column_of, (len(rows), len(columns)))
    return PairCells(tuple(rows), tuple(columns), cells, overlaps)


def _overlaps(
    judged: JudgedPairs,
    row_of: Mapping[str, int],
    column_of: Mapping[str, int],
    shape: tuple[int, int],
) -> Float[Array, "rows columns"]:
    overlaps = np.full(shape, np.nan)
    truth = judged.compared.truth
    if truth is None or judged.check is None:
        return overlaps
    rows = np.array([row_of.get(name, -1) for name in truth.ids])[truth.database]
    columns = np.array([column_of.get(name, -1) for name in truth.ids])[truth.query]
    # On the diagonal, the pairs within a group are shown by their scores.
    within = (rows >= 0) & (columns >= 0) & (rows != columns)
    measured = judged.check.rule.measured(truth)
    np.fmax.at(overlaps, (rows[within], columns[within]), measured[within])
    return overlaps
