"""The tab All pairs: registers the pairs on request, and shows the verdicts by the thresholds."""

import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from html import escape
from typing import TypeAlias

import msgspec
import numpy as np
import viser

from app.viewer.features.desk import Desk, Detect, Feature, ModeSwitch
from app.viewer.features.pairs.matrix import (
    MOST_ROWS,
    OPEN_PAIR,
    MatrixLook,
    PairCells,
    board_html,
    draw_board,
    gather_all,
    gather_block,
    light,
    matrix_html,
    words_of,
)
from app.viewer.features.pairs.model import (
    PHASES,
    RULES,
    JudgedPairs,
    PairsRun,
    TruthCheck,
    compare_pairs,
    detect,
    judge,
)
from app.viewer.features.pairs.scores import (
    count_scores,
    disagreements_html,
    scores_html,
    threshold_html,
)
from app.viewer.features.work import Work, message_of
from app.viewer.features.world import WorldTab
from app.viewer.scene.cameras import view_of
from app.viewer.session.decisions import NO_OVERLAP, RIGHT, WRONG_MOTION
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState, same_search
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.bridge import PairMsg, Whole
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import BUSY, FAINT, box, make_solid, message_line, paragraph
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.shortlist import ALL_UP_TO, DEFAULT_CANDIDATES, Candidate, Candidates
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import InputError, count
from gpgrad_core.evaluation.rules import MAX_OFFSET, MAX_TURN, Rule
from gpgrad_core.params import get_path, parameters_of, with_path
from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.types import PairOfIds

SHOWN_EVERY, SHOWN_PAUSE = 0.5, 5.0
"""While a run goes on, its pairs are judged and shown anew after so many seconds; or after so many
times as long as that took, if it is longer."""
RUN: str = "Run all pairs"
CANDIDATES: dict[str, Candidates] = {
    "automatic": "automatic",
    "all earlier ones": "all",
    "the 5 best": 5,
    "the 10 best": 10,
    "the 30 best": 30,
    "the 100 best": 100,
}
"""By their names, how many earlier submaps a submap can be compared with."""
PLACES = ("summary", "matrix", "block", "key", "scores", "disagreements", "curve", "threshold")
"""Pictures and texts from above to below; the one called "reasons" stands below the rule."""

_Judging: TypeAlias = tuple[PairsRun, ViewState, Rule]
"""What is to be judged: by the thresholds of the state, and by the rule."""


class CellMsg(msgspec.Struct):
    """The cell of a matrix that is clicked or pointed at; none is in row -1."""

    name: str
    row: Whole
    column: Whole


class ThresholdMsg(msgspec.Struct):
    """The score that a hand has drawn the threshold to, and whether it was let go there."""

    score: float
    rested: bool = False


class AllPairsTab(Feature):
    """Registers all pairs on request, and judges them anew as the thresholds move."""

    def __init__(self, desk: Desk, world: WorldTab, modes: ModeSwitch, commands: Commands) -> None:
        self._desk, self._world, self._modes = desk, world, modes
        self._lock = threading.Lock()
        self._begun: dict[MethodName, PairsRun] = {}  # of the dataset, that have not ended
        self._ended: dict[MethodName, PairsRun] = {}  # of the dataset
        self._shown: PairsRun | None = None  # as far as it is shown
        self._judged: JudgedPairs | None = None
        self._cells: dict[str, PairCells] = {}  # what the pages show, by the name of the matrix
        self._requested: tuple[object, ...] = ()
        self._judging_took = 0.0
        gui = desk.host.gui
        self._candidates = gui.add_dropdown(
            "Compare with",
            tuple(CANDIDATES),
            initial_value=next(iter(CANDIDATES)),
            hint="With how many earlier submaps each submap is compared. Automatic takes all of up "
            f"to {ALL_UP_TO} earlier ones, and up to {DEFAULT_CANDIDATES} promising ones of more.",
        )
        on_choice(self._candidates, lambda _: self._offer())
        hint = "With the present parameters. You can use the sliders while it runs."
        self._button = gui.add_button(RUN, hint=hint)
        on_press(self._button, self.compare_pairs)
        make_solid(desk.host, self._button)
        self._bar = WorkBar(desk.host, "Cancel", "all-pairs", starts=(self._button,))
        enlarge = gui.add_button(
            "Matrix beside the picture",
            hint="Shows the matrix large, in the place of this panel. Points out in the map what "
            "the mouse is on.",
        )
        on_press(enlarge, self._turn_board)
        keys = {"key": "P", "modifier": "shift"}
        commands.add("View", "Matrix of all pairs, or back", self._turn_board, **keys)
        self._anew = gui.add_html("")
        self._parameters = gui.add_html("")
        self.html = {place: gui.add_html("") for place in PLACES}  # what is shown
        self._rule = gui.add_dropdown(
            "True if",
            tuple(RULES),
            initial_value=next(iter(RULES)),
            visible=False,
            hint="By which rule the true poses say that a pair shows the same place. A pair that "
            "touches without being true is left out: its motion may still be right.",
        )
        on_choice(self._rule, lambda _: self._submit())
        self.html["reasons"] = gui.add_html("")
        with desk.bridge.folder:  # unseen: the page puts it over its canvas
            self.html["board"] = gui.add_html("")
        self._comparer: Work[PairsRun, None] = Work(
            desk.jobs,
            self._bar,
            lambda run: f"Running all pairs of {count(len(run.dataset.submaps), 'submap')}",
            self._compare,
            self._on_compared,
            slots=desk.capacity.long,
            watch=self._watch,
            phases=PHASES,
        )
        self._judge: Lane[_Judging, JudgedPairs] = Lane(
            desk.jobs,
            self._judge_all,
            self._on_judged,
            lambda _, error: self._bar.failed(message_of(error)),
        )
        desk.bridge.on_message("matrix", CellMsg, self._open_cell)
        desk.bridge.on_message("cell", CellMsg, self._point)
        desk.bridge.hear("board", lambda _page, _data: self._turn_board())
        desk.bridge.on_message(
            OPEN_PAIR, PairMsg, lambda _, msg: desk.choose(msg.query, msg.database)
        )
        desk.bridge.on_message("threshold", ThresholdMsg, self._set_threshold)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        was, now = before.view, state.view
        if not same_search(now, was):
            with self._lock:
                if now.dataset is not was.dataset:
                    self._begun, self._ended = {}, {}
                self._shown = self._ended.get(now.method)  # each method has its own results
                self._judged, self._cells, self._requested = None, {}, ()
            self._comparer.cancel()
            self._show({})
            self._parameters.content = ""
            self._bar.idle()
        if state.board != before.board and self._judged is None:
            self._show({})
        self._offer()
        self._submit()

    def _turn_board(self) -> None:
        """Show or hide the matrix beside the picture; without any pairs they are compared."""
        self._desk.update(lambda now: replace(now, board=not now.board))
        if self._desk.now.board and self._shown is None and self._desk.state.is_pair:
            self.compare_pairs()

    # The run.

    def compare_pairs(self) -> None:
        """Register all pairs that came; a run of the same that was cancelled goes on."""
        self._desk.catch_up()
        with self._lock:
            run, before = self._run_of(self._desk.state), self._begun.get(self._desk.state.method)
            if before is not None and before.registers_as(run):
                run = before
            self._begun[run.state.method] = run
        self._parameters.content = run_html(run)
        self._comparer.start(run)

    def stop_comparing(self) -> None:
        self._comparer.cancel()

    def detection(self, state: ViewState) -> Detect:
        """What detects a state's closures; what was compared already is not compared again."""
        run = self._run_of(state)
        with self._lock:
            for runs in (self._begun, self._ended):
                last = runs.get(state.method)
                if last is not None and last.registers_as(run):
                    registered, table = dict(last.registered), last.table
                    run = replace(run, registered=registered, table=table)
        return partial(detect, run, self._desk.memo)

    def _run_of(self, state: ViewState) -> PairsRun:
        return PairsRun(state, CANDIDATES[self._candidates.value])

    def _offer(self) -> None:
        """Label the button by what a press does: begin, go on, or begin anew."""
        state = self._desk.state
        run, counts, same = self._begun.get(state.method), "", False
        if run is not None and 0 < run.num_left < run.num_pairs:
            counts = f"{len(run.registered):,} of {count(run.num_pairs, 'pair')}"
            same = run.registers_as(self._run_of(state))
        self._button.label = f"Resume ({counts} done)" if same else RUN
        anew = f"Other parameters: a run starts anew ({counts} were done with those below)."
        self._anew.content = (
            message_line("all-pairs-anew", anew, BUSY) if counts and not same else ""
        )

    def _watch(self, fraction: float | None, message: str) -> None:
        if fraction is None:
            self._offer()
        self._desk.update_pairs(lambda pairs: pairs._replace(fraction=fraction, message=message))

    def _compare(self, run: PairsRun, progress: Progress) -> None:
        _ = run.state.pair  # refuses one submap alone
        shown, next_show = 0, 0.0

        def report(fraction: float) -> None:
            nonlocal shown, next_show
            if len(run.registered) > shown and time.monotonic() >= next_show:
                # Once the last picture is drawn, and so much later that it takes a small share.
                shown = len(run.registered)
                self._show_run(run.so_far())
                next_show = time.monotonic() + max(SHOWN_EVERY, SHOWN_PAUSE * self._judging_took)
            progress(fraction)

        try:
            compare_pairs(run, self._desk.memo, report)
        except Cancelled:
            if run.registered:
                self._show_run(run.so_far())  # it stays
            raise

    def _on_compared(self, run: PairsRun, _nothing: None, _seconds: float) -> None:
        self._show_run(run)
        self._offer()

    def _show_run(self, run: PairsRun) -> None:
        """Show what a run has, unless another dataset or method is there by now."""
        with self._lock:
            if not same_search(run.state, self._desk.state):
                return
            self._shown = run
            if run.has_ended:
                self._ended[run.state.method] = run
                self._begun.pop(run.state.method, None)
        self._submit()

    # The verdicts.

    def _submit(self) -> None:
        """Ask for new verdicts, unless nothing changed that they depend on."""
        with self._lock:
            run, state, rule = self._shown, self._desk.state, RULES[self._rule.value]
            if run is None:
                return
            pair = state.query_id, state.database_id
            by_hand, board = self._desk.now.decisions.verdicts, self._desk.now.board
            requested = run, state.params.closure, pair, rule, run.is_of(state), by_hand, board
            if requested == self._requested:
                return
            self._requested = requested
        self._judge.submit((run, state, rule))

    def _judge_all(self, job: _Judging, _progress: Progress) -> JudgedPairs:
        """Judge all pairs, unless only another one of them is shown."""
        run, state, rule = job
        thresholds, last = state.params.closure, self._judged
        if last and (last.run, last.verdicts.params.closure, last.rule) == (run, thresholds, rule):
            return last
        return judge(run, thresholds, rule)

    def _on_judged(self, job: _Judging, judged: JudgedPairs, seconds: float) -> None:
        run, state, _ = job
        is_new, now = judged is not self._judged, self._desk.now
        whole = (None if is_new else self._cells.get("all")) or gather_all(judged)
        block = gather_block(judged, whole, state.compared_pair)
        large = None if is_new else self._cells.get("board")
        if now.board and large is None:
            large = gather_all(judged, MOST_ROWS)
        with self._lock:
            if run is not self._shown:
                return
            self._judged = judged
            every = {"all": whole, "block": block, "board": large}
            self._cells = {name: cells for name, cells in every.items() if cells is not None}
        if is_new:
            self._judging_took = seconds
        with self._desk.host.atomic():
            self._show(findings(judged, self._cells, state, now.decisions.verdicts))
        self._desk.host.flush()
        if is_new:
            news = "so_far" if run.num_left else "verdicts"
            self._desk.update_pairs(lambda pairs: pairs._replace(**{news: judged.verdicts}))

    # What is shown.

    def _show(self, html: dict[str, str]) -> None:
        """Show pictures and texts by their places; those that are missing are empty."""
        for place, handle in self.html.items():
            content = html.get(place, "")
            if place == "board":
                content = board_html(content) if self._desk.now.board else board_html(None)
            if handle.content != content:  # else a page would draw it anew, even under the hand
                handle.content = content
        judged = self._judged
        self._rule.visible = judged is not None and judged.check is not None

    # What the pictures say; it comes from a page.

    def _open_cell(self, _page: viser.ClientHandle, msg: CellMsg) -> None:
        pair = self._pair_at(msg)
        if pair is None:
            return
        if self._desk.now.subject == "world":
            self._modes.tune(*pair)
        else:
            self._desk.choose(*pair)

    def _point(self, page: viser.ClientHandle, msg: CellMsg) -> None:
        self.light(page, self._pair_at(msg) or ())

    def light(self, page: viser.ClientHandle, names: tuple[str, ...]) -> None:
        """Light up a submap or two where a page shows the map, and the cell of two in a matrix."""
        canvases, drawn = self._desk.canvases, ""
        if names and self._desk.now.subject == "world":
            drawn = light(names, self._world.scene, view_of(page), canvases.of(page))
        cells = {
            name: (*at, words_of(matrix, *at))
            for name, matrix in self._cells.items()
            if len(names) == 2 and (at := matrix.place(*names)) is not None
        }
        canvases.show(page, "lit", {"drawn": drawn, "cells": cells})

    def _pair_at(self, msg: CellMsg) -> PairOfIds | None:
        """The best pair of a cell, also by its mirror."""
        matrix = self._cells.get(msg.name)
        if matrix is None:
            return None
        row, column = int(msg.row), int(msg.column)
        cell = matrix.cells.get((row, column)) or matrix.cells.get((column, row))
        return None if cell is None else (cell.query, cell.database)

    def _set_threshold(self, _page: viser.ClientHandle, msg: ThresholdMsg) -> None:
        params, path = self._desk.state.asked, METHODS[self._desk.state.method].threshold
        field = next(field for field in parameters_of(PipelineParams) if field.path == path)
        try:
            rounded = msg.score if field.bounds is None else field.bounds.round(msg.score)
            params = with_path(params, path, int(rounded) if field.kind is int else rounded)
        except (InputError, ValueError, OverflowError):
            return  # no page of ours draws it out of bounds
        self._desk.change(params=params, moving=True)
        if msg.rested:
            self._desk.release(params)


def findings(
    judged: JudgedPairs,
    cells: Mapping[str, PairCells],
    state: ViewState,
    by_hand: Mapping[PairOfIds, bool],
) -> dict[str, str]:
    """Turn the judged pairs into pictures and words, by their places."""
    run, check, whole = judged.run, judged.check, cells["all"]
    lowest = METHODS[state.method].lowest(state.params)
    look = MatrixLook(lowest, by_hand)
    high, histogram = judged.top_score, count_scores(judged)
    shown = state.query_id, state.database_id
    closures = count(judged.num_accepted, "loop closure")
    num_skipped = judged.num_skipped - run.num_left
    skipped = f" ({num_skipped:,} were not compared)" if num_skipped else ""
    took = judged.verdicts.found.seconds.get("total")
    done = f"up to {run.num_left:,} are still to come" if took is None else f"{took:.1f} s"
    outcomes = list(judged.outcomes.values())
    by_motion = ", ".join(
        f"{outcomes.count(outcome)} {name}"
        for outcome, name in (
            (RIGHT, "with the right motion"),
            (WRONG_MOTION, "with a wrong motion"),
            (NO_OVERLAP, "without overlap"),
        )
    )
    summary = (
        f"{closures} in {count(len(judged.closures), 'pair')}{skipped}"
        f"{f': {by_motion}' if check else ''} · {done} · method {state.method}"
    )
    outdated = "The parameters have changed since: run again to update."
    note = "" if run.is_of(state) else message_line("all-pairs-message", outdated, BUSY)
    return {
        "matrix": matrix_html("all", whole, high, shown, look),
        "block": matrix_html("block", cells["block"], high, shown, look)
        if "block" in cells
        else "",
        "board": draw_board(judged, cells["board"], summary, shown, look)
        if "board" in cells
        else "",
        "summary": paragraph(summary, "font-weight:600") + note,
        "key": _folded("How to read it", _matrix_caption(judged, whole, high)),
        "scores": scores_html(judged, histogram),
        "disagreements": disagreements_html(judged, histogram),
        "curve": paragraph(_curve_caption(judged, check) if check else "", FAINT),
        "threshold": threshold_html(lowest),
        "reasons": _shortlist_html(judged, *shown),
    }


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
        f"(0) to yellow ({high:.1f}), with a step at the least score; pairs that were not compared "
        "are hatched. A white corner is a decision by hand: at the top left it accepts."
    )
    if judged.check is None:
        parts.append("Rings mark accepted pairs; magenta marks the pair shown.")
        return " ".join(parts)
    measure = "of the boxes" if judged.rule.measure == "box" else "of the surfaces"
    parts.append(
        f"Above it is the true overlap {measure}, from dark (0) to light (1). Green rings are "
        f"accepted pairs with the right motion, within {MAX_OFFSET:g} m and {MAX_TURN:g}°. Red "
        "crosses have a wrong motion, and white squares no common ground. Orange diamonds are "
        "missed pairs; magenta marks the pair shown."
    )
    return " ".join(parts)


def _curve_caption(judged: JudgedPairs, check: TruthCheck) -> str:
    if check.curve is None:
        return f"No pair is true by the rule {judged.rule.name}, so there is nothing to find."
    precision = f"{check.precision:.3f}" if np.isfinite(check.precision) else "—"
    return (
        f"At the present thresholds, precision is {precision} and recall {check.recall:.3f}. "
        "Drag the magenta line to another score. "
        f"Average precision {check.average_precision:.3f}. {judged.rule.statement}"
    )


def run_html(run: PairsRun) -> str:
    """Write the parameters of a run, which open on a click; not the thresholds, which may move."""
    method, given = METHODS[run.state.method], run.state.given
    registers = method.registered_by(given).closure != ClosureParams()
    listed = [
        f"{field.path} {_in_words(get_path(given, field.path))}"
        for field in parameters_of(PipelineParams)
        if field.path not in method.unused and (registers or not field.path.startswith("closure."))
    ]
    compared = next(name for name, value in CANDIDATES.items() if value == run.candidates)
    title = f"Parameters of this run: method {run.state.method}, compared with {compared}"
    return _folded(title, " · ".join(listed))


def _in_words(value: object) -> str:
    return (
        "automatic" if value is None else f"{value:.4g}" if isinstance(value, float) else f"{value}"
    )


def _folded(title: str, text: str) -> str:
    return (
        f'<details style="padding:.2em .75em;font-size:.85em"><summary style="cursor:pointer">'
        f'{escape(title)}</summary><div style="line-height:1.45;{FAINT}">{escape(text)}</div>'
        "</details>"
    )


def _shortlist_html(judged: JudgedPairs, query: str, database: str) -> str:
    """Write why a pair was looked at, the best candidates first; empty if all were."""
    shortlist: tuple[Candidate, ...] = judged.verdicts.found.shortlists.get(query, ())
    if not shortlist:
        return ""
    ids = [candidate.id for candidate in shortlist]
    place = (
        f"{database} is number {ids.index(database) + 1} among"
        if database in ids
        else f"{database} is not among them, so this pair was not compared. They are"
    )
    lead = (
        f"{query} was compared with {len(shortlist)} of {judged.run.dataset.index[query]:,} "
        f"earlier submaps. {place} the candidates whose keypoints fit best: by votes, which are "
        "associations that keep their distances, and by the similarity of all descriptors."
    )
    has_vectors = any(candidate.similarity for candidate in shortlist)  # few submaps have none
    rows = [("", "submap", "votes", "similarity")]
    for number, candidate in enumerate(shortlist, start=1):
        similarity = f"{candidate.similarity:.2f}" if has_vectors else "—"
        rows.append((str(number), candidate.id, str(candidate.votes), similarity))
    lines = ""
    for number, row in enumerate(rows):
        tag, look = ("td", "") if number else ("th", f"{FAINT};font-weight:inherit;")
        cells = "".join(
            f'<{tag} style="{look}padding-left:1em;text-align:right">{escape(cell)}</{tag}>'
            for cell in row
        )
        lines += f'<tr style="font-weight:{700 if row[1] == database else 400}">{cells}</tr>'
    return box(
        "shortlist",
        '<details><summary style="cursor:pointer">Why was this pair looked at?</summary>'
        f'<div style="line-height:1.45;margin:.3em 0">{escape(lead)}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums">{lines}</table>'
        "</details>",
        "font-size:.85em",
    )
