"""Presets in the viewer: wires their panel to the files they are kept in."""

import re
import threading
import tomllib
from collections.abc import Callable
from pathlib import Path

import viser

from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.params.preset_files import (
    BUILT_IN,
    Preset,
    delete_preset,
    own_presets,
    preset_text,
    save_preset,
)
from app.viewer.params.presets_panel import PresetPanel
from app.viewer.state import ViewState
from gpgrad_core.errors import InputError
from gpgrad_core.params.files import preferred_parameters, with_tables
from gpgrad_core.pipeline import PipelineParams

LARGEST = 100_000
"""Bytes of a file of parameters; any real one has a hundredth."""


class Presets(Part):
    """Offers sets of parameters, and keeps the user's own."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        folder: Path | None,
        *,
        on_params: Callable[[PipelineParams], None],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            folder: Where the user's own presets are kept; None keeps none.
            on_params: Given the parameters to go to.
        """
        self._folder = folder
        self._on_params = on_params
        self._lock = threading.Lock()
        self._state = state
        self._shown: Preset | None = None
        self._own: tuple[Preset, ...] = ()
        self._panel = PresetPanel(
            host,
            can_save=folder is not None,
            on_choose=self._choose,
            on_save=self._save,
            on_delete=self._delete,
            on_download=self._download,
            on_upload=self._upload,
        )
        for note in self._read():
            self._panel.tell(note, bad=True)
        self._show()

    def follow(self, state: ViewState) -> None:
        """Point at the preset that the parameters are."""
        with self._lock:
            changed = state.params != self._state.params
            self._state = state
            if changed:
                self._show()

    def _read(self) -> tuple[str, ...]:
        notes: tuple[str, ...] = ()
        if self._folder is not None:
            self._own, notes = own_presets(self._folder)
        self._panel.offer(tuple(preset.name for preset in (*BUILT_IN, *self._own)))
        return notes

    def _show(self) -> None:
        params = self._state.params
        matching = [preset for preset in (*BUILT_IN, *self._own) if preset.params == params]
        self._shown = matching[0] if matching else None
        if self._shown is None:
            self._panel.show(None, "", own=False)
        else:
            self._panel.show(self._shown.name, self._shown.purpose, own=self._shown in self._own)

    def _choose(self, name: str) -> None:
        found = [preset for preset in (*BUILT_IN, *self._own) if preset.name == name]
        if found:
            self._on_params(found[0].params)

    def _save(self, name: str) -> None:
        with self._lock:
            if self._folder is None:
                return
            try:
                path = save_preset(self._folder, name, self._state.params)
            except InputError as error:
                self._panel.tell(str(error), bad=True)
                return
            self._read()
            self._show()
        self._panel.tell(f"Saved: {path}")

    def _delete(self) -> None:
        with self._lock:
            if self._folder is None or self._shown is None:
                return
            name = self._shown.name
            try:
                delete_preset(self._folder, name)
            except InputError as error:
                self._panel.tell(str(error), bad=True)
                return
            self._read()
            self._show()
        self._panel.tell(f"Deleted: {name}")

    def _download(self, name: str, client: viser.ClientHandle) -> None:
        name = name or (self._shown.name if self._shown else "parameters")
        file = re.sub(r"[^\w.+-]+", "_", name).strip("._") or "parameters"
        text = preset_text(name.replace("\n", " "), self._state.params)
        client.send_file_download(f"{file}.toml", text.encode(), save_immediately=True)

    def _upload(self, name: str, content: bytes) -> None:
        try:
            params = self._parsed(name, content)
        except InputError as error:
            self._panel.tell(str(error), bad=True)
            return
        self._panel.tell(f"Parameters of {name}")
        self._on_params(params)

    def _parsed(self, name: str, content: bytes) -> PipelineParams:
        """Read an uploaded file as ``--params`` would: over what the dataset prefers."""
        if len(content) > LARGEST:
            raise InputError(f"{name}: is too large for a file of parameters")
        try:
            tables = tomllib.loads(content.decode("utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputError(f"{name}: not a TOML file: {error}") from error
        base = preferred_parameters(self._state.dataset, PipelineParams())
        return with_tables(base, tables, name)
