"""The tab Save: the session as a command and as a file, reports, and exports."""

import io
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import viser
from msgspec import Struct

from app.viewer.features.closure_files import write_closure_file
from app.viewer.features.desk import Desk, Feature, Restore, Subject
from app.viewer.features.pair import headline_of
from app.viewer.features.save.command_line import detect_command
from app.viewer.features.save.panel import ExportPanel, ReportPanel, SavingPanel
from app.viewer.features.save.report_page import lines_below, report_html
from app.viewer.features.work import Downloads, safe_name, send_file
from app.viewer.scene.cameras import view_of
from app.viewer.scene.overlay import scale_bar
from app.viewer.scene.placement import Canvas
from app.viewer.session.decisions import Decisions, decide
from app.viewer.session.methods import METHODS, map_params, register_pair
from app.viewer.session.session_file import (
    ENDING,
    Opened,
    SavedSession,
    parse_session,
    session_text,
)
from app.viewer.session.state import ViewState
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import detect_loop_closures, infer_map
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.maps import write_map
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, part
from gpgrad_core.run.threads import num_workers


class Answer(Struct):
    """Whether a session may replace what is open."""

    sure: bool


class SaveTab(Feature):
    """Shows the command that gives the same result; saves and restores the session."""

    def __init__(self, desk: Desk, restore: Restore) -> None:
        """Make the panel in the current container.

        Args:
            desk: Of the session.
            restore: Opens what a saved session had open.
        """
        self._desk = desk
        self._open = restore
        self._lock = threading.Lock()
        self._asked: tuple[str, SavedSession] | None = None  # file and content to be confirmed
        self._panel = SavingPanel(desk.host, on_save=self._save, on_restore=self._restore)
        desk.bridge.hear_as("restore", Answer, self._answer)
        self.follow(desk.state)

    def follow(self, state: ViewState) -> None:
        """Show the command for what is set now."""
        named = state.is_pair and state.source
        self._panel.show_command(detect_command(state) if named else "")

    def opened(self, opened: Opened) -> None:
        """Say that a saved session is there again."""
        if opened.saved is not None:
            self._panel.tell("Restored.")

    def _save(self, page: viser.ClientHandle) -> None:
        state = self._desk.state
        name = safe_name(state.dataset.name, "session")
        try:
            text = session_text(state, view_of(page), self._desk.decisions)
        except InputError as error:
            self._panel.tell(str(error), bad=True)
            return
        send_file(page, f"{name}{ENDING}", text.encode())

    def _restore(self, name: str, content: bytes) -> None:
        try:
            saved = parse_session(content, Path(name).name)
        except InputError as error:
            self._panel.tell(str(error), bad=True)
            return
        with self._lock:
            self._asked = name, saved
        self._panel.ask(name)

    def _answer(self, page: viser.ClientHandle, answer: Answer) -> None:
        """Restore what was asked about, or leave all as it is."""
        del page
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is None:
            return
        name, saved = asked
        if answer.sure:
            self._panel.tell(f"Restoring {name} …")
            self._open(saved)
        else:
            self._panel.tell("Nothing was changed.")


ENDINGS = {"HTML": ".html", "PNG": ".png"}
SCREEN_DPI, TWICE_DPI = 110, 220
"""A picture alone is twice as fine as a screen shows it."""
LONGEST_LINK = 4000


class WantedReport(Struct):
    """Which report a page wants, and its own address."""

    kind: Literal["HTML", "PNG"]
    link: str


class ReportTool(Feature):
    """Makes a report of the pair when a page asks for it."""

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the panel in the current container.

        Args:
            desk: Of the session.
            commands: Get one that saves a report.
        """
        self._desk = desk
        self._panel = ReportPanel(desk.host, tuple(ENDINGS), self._ask)
        self._downloads = Downloads(self._panel.work_bar, "report", desk.capacity.long)
        self.workers = (self._downloads,)
        desk.bridge.hear_as("here", WantedReport, self._order)
        commands.add_for_page(
            "Session", "Save report", lambda page: self._ask(self._panel.format, page)
        )

    def _ask(self, kind: str, page: viser.ClientHandle) -> None:
        """Ask the page for its address first, which it alone knows."""
        self._desk.bridge.call(page, "where", {"kind": kind})

    def _order(self, page: viser.ClientHandle, wanted: WantedReport) -> None:
        kind = wanted.kind
        is_link = wanted.link.startswith(("http://", "https://"))
        link = wanted.link if is_link and len(wanted.link) <= LONGEST_LINK else ""
        state, decisions = self._desk.state, self._desk.decisions
        accepted = decisions.verdicts.get(self._desk.shown_pair)
        note = decisions.notes.get(self._desk.shown_pair, "")
        decided = {None: "", True: "Accepted by hand.", False: "Refused by hand."}[accepted]
        words = f"{decided} Note: {note}".strip() if note else decided
        name = safe_name(f"report_{state.query_id}_{state.database_id}", "report") + ENDINGS[kind]
        write = partial(write_report, state, self._desk.memo, link, words)
        self._downloads.order(page, name, write)


def write_report(
    state: ViewState, memo: Memo, link: str, decided: str, path: Path, progress: Progress
) -> None:
    """Write a report; the ending of the path chooses the format.

    Args:
        state: The pair, and how it is judged.
        memo: Has what the viewer has computed.
        link: Address that shows the same; empty if there is none.
        decided: What a person has decided about the pair.
        path: Ends in .html or .png.
        progress: Called with the fraction done; may raise Cancelled.
    """
    from app.viewer.features.save.report_figure import draw_report  # noqa: PLC0415 - loads matplotlib

    told = part(progress, 0, 0.6)
    result = register_pair(*state.pair, state.given, memo, told, method=state.method)
    headline = headline_of(result, with_score=True)
    if path.suffix == ".png":
        below = lines_below(state, result, link=link, decided=decided)
        draw_report(state, result, headline, below).savefig(path, dpi=TWICE_DPI)
        return
    picture = io.BytesIO()
    draw_report(state, result, headline).savefig(picture, dpi=SCREEN_DPI)
    progress(0.9)
    page = report_html(state, result, picture.getvalue(), link=link, decided=decided)
    path.write_text(page, encoding="utf-8")


CLOSURES = {
    "JSON": "closures.json",
    "CSV": "closures.csv",
    "g2o": "graph.g2o",
    "TUM, corrected poses": "poses_corrected.txt",
}
"""File name by what is wanted of the loop closures."""

MAPS = {"NPZ": ".npz", "GeoTIFF": ".tif", "PLY mesh": ".ply", "PNG": ".png"}
"""Ending by the format of a map."""

PICTURE_PIXELS = 1800
"""The larger side of an exported picture is near this: enough for a slide."""
PICTURE_TIMEOUT = 60.0
"""A page without a graphics card draws for seconds [s]."""


class Exports(Feature):
    """Makes the files that pages ask for, of the session as it is when they ask."""

    def __init__(self, desk: Desk) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._subject: Subject = "pair"
        self._panel = ExportPanel(
            desk.host,
            closures=tuple(CLOSURES),
            maps=tuple(MAPS),
            on_closures=self._order_closures,
            on_map=self._order_map,
            on_picture=self._order_picture,
        )
        self._downloads = Downloads(self._panel.work_bar, "exports", desk.capacity.long)
        self.workers = (self._downloads,)

    def _order_closures(self, kind: str, page: viser.ClientHandle) -> None:
        write = partial(_write_closures, self._desk.state, self._desk.memo, self._desk.decisions)
        self._downloads.order(page, CLOSURES[kind], write)

    def _order_map(self, kind: str, role: str, page: viser.ClientHandle) -> None:
        state = self._desk.state
        submap_id = state.query_id if role == "query" else state.database_id
        name = f"map_{safe_name(submap_id, role)}{MAPS[kind]}"
        write = partial(_write_map, state, self._desk.memo, submap_id)
        self._downloads.order(page, name, write)

    def turned(self, subject: Subject) -> None:
        """Take that the scene shows the pair or the world."""
        self._subject = subject

    def _order_picture(self, page: viser.ClientHandle) -> None:
        write = partial(_write_picture, self._desk, self._subject, page)
        self._downloads.order(page, "view.png", write)


def _write_closures(
    state: ViewState, memo: Memo, decisions: Decisions, path: Path, progress: Progress
) -> None:
    dataset, params = state.dataset, state.given
    detector = METHODS[state.method].detector
    _ = state.pair  # refuses one submap alone
    with ThreadPoolExecutor(num_workers(), thread_name_prefix="export") as executor:
        result = detect_loop_closures(
            dataset,
            params,
            detector=None if detector is None else detector(params, memo),
            executor=executor,
            memo=memo,
            progress=progress,
        )
    decided = replace(result, closures=decide(result.closures, decisions))
    write_closure_file(path, dataset, decided, params, state.method, decisions=decisions)


def _write_map(
    state: ViewState, memo: Memo, submap_id: str, path: Path, progress: Progress
) -> None:
    submap = state.dataset.submap(submap_id)
    params = map_params(submap, state.given, memo, progress, state.method)
    gradient_map = infer_map(submap, params, memo, progress)
    write_map(path, gradient_map, name=submap_id, max_std_ratio=params.features.max_std_ratio)


def _write_picture(
    desk: Desk, subject: Subject, page: viser.ClientHandle, path: Path, progress: Progress
) -> None:
    """Ask the page for its view of the scene; in a worker's thread, because that takes seconds."""
    from app.viewer.features.save.picture import Written, draw_picture  # noqa: PLC0415 - loads matplotlib

    progress(0.0)
    camera, canvases = page.camera, desk.canvases
    larger = max(1, round(PICTURE_PIXELS / max(camera.image_width, camera.image_height)))
    width, height = larger * camera.image_width, larger * camera.image_height
    caption = canvases.caption
    written = Written(
        title=f"{desk.state.dataset.name} · {caption.get('title', '')}".removesuffix(" · "),
        line=" · ".join(filter(None, (caption.get("line"), caption.get("frame")))),
        bar=scale_bar(view_of(page), Canvas(width, height)),
        scale=canvases.scales.get(subject),
        dark=desk.state.options.dark,
    )
    try:
        view = page.get_render(
            height=height, width=width, transport_format="png", timeout=PICTURE_TIMEOUT
        )
    except TimeoutError as error:
        raise InputError(
            f"the page sent no picture within {PICTURE_TIMEOUT:.0f} s; bring its window to the "
            "front and try again"
        ) from error
    draw_picture(view, written).savefig(path)
