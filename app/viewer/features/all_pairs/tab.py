"""The All pairs tab: wires its panel to a worker that registers all pairs, and one that judges."""

import threading
import time
from dataclasses import dataclass, replace
from functools import partial

import msgspec
import numpy as np
import viser

from app.viewer.features.all_pairs.judging import (
    RULES,
    ComparedPairs,
    JudgedPairs,
    PairCells,
    PairsRun,
    TruthCheck,
    compare_pairs,
    detect,
    gather_all,
    gather_block,
    judge,
    result_of,
)
from app.viewer.features.all_pairs.panel import (
    AllPairsPanel,
    Findings,
    folded,
    run_html,
    shortlist_html,
    summary_html,
)
from app.viewer.features.all_pairs.pictures import (
    count_scores,
    disagreements_html,
    highest_color,
    matrix_html,
    scores_html,
    threshold_html,
)
from app.viewer.features.desk import PHASES, Desk, Detect, Feature
from app.viewer.features.work import Work, message_of
from app.viewer.session.decisions import NO_OVERLAP, RIGHT, WRONG_MOTION
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.news import SessionState, Verdicts
from app.viewer.session.state import ViewState, same_search
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.bridge import PairMsg, Whole
from app.viewer.widgets.html import FAINT, paragraph
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError, score_in_words
from gpgrad_core.evaluation.rules import MAX_OFFSET, MAX_TURN
from gpgrad_core.params import parameters_of, with_path
from gpgrad_core.run import Cancelled, Progress

SHOWN_EVERY, SHOWN_PAUSE = 0.5, 5.0
"""While a run goes on, its pairs are judged and shown anew after so many seconds; or after so many
times as long as that took, if it is longer."""


@dataclass(frozen=True, eq=False)
class _Judging:
    """What the verdicts on all pairs depend on."""

    compared: ComparedPairs
    state: ViewState
    rule: str


@dataclass(frozen=True, eq=False)
class _Judged:
    """All pairs judged, with the cells that show them."""

    pairs: JudgedPairs
    whole: PairCells
    block: PairCells | None


class CellMsg(msgspec.Struct):
    """A click on a cell of a matrix."""

    name: str
    row: Whole
    column: Whole


class ThresholdMsg(msgspec.Struct):
    """The score that a hand has drawn the threshold to, and whether it was let go there."""

    score: float
    rested: bool = False


class AllPairsTab(Feature):
    """Registers all pairs when asked, and judges them anew as the thresholds move."""

    def __init__(self, desk: Desk) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._lock = threading.Lock()
        self._state = desk.state
        self._rule = next(iter(RULES))
        self._compared: ComparedPairs | None = None
        self._kept: dict[MethodName, ComparedPairs] = {}  # of the dataset
        self._asked: tuple[object, ...] = ()
        self._judging_took = 0.0
        self.panel = AllPairsPanel(desk.host, tuple(RULES), desk.choose)
        self._runs: dict[MethodName, PairsRun] = {}  # of the dataset, that have not ended
        self._ended: dict[MethodName, PairsRun] = {}  # of the dataset
        on_press(self.panel.run, self.compare_pairs)
        on_choice(self.panel.rule, self._set_rule)
        on_choice(self.panel.candidates_choice, lambda _: self._offer())
        self._comparer: Work[PairsRun, ComparedPairs] = Work(
            desk.jobs,
            self.panel.work_bar,
            lambda run: f"Running all pairs of {len(run.state.dataset.submaps):,} submaps",
            self._compare,
            self._on_compared,
            slots=desk.capacity.long,
            watch=self._watch,
            phases=PHASES,
        )
        self._judge: Lane[_Judging, _Judged] = Lane(
            desk.jobs,
            self._judge_all,
            self._on_judged,
            lambda _, error: self.panel.work_bar.failed(message_of(error)),
        )
        self._latest: tuple[tuple[object, ...], JudgedPairs, PairCells] | None = None
        self._cells: dict[str, PairCells] = {}  # what the pages show, by the name of the matrix
        desk.bridge.on_message("matrix", CellMsg, self._open_cell)
        desk.bridge.on_message(
            "pair", PairMsg, lambda _, said: desk.choose(said.query, said.database)
        )
        desk.bridge.on_message("threshold", ThresholdMsg, self._set_threshold)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the session: its thresholds, its pair, another dataset or method."""
        was, now = before.view, state.view
        with self._lock:
            self._state = now
            if now.dataset is not was.dataset:
                self._kept, self._runs, self._ended = {}, {}, {}
            other = not same_search(now, was)
            if other:  # each method's results are kept apart
                self._compared = self._kept.get(now.method)
                self._latest, self._asked, self._cells = None, (), {}
        if other:
            self._comparer.cancel()
            self.panel.clear()
        self._offer()
        self._submit()

    def compare_pairs(self) -> None:
        """Register all pairs with the parameters as they are; returns at once.

        A run of the same that was cancelled goes on; with other parameters it starts anew. Of a
        dataset that grows, all that came are registered.
        """
        self._desk.catch_up()
        with self._lock:
            run, before = self._run_now(), self._runs.get(self._state.method)
            if before is not None and before.registers_as(run):
                run = before
            self._runs[run.state.method] = run
        self.panel.show_run(run_html(run.state, run.candidates))
        self._comparer.start(run)

    def _run_now(self) -> PairsRun:
        """Give a run as the session and the panel are."""
        return PairsRun(self._state, self.panel.candidates)

    def detection(self, state: ViewState) -> Detect:
        """Give what finds a state's closures among the candidates that the panel has.

        What was compared of them already is not compared again.
        """
        run = PairsRun(state, self.panel.candidates)
        with self._lock:
            for runs in (self._ended, self._runs):
                last = runs.get(state.method)
                if last is not None and run.table is None and last.registers_as(run):
                    run = replace(run, registered=dict(last.registered), table=last.table)
        return partial(detect, run, self._desk.memo)

    def _offer(self) -> None:
        """Say what a press of the button does: begin, go on, or begin anew."""
        with self._lock:
            run = self._runs.get(self._state.method)
            begun = run is not None and 0 < run.num_left < run.num_pairs
            same = run is not None and run.registers_as(self._run_now())
        counts = "" if run is None else f"{len(run.registered):,} of {run.num_pairs:,}"
        self.panel.offer(counts if begun else "", same=same)

    def _watch(self, fraction: float | None, message: str) -> None:
        """Tell how far the run is, and show what it has so far."""
        if fraction is None:
            self._offer()
        self._desk.update_pairs(lambda pairs: pairs._replace(fraction=fraction, message=message))

    def stop_comparing(self) -> None:
        """Stop registering."""
        self._comparer.cancel()

    def _set_rule(self, rule: str) -> None:
        self._rule = rule
        self._submit()

    def _submit(self) -> None:
        """Ask for new verdicts, unless nothing changed that they depend on."""
        with self._lock:
            compared, state = self._compared, self._state
            if compared is None:
                return
            pair = state.query_id, state.database_id
            asked = compared, state.params.closure, pair, self._rule, compared.is_of(state)
            if asked != self._asked:
                self._asked = asked
                self._judge.submit(_Judging(compared, state, self._rule))

    def _compare(self, run: PairsRun, progress: Progress) -> ComparedPairs:
        _ = run.state.pair  # refuses one submap alone
        shown, next_show = 0, 0.0

        def report(fraction: float) -> None:
            nonlocal shown, next_show
            if len(run.registered) > shown and time.monotonic() >= next_show:
                # Once the last picture is drawn, and so much later that it takes a small share.
                shown = len(run.registered)
                self._show_so_far(run)
                next_show = time.monotonic() + max(SHOWN_EVERY, SHOWN_PAUSE * self._judging_took)
            progress(fraction)

        try:
            return compare_pairs(run, self._desk.memo, report)
        except Cancelled:
            if run.registered:
                self._show_so_far(run)  # it stays
            raise

    def _show_so_far(self, run: PairsRun) -> None:
        with self._lock:
            if same_search(run.state, self._state):
                self._compared = run.so_far()
        self._submit()

    def _on_compared(self, run: PairsRun, compared: ComparedPairs, _seconds: float) -> None:
        with self._lock:
            if not same_search(run.state, self._state):
                return  # another was opened in the very last moment
            self._compared = self._kept[run.state.method] = compared
            self._ended[run.state.method] = run
            self._runs.pop(run.state.method, None)
        self._offer()
        self._submit()

    def _judge_all(self, job: _Judging, _progress: Progress) -> _Judged:
        """Judge all pairs, unless only another one of them is shown."""
        key = job.compared, job.state.params.closure, job.rule
        if self._latest is None or self._latest[0] != key:
            pairs = judge(job.compared, job.state.params.closure, RULES[job.rule])
            self._latest = key, pairs, gather_all(pairs)
        _, pairs, whole = self._latest
        return _Judged(pairs, whole, gather_block(pairs, whole, job.state.compared_pair))

    def _on_judged(self, job: _Judging, judged: _Judged, seconds: float) -> None:
        self._judging_took = seconds
        if job.compared is not self._compared:
            return
        self._cells = {"all": judged.whole}
        if judged.block is not None:
            self._cells["block"] = judged.block
        host = self._desk.host
        with host.atomic():
            self.panel.show(findings(judged.pairs, judged.whole, judged.block, job.state))
        host.flush()
        if job.compared.num_left:
            return  # what is shown grows yet; other features wait for the whole
        pairs = judged.pairs
        ids = (closure.pair for closure in pairs.closures)
        outcomes = dict(zip(ids, pairs.outcomes, strict=True))
        params = replace(job.compared.params, closure=job.state.params.closure)
        found = result_of(job.compared.pairs, pairs.closures, params.closure)
        verdicts = Verdicts(job.state, params, found, outcomes)
        self._desk.update_pairs(lambda pairs: pairs._replace(verdicts=verdicts))

    # What the pictures say; it comes from a page.

    def _open_cell(self, _page: viser.ClientHandle, said: CellMsg) -> None:
        """Show the best pair of a cell."""
        matrix = self._cells.get(said.name)
        if matrix is None:
            return
        row, column = int(said.row), int(said.column)
        cell = matrix.cells.get((row, column)) or matrix.cells.get((column, row))
        if cell is not None:
            self._desk.choose(cell.query, cell.database)

    def _set_threshold(self, _page: viser.ClientHandle, said: ThresholdMsg) -> None:
        """Take the least score to where a hand has drawn it."""
        params, path = self._desk.state.asked, METHODS[self._desk.state.method].threshold
        field = next(field for field in parameters_of(PipelineParams) if field.path == path)
        try:
            rounded = said.score if field.bounds is None else field.bounds.round(said.score)
            params = with_path(params, path, int(rounded) if field.kind is int else rounded)
        except (InputError, ValueError, OverflowError):
            return  # no page of ours draws it out of bounds
        self._desk.change(params=params, moving=True)
        if said.rested:
            self._desk.release(params)


def findings(
    judged: JudgedPairs, whole: PairCells, block: PairCells | None, state: ViewState
) -> Findings:
    """Turn the judged pairs into pictures and words."""
    high, histogram = highest_color(judged), count_scores(judged)
    compared, count = judged.compared, judged.num_accepted
    closures = "loop closure" if count == 1 else "loop closures"
    num_skipped = judged.num_skipped - compared.num_left
    skipped = f" ({num_skipped:,} were not compared)" if num_skipped else ""
    took = compared.pairs.seconds.get("total")
    done = f"up to {compared.num_left:,} are still to come" if took is None else f"{took:.1f} s"
    by_motion = "" if judged.check is None else f": {_by_motion(judged)}"
    summary = (
        f"{count} {closures} in {len(judged.closures):,} pairs{skipped}{by_motion} · "
        f"{done} · method {state.method}"
    )
    outdated = "The parameters have changed since: run again to update."
    shown = state.query_id, state.database_id
    shortlist = compared.pairs.shortlists.get(state.query_id, ())
    ids = [submap.id for submap in compared.dataset.submaps]
    earlier = ids.index(state.query_id) if state.query_id in ids else 0
    ranked = sorted(
        zip(judged.closures, judged.outcomes, strict=True),
        key=lambda row: -row[0].registration.score,
    )
    choices = {
        f"{closure.query_id} → {closure.database_id} · "
        f"{score_in_words(closure.registration.score)} · {outcome}": (
            closure.pair,
            outcome,
        )
        for closure, outcome in ranked
    }
    caption = "" if judged.check is None else _curve_caption(judged.check)
    html = {
        "summary": summary_html(summary, "" if compared.is_of(state) else outdated),
        "matrix": matrix_html("all", whole, high, shown),
        "block": "" if block is None else matrix_html("block", block, high, shown),
        "key": folded("How to read it", _matrix_caption(judged, whole, high)),
        "scores": scores_html(judged, histogram),
        "disagreements": disagreements_html(judged, histogram),
        "curve": paragraph(caption, FAINT),
        "threshold": threshold_html(METHODS[state.method].lowest(state.params)),
        "reasons": shortlist_html(*shown, shortlist, earlier),
    }
    return Findings(html, choices, shown, has_truth=judged.check is not None)


def _by_motion(judged: JudgedPairs) -> str:
    """Count the accepted pairs by what the truth says of them."""
    return ", ".join(
        f"{judged.outcomes.count(outcome)} {name}"
        for outcome, name in (
            (RIGHT, "with the right motion"),
            (WRONG_MOTION, "with a wrong motion"),
            (NO_OVERLAP, "without overlap"),
        )
    )


def _matrix_caption(judged: JudgedPairs, whole: PairCells, high: float) -> str:
    parts: list[str] = []
    if whole.has_blocks:
        size = len(whole.rows[0])
        parts.append(
            f"Each cell of the large matrix is a block of {size} by {size} submaps. It has the "
            "colour of the highest score and the mark of the worst outcome, and a click opens its "
            "best pair. The small matrix has the pairs of that block one by one."
        )
    parts.append(
        "Rows are queries, columns are the database. Below the diagonal is the score, from dark "
        f"(0) to yellow ({high:.1f})."
    )
    if judged.check is None:
        parts.append("Rings mark accepted pairs; magenta marks the pair shown.")
        return " ".join(parts)
    measure = "of the boxes" if judged.check.rule.measure == "box" else "of the surfaces"
    parts.append(
        f"Above it is the true overlap {measure}, from dark (0) to light (1). Green rings are "
        f"accepted pairs with the right motion, within {MAX_OFFSET:g} m and {MAX_TURN:g}°. Red "
        "crosses have a wrong motion, and white squares no common ground. Orange diamonds are "
        "missed pairs; magenta marks the pair shown."
    )
    return " ".join(parts)


def _curve_caption(check: TruthCheck) -> str:
    if check.curve is None:
        return f"No pair is true by the rule {check.rule.name}, so there is nothing to find."
    precision = f"{check.precision:.3f}" if np.isfinite(check.precision) else "—"
    return (
        f"At the present thresholds, precision is {precision} and recall {check.recall:.3f}. "
        "Drag the magenta line to another score. "
        f"Average precision {check.average_precision:.3f}. {check.rule.statement}"
    )
