"""The report: wires its panel to what draws and writes the file."""

import io
from functools import partial
from pathlib import Path

import viser

from app.viewer.downloads import Downloads, safe_name
from app.viewer.feature import Desk, Feature
from app.viewer.methods import register_pair
from app.viewer.pair import headline_of
from app.viewer.save.report_page import lines_below, report_html
from app.viewer.save.report_panel import ReportPanel
from app.viewer.state import ViewState
from app.viewer.widgets.bridge import Data
from app.viewer.widgets.commands import Commands
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, part

ENDINGS = {"HTML": ".html", "PNG": ".png"}
SCREEN_DPI, TWICE_DPI = 110, 220
"""A picture alone is twice as fine as a screen shows it."""
LONGEST_LINK = 4000


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
        desk.bridge.hear("here", self._order)
        commands.add_for_page(
            "Session", "Save report", lambda page: self._ask(self._panel.format, page)
        )

    def _ask(self, kind: str, page: viser.ClientHandle) -> None:
        """Ask the page for its address first, which it alone knows."""
        self._desk.bridge.call(page, "where", {"kind": kind})

    def _order(self, page: viser.ClientHandle, data: Data) -> None:
        kind, link = data.get("kind"), data.get("link")
        if not (isinstance(kind, str) and kind in ENDINGS and isinstance(link, str)):
            return
        if len(link) > LONGEST_LINK or not link.startswith(("http://", "https://")):
            link = ""
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
    from app.viewer.save.report_figure import draw_report  # noqa: PLC0415 - loads matplotlib

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
