"""The session as a command and as a file: wires their panel to what writes and reads them."""

import re
from collections.abc import Callable
from pathlib import Path

import viser

from app.viewer.draw.placement import Camera
from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.save.command_line import detect_command
from app.viewer.save.panel import SavingPanel
from app.viewer.save.session_file import ENDING, Saved, parse_saved, saved_text
from app.viewer.state import ViewState
from gpgrad_core.errors import InputError

LARGEST = 100_000
"""Bytes of a saved session; any real one has a hundredth."""


class Saving(Part):
    """Follows the session with the command that finds it again; saves and restores it."""

    def __init__(
        self, host: Host, state: ViewState, *, on_restore: Callable[[Saved], None]
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            on_restore: Given the session to go to.
        """
        self._state = state
        self._on_restore = on_restore
        self._panel = SavingPanel(host, on_save=self._save, on_restore=self._restore)
        self.follow(state)

    def follow(self, state: ViewState) -> None:
        """Show the command for what is set now."""
        self._state = state
        is_pair = state.query_id != state.database_id and state.source
        self._panel.show_command(detect_command(state) if is_pair else "")

    def _save(self, client: viser.ClientHandle) -> None:
        text = saved_text(self._state, camera_of(client))
        name = re.sub(r"[^\w.+-]+", "_", self._state.dataset.name).strip("._") or "session"
        client.send_file_download(f"{name}{ENDING}", text.encode(), save_immediately=True)

    def _restore(self, name: str, content: bytes, client: viser.ClientHandle) -> None:
        del client
        try:
            if len(content) > LARGEST:
                raise InputError(f"{name}: is too large for a saved session")
            saved = parse_saved(content.decode("utf-8"), Path(name).name)
        except (InputError, UnicodeDecodeError) as error:
            self._panel.tell(str(error), bad=True)
            return
        self._panel.tell(f"Restoring {name} …")
        self._on_restore(saved)

    def restored(self) -> None:
        """Say that the session is there again."""
        self._panel.tell("Restored.")


def camera_of(client: viser.ClientHandle) -> Camera:
    """Read where a page looks from."""
    position, look_at = client.camera.position, client.camera.look_at
    return Camera(
        (float(position[0]), float(position[1]), float(position[2])),
        (float(look_at[0]), float(look_at[1]), float(look_at[2])),
    )
