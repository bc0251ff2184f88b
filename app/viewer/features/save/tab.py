"""The tab Save: the session as a command and as a file, reports, and exports."""

import base64
import io
import textwrap
import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Literal, TypeAlias

import viser
from msgspec import Struct

from app.viewer.features.desk import Desk, Detect, Feature, Restore
from app.viewer.features.pair import figures_of, headline_of, in_words, sentences_of, whole_sentence
from app.viewer.features.work import Downloads, safe_name, send_file, write_closure_file
from app.viewer.scene.cameras import view_of
from app.viewer.scene.placement import Canvas
from app.viewer.session.decisions import Decisions, decide, with_verdict
from app.viewer.session.methods import METHODS, register_pair
from app.viewer.session.news import PairNews, PairShown, SessionState, Subject
from app.viewer.session.session_file import (
    ENDING,
    SavedSession,
    detect_command,
    page_commands,
    parse_session,
    session_text,
)
from app.viewer.session.state import ViewState
from app.viewer.web import fill_page_file
from app.viewer.widgets.actions import on_press_by, on_upload
from app.viewer.widgets.bridge import send
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import BAD, FAINT, button, paragraph
from app.viewer.widgets.status import WorkBar
from gpgrad_core import __version__
from gpgrad_core.detection import DetectionResult, PairResult, PipelineParams, infer_map
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.report import render
from gpgrad_core.io.records.closures import Decision, report_closures
from gpgrad_core.io.records.maps import write_map
from gpgrad_core.params import number_text, parameters_in_words
from gpgrad_core.run import Progress, part
from gpgrad_core.run.memo import Memo

WriteDecided: TypeAlias = Callable[[ViewState, DetectionResult, Decisions, Path, Progress], None]
"""Writes a file of the closures that were decided."""


class RestoreChoice(Struct):
    """Whether a session may replace what is open."""

    sure: bool


class SaveTab(Feature):
    """Shows the command that gives the same result; saves and restores the session."""

    def __init__(self, desk: Desk, restore: Restore) -> None:
        self._desk = desk
        self._open = restore
        self._lock = threading.Lock()
        self._unconfirmed: tuple[str, SavedSession] | None = (
            None  # file and content to be confirmed
        )
        gui = desk.host.gui
        self._command = gui.add_html("")
        save = gui.add_button(
            "Save session",
            hint="Saves dataset, pair, parameters, view, camera and decisions as a file for gpgrad "
            "view --state FILE.",
        )
        upload = gui.add_upload_button(
            "Restore session", mime_type=".toml", hint="Opens a file from 'Save session'."
        )
        self._message = gui.add_html("")
        on_press_by(save, self._save)
        on_upload(upload, self._restore)
        desk.bridge.on_message("restore", RestoreChoice, self._answer)
        self._show_command(desk.state)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Show the command for what is set now, and say that a saved session is there again."""
        if state.view is not before.view:
            self._show_command(state.view)
        opened = state.opened_since(before)
        if opened is not None and opened.saved is not None:
            self._tell("Restored.")

    def _show_command(self, state: ViewState) -> None:
        named = state.is_pair and state.source
        self._command.content = command_html(detect_command(state) if named else "")

    def on_pair_result(self, news: PairNews) -> None:
        """Show the command that compares all pairs, if all of them took part in the verdict."""
        if not isinstance(news, PairShown) or news.state is not self._desk.state:
            return
        if news.result.closure.context is not None and news.state.source:
            self._command.content = command_html(detect_command(news.state, alone=False))

    def _save(self, page: viser.ClientHandle) -> None:
        now, state = self._desk.now, self._desk.state
        name = safe_name(state.dataset.name, "session")
        try:
            text = session_text(state, view_of(page), now.decisions, now.keyframes)
        except InputError as error:
            self._tell(str(error), bad=True)
            return
        send_file(page, f"{name}{ENDING}", text.encode())

    def _restore(self, name: str, content: bytes) -> None:
        try:
            saved = parse_session(content, Path(name).name)
        except InputError as error:
            self._tell(str(error), bad=True)
            return
        with self._lock:
            self._unconfirmed = name, saved
        choices = "".join(
            button(label, send("restore", sure=sure), "margin:.3em .5em 0 0")
            for label, sure in (("Replace it", True), ("Keep it", False))
        )
        question = (
            f"{name} replaces the dataset, the pair, the parameters, the view and all decisions of "
            "this session."
        )
        self._show(f'{paragraph(question)}<div style="padding:0 .75em">{choices}</div>')

    def _answer(self, _page: viser.ClientHandle, answer: RestoreChoice) -> None:
        with self._lock:
            asked, self._unconfirmed = self._unconfirmed, None
        if asked is None:
            return
        name, saved = asked
        if answer.sure:
            self._tell(f"Restoring {name} …")
            self._open(saved)
        else:
            self._tell("Nothing was changed.")

    def _tell(self, message: str, *, bad: bool = False) -> None:
        self._show(paragraph(message, f"color:{BAD}" if bad else FAINT))

    def _show(self, content: str) -> None:
        self._message.content = f'<div data-testid="saving-message">{content}</div>'


def command_html(command: str) -> str:
    """Write the box with the command, and the button that copies it.

    A page may write to the clipboard only while it is being clicked, and only if it comes from this
    machine or over HTTPS; elsewhere a selected box is copied from.
    """
    if not command:
        return paragraph("There is no command for one submap alone: it is not a pair.", FAINT)
    intro = paragraph(
        "This command finds the same inliers, score and motion. Without --pair it compares all "
        "pairs."
    )
    return intro + fill_page_file("command.html", COMMAND=escape(command))


ENDINGS = {"HTML": ".html", "PNG": ".png"}
LONGEST_LINK = 4000
"""Letters of a link in a report; a longer one is left out."""


class WantedReport(Struct):
    """Which report a page wants, and its own address."""

    kind: Literal["HTML", "PNG"]
    link: str


class ReportTool(Feature):
    """Makes a report of the pair when a page asks for it."""

    def __init__(self, desk: Desk, commands: Commands) -> None:
        self._desk = desk
        gui = desk.host.gui
        with gui.add_folder("Report"):
            kind = gui.add_dropdown("Report as", tuple(ENDINGS), initial_value="HTML")
            report = gui.add_button(
                "Save report",
                hint="Saves verdict, both maps, difference, agreement, parameters, command and "
                "link of this pair as one file, which opens without a viewer.",
            )
            bar = WorkBar(desk.host, "Cancel report", "report", done_color="inherit")

        def ask(page: viser.ClientHandle) -> None:
            """Ask the page for its address first, which it alone knows."""
            desk.bridge.call(page, "where", {"kind": kind.value})

        def ask_of_wrong(page: viser.ClientHandle) -> None:
            """Decide against the verdict that is shown, and report the pair with that."""
            if self._shown is not None:
                closure = self._shown.result.closure
                right = not closure.accepted
                desk.decide(lambda decisions: with_verdict(decisions, closure.pair, right))
                ask(page)

        on_press_by(report, ask)
        self._downloads = Downloads(desk.jobs, bar, desk.capacity.long)
        self._shown: PairShown | None = None
        desk.bridge.on_message("here", WantedReport, self._order)
        commands.add_for_page("Session", "Save report", ask)
        commands.add_for_page("Session", "Report a wrong verdict", ask_of_wrong)

    def on_pair_result(self, news: PairNews) -> None:
        """Store the verdict that is shown: other pairs may have taken part in it."""
        if isinstance(news, PairShown):
            self._shown = news

    def _order(self, page: viser.ClientHandle, wanted: WantedReport) -> None:
        kind = wanted.kind
        is_link = wanted.link.startswith(("http://", "https://"))
        link = wanted.link if is_link and len(wanted.link) <= LONGEST_LINK else ""
        state, decisions = self._desk.state, self._desk.now.decisions
        pair = self._desk.state.compared_pair
        decision = Decision(decisions.verdicts.get(pair), decisions.notes.get(pair, ""))
        name = safe_name(f"report_{state.query_id}_{state.database_id}", "report") + ENDINGS[kind]
        shown = self._shown[1] if self._shown is not None and self._shown[0] is state else None
        write = partial(write_report, state, self._desk.memo, link, decision, shown=shown)
        self._downloads.order(page, name, write)


def write_report(
    state: ViewState,
    memo: Memo,
    link: str,
    decision: Decision,
    path: Path,
    progress: Progress,
    shown: PairResult | None = None,
) -> None:
    """Write a report as HTML or PNG, by the ending of the path.

    It is that of the result shown; if there is none, the pair is registered and judged alone.
    """
    from app.viewer.features.save.figures import draw_report  # noqa: PLC0415 - loads matplotlib

    told = part(progress, 0, 0.6)
    result = shown or register_pair(*state.pair, state.given, memo, told, method=state.method)
    headline = headline_of(result, with_score=True, decided=decision.accepted)
    if path.suffix == ".png":
        below = lines_below(state, result, link=link, decision=decision)
        draw_report(state, result, headline, below).savefig(path, dpi=220)  # as fine as two screens
        return
    picture = io.BytesIO()
    draw_report(state, result, headline).savefig(picture, dpi=110)
    progress(0.9)
    page = report_html(state, result, picture.getvalue(), link=link, decision=decision)
    path.write_text(page, encoding="utf-8")


UNTOUCHED = Decision()


def report_html(
    state: ViewState,
    result: PairResult,
    picture: bytes,
    *,
    link: str = "",
    decision: Decision = UNTOUCHED,
) -> str:
    """Write the page, which needs no other file, with a picture in PNG; the link may be empty."""
    pair = f"query {state.query_id}, database {state.database_id}"
    return render(
        Path(__file__).with_name("report.html"),
        title=f"{state.dataset.name}: {pair}",
        headline=headline_of(result, with_score=True, decided=decision.accepted),
        threshold=number_text(METHODS[state.method].lowest(state.params)),
        words=words_of(state, result, decision),
        note=decision.note,
        rows=figures_of(state, result),
        picture=base64.b64encode(picture).decode("ascii"),
        command=command_of(state, result),
        link=link,
        method=state.method,
        parameters=_parameters(state),
        version=__version__,
    )


def words_of(state: ViewState, result: PairResult, decision: Decision) -> str:
    """Write the sentences of the card, without the headline."""
    sentences = (whole_sentence(sentence.text) for sentence in sentences_of(state, result))
    return " ".join((in_words(state, result, decided=decision.accepted), *sentences))


def lines_below(
    state: ViewState, result: PairResult, *, link: str = "", decision: Decision = UNTOUCHED
) -> str:
    """Write what stands below the figure of a report that is one picture."""
    figures = " · ".join(f"{row.name} {row.text}" for row in figures_of(state, result))
    changed = [f"{path} {value}" for path, value, differs in _parameters(state) if differs]
    blocks = [
        words_of(state, result, decision),
        *([f"Note: {decision.note}"] if decision.note else []),
        figures,
        f"Method: {state.method}",
        "Parameters: " + (", ".join(changed) or "defaults"),
        "Command: " + command_of(state, result),
        *([f"Link: {link}"] if link else []),
        f"gpgrad {__version__}",
    ]
    # A line is broken where it would leave the picture.
    folded = textwrap.TextWrapper(140, subsequent_indent="    ", break_on_hyphens=False)
    return "\n".join(part for block in blocks for part in folded.wrap(block))


def command_of(state: ViewState, result: PairResult) -> str:
    """Write the command that finds the same; say why where there is none."""
    if not state.source:
        return "none: the dataset has no path"
    return detect_command(state, alone=result.closure.context is None)


def _parameters(state: ViewState) -> list[tuple[str, str, bool]]:
    base = METHODS[state.method].adapt(PipelineParams())
    return parameters_in_words(state.params, state.asked, base)


CLOSURES = {
    "JSON": "closures.json",
    "CSV": "closures.csv",
    "g2o": "graph.g2o",
    "TUM, corrected poses": "poses_corrected.txt",
}
"""File name by the form of the loop closures."""

MAPS = {"NPZ": ".npz", "GeoTIFF": ".tif", "PLY mesh": ".ply", "PNG": ".png"}
"""Ending by the format of a map."""

PICTURES = {"PNG": ".png", "SVG": ".svg", "PDF": ".pdf"}
"""Ending by the format of a picture; words, bars and ticks of the latter two stay lines."""
FINENESS = {"2 times": 2, "4 times": 4}
"""Pixels of a picture for each of the page, along each side."""
GROUNDS: dict[str, bool | None] = {"as the page": None, "light": False, "dark": True}
"""Whether a picture's ground is dark; None for what the page is."""
MOST_PIXELS = 8192
"""Along a side of a picture; what draws in a page without a graphics card ends there."""


class Exports(Feature):
    """Makes the files that pages ask for, of the session as it is when they ask."""

    def __init__(self, desk: Desk, detection: Callable[[ViewState], Detect]) -> None:
        """Make the panel in the current container; a detection of a state gives its closures."""
        self._desk, self._detection = desk, detection
        self._shown: PairShown | None = None
        gui = desk.host.gui
        with gui.add_folder("Export"):
            closures = gui.add_dropdown(
                "Closures as",
                tuple(CLOSURES),
                initial_value="JSON",
                hint="Format of the loop closures of all pairs.",
            )
            export = gui.add_button(
                "Export closures",
                hint="Registers all pairs with the present parameters where that is not done yet.",
            )
            whole = gui.add_button(
                "Export dataset page",
                hint="Saves one HTML page of all submaps and pairs: the map before and after its "
                "correction, scores, and every closure in 3D. It opens without a viewer.",
            )
            kind = gui.add_dropdown("Map as", tuple(MAPS), initial_value="NPZ")
            role = gui.add_dropdown(
                "Map of",
                ("query", "database"),
                initial_value="query",
                hint="Which submap to export.",
            )
            map_button = gui.add_button("Export map")
            picture_kind = gui.add_dropdown("Picture as", tuple(PICTURES), initial_value="PNG")
            fineness = gui.add_dropdown(
                "Picture size",
                tuple(FINENESS),
                initial_value="2 times",
                hint="Pixels for each of the page: 2 times for a slide, 4 times for print.",
            )
            ground = gui.add_dropdown("Picture ground", tuple(GROUNDS), initial_value="as the page")
            title = gui.add_text(
                "Picture title", "", hint="Empty takes the dataset and what is seen of it."
            )
            picture = gui.add_button(
                "Export picture",
                hint="Saves what this page shows, without the panels, with title, scale and "
                "colour bar.",
            )
            bar = WorkBar(desk.host, "Cancel export", "export", done_color="inherit")
        on_press_by(export, lambda page: self._order_closures(closures.value, page))
        on_press_by(whole, self._order_page)
        on_press_by(map_button, lambda page: self._order_map(kind.value, role.value, page))

        def order_picture(page: viser.ClientHandle) -> None:
            write = partial(
                _write_picture,
                desk,
                self._drawable(),
                desk.now.subject,
                page,
                FINENESS[fineness.value],
                title.value.strip(),
                GROUNDS[ground.value],
            )
            self._downloads.order(page, f"view{PICTURES[picture_kind.value]}", write)

        on_press_by(picture, order_picture)
        self._downloads = Downloads(desk.jobs, bar, desk.capacity.long)

    def on_pair_result(self, news: PairNews) -> None:
        """Keep what is shown, unless a hand has moved it."""
        self._shown = news if isinstance(news, PairShown) else None

    def _drawable(self) -> PairShown | None:
        """The pair that is shown if all that is visible of it can be drawn without the page."""
        state, shown = self._desk.state, self._shown
        is_pointed_at = state.match or state.probe or state.options.left_out
        return None if shown is None or shown.state is not state or is_pointed_at else shown

    def _order_closures(self, kind: str, page: viser.ClientHandle) -> None:
        self._order_decided(page, CLOSURES[kind], _write_closures)

    def _order_page(self, page: viser.ClientHandle) -> None:
        name = f"{safe_name(self._desk.state.dataset.name, 'dataset')}.html"
        self._order_decided(page, name, partial(write_dataset_page, self._desk.memo), 0.6)

    def _order_decided(
        self, page: viser.ClientHandle, name: str, write: WriteDecided, share: float = 1.0
    ) -> None:
        """Order a file of all pairs as decided; to find them takes a share of the work."""
        self._desk.catch_up()
        state, decisions = self._desk.state, self._desk.now.decisions
        detect = self._detection(state)

        def write_decided(path: Path, progress: Progress) -> None:
            found = detect(part(progress, 0.0, share))
            found = replace(found, closures=decide(found.closures, decisions))
            write(state, found, decisions, path, part(progress, share, 1.0))

        self._downloads.order(page, name, write_decided)

    def _order_map(self, kind: str, role: str, page: viser.ClientHandle) -> None:
        state = self._desk.state
        submap_id = state.query_id if role == "query" else state.database_id
        name = f"map_{safe_name(submap_id, role)}{MAPS[kind]}"
        write = partial(_write_map, state, self._desk.memo, submap_id)
        self._downloads.order(page, name, write)


def _write_closures(
    state: ViewState,
    found: DetectionResult,
    decisions: Decisions,
    path: Path,
    _progress: Progress,
) -> None:
    write_closure_file(path, state.dataset, found, state.given, state.method, decisions=decisions)


def write_dataset_page(
    memo: Memo,
    state: ViewState,
    found: DetectionResult,
    decisions: Decisions,
    path: Path,
    progress: Progress,
) -> None:
    """Write the page of the whole dataset, with the verdicts and decisions of the session."""
    from gpgrad_core import pages  # noqa: PLC0415 - loads the evaluation and the solver

    by_hand = decisions.of_closures()
    report = report_closures(
        state.dataset, found, state.given, method=state.method, decisions=by_hand
    )
    commands = page_commands(state, decided=bool(decisions.pairs))
    params = found.params or state.given
    subject = pages.subject_of(state.dataset, report, params, commands=commands)
    pages.write_page(path, subject, memo, progress)


def _write_map(
    state: ViewState, memo: Memo, submap_id: str, path: Path, progress: Progress
) -> None:
    submap = state.dataset.submap(submap_id)
    params = METHODS[state.method].of_submap(submap, state.given, memo, progress)
    gradient_map = infer_map(submap, params, memo, progress)
    write_map(path, gradient_map, name=submap_id, max_std_ratio=params.features.max_std_ratio)


def _write_picture(
    desk: Desk,
    shown: PairShown | None,
    subject: Subject,
    page: viser.ClientHandle,
    times: int,
    title: str,
    dark: bool | None,
    path: Path,
    progress: Progress,
) -> None:
    """Draw what a page sees, in a worker's thread: the pair here, all else by the page."""
    from app.viewer.features.save.figures import (  # noqa: PLC0415 - loads matplotlib
        Sheet,
        crop,
        draw_picture,
        ground_of,
        pair_view,
        rendered_view,
        save_picture,
    )

    progress(0.0)
    camera, canvases = page.camera, desk.canvases
    width, height = times * camera.image_width, times * camera.image_height
    if max(width, height) > MOST_PIXELS:
        raise InputError(
            f"the picture would be {width:,} x {height:,} pixels, more than {MOST_PIXELS:,} along "
            "a side; choose a smaller size, or make the window smaller"
        )
    is_dark = canvases.is_dark(page) if dark is None else dark
    caption, canvas = canvases.caption, Canvas(width, height)
    named = f"{desk.state.dataset.name} · {caption.get('title', '')}".removesuffix(" · ")
    words = title or named, " · ".join(filter(None, (caption.get("line"), caption.get("frame"))))
    if shown is not None and subject == "pair":
        view, written = pair_view(shown, desk.memo, view_of(page), canvas, words, is_dark, times)
    else:
        scale = canvases.scales.get(subject)
        view, written = rendered_view(page, canvas, words, scale, is_dark)
    view = crop(view, ground_of(is_dark))
    save_picture(draw_picture(view, written, Sheet.around(view.shape[1], view.shape[0])), path)
