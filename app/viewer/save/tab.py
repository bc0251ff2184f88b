"""The session as a command and as a file: wires their panel to what writes and reads them."""

import threading
from pathlib import Path

import viser

from app.viewer.downloads import safe_name, send_file
from app.viewer.draw.cameras import view_of
from app.viewer.feature import Desk, Feature, Restore
from app.viewer.opened import Opened
from app.viewer.save.command_line import detect_command
from app.viewer.save.panel import SavingPanel
from app.viewer.session_file import ENDING, SavedSession, parse_session, session_text
from app.viewer.state import ViewState
from app.viewer.widgets.bridge import Data
from gpgrad_core.errors import InputError


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
        desk.bridge.hear("restore", self._answer)
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

    def _answer(self, page: viser.ClientHandle, data: Data) -> None:
        """Restore what was asked about, or leave all as it is."""
        del page
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is None:
            return
        name, saved = asked
        if data.get("sure") is True:
            self._panel.tell(f"Restoring {name} …")
            self._open(saved)
        else:
            self._panel.tell("Nothing was changed.")
