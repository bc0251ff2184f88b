"""What pages show while the dataset is being opened: what goes on, and how far it is."""

from html import escape

import viser

from app.viewer.host import PANEL_WIDTH
from gpgrad_core.run.progress import Progress

REPORT_EVERY = 0.01
"""The progress is shown anew once it has grown by this share of the whole."""


class WaitingPage:
    """Stands in the panel of every page until there is a session to show."""

    def __init__(self, server: viser.ViserServer, title: str) -> None:
        """Show it.

        Args:
            server: Whose pages show it.
            title: Names what is being opened.
        """
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._server = server
        self._title = gui.add_html(
            f'<h2 style="margin:10px 12px 2px;font-size:1.05em">Opening {escape(title)}</h2>'
        )
        self._words = gui.add_html(_line("Starting"))
        self._bar = gui.add_progress_bar(0.0, animated=True)

    def stage(self, words: str) -> Progress:
        """Say what is done next; returns where to report how far it is."""
        shown = 0.0
        self._words.content = _line(words)
        self._bar.value = 0.0

        def report(fraction: float) -> None:
            nonlocal shown
            if fraction - shown >= REPORT_EVERY:
                shown = fraction
                self._bar.value = 100 * min(fraction, 1.0)

        return report

    def remove(self) -> None:
        """Make room for the session."""
        for handle in (self._title, self._words, self._bar):
            handle.remove()
        self._server.flush()


def _line(words: str) -> str:
    return (
        f'<div data-testid="opening" role="status" style="padding:2px 12px;font-size:.9em">'
        f"{escape(words)} …</div>"
    )
