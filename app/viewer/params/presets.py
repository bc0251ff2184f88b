"""Presets in the viewer: wires their panel to the files they are kept in."""

import threading
from collections.abc import Iterable

import viser

from app.viewer.feature import Desk, Feature
from app.viewer.methods import METHODS
from app.viewer.params.preset_files import (
    BUILT_IN,
    Preset,
    delete_preset,
    own_presets,
    preset_text,
    save_preset,
)
from app.viewer.params.presets_panel import PresetPanel
from app.viewer.params.undo import setting_of
from app.viewer.state import ViewState
from app.viewer.work import safe_name, send_file
from gpgrad_core.errors import InputError
from gpgrad_core.params.files import preferred_parameters, with_tables
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.reading.toml_files import parse_toml

LARGEST = 100_000
"""Bytes of a file of parameters; any real one has a hundredth. It is parsed in a thread of its own,
which such a file keeps busy for a tenth of a second at most."""


class PresetsTool(Feature):
    """Offers sets of parameters, and keeps the user's own."""

    def __init__(self, desk: Desk) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._folder = desk.permissions.presets
        self._lock = threading.Lock()
        self._state = desk.state
        self._shown: Preset | None = None
        self._own: tuple[Preset, ...] = ()
        self._panel = PresetPanel(
            desk.host,
            can_save=self._folder is not None,
            on_choose=self._choose,
            on_save=self._save,
            on_delete=self._delete,
            on_download=self._download,
            on_file=self._upload,
        )
        own, notes = ((), ()) if self._folder is None else own_presets(self._folder)
        for note in notes:
            self._panel.tell(note, bad=True)
        self._offer(own)

    def follow(self, state: ViewState) -> None:
        """Point at the preset that the parameters are."""
        with self._lock:
            changed = setting_of(state) != setting_of(self._state)
            self._state = state
            if changed:
                self._show()

    def _offer(self, own: Iterable[Preset]) -> None:
        """Offer presets of the user's own beside those that are built in.

        What is saved or deleted later is told here; reading all files anew would make pages wait.
        """
        self._own = tuple(own)
        self._panel.offer(tuple(preset.name for preset in (*BUILT_IN, *self._own)))
        self._show()

    def _show(self) -> None:
        setting = setting_of(self._state)
        matching = [preset for preset in (*BUILT_IN, *self._own) if preset.is_set(*setting)]
        self._shown = matching[0] if matching else None
        if self._shown is None:
            self._panel.show(None, "", own=False)
        else:
            self._panel.show(self._shown.name, self._shown.purpose, own=self._shown in self._own)

    def _choose(self, name: str) -> None:
        found = [preset for preset in (*BUILT_IN, *self._own) if preset.name == name]
        if found:
            self._desk.change(method=found[0].method, params=found[0].params)

    def _save(self, name: str) -> None:
        with self._lock:
            if self._folder is None:
                return
            try:
                saved = save_preset(self._folder, name, self._state.asked)
            except InputError as error:
                self._panel.tell(str(error), bad=True)
                return
            others = [preset for preset in self._own if preset.name != saved.name]
            self._offer(sorted((*others, saved), key=lambda preset: preset.name))
        self._panel.tell(saved.purpose.replace("Your own", "Saved"))

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
            self._offer(preset for preset in self._own if preset.name != name)
        self._panel.tell(f"Deleted: {name}")

    def _download(self, name: str, client: viser.ClientHandle) -> None:
        name = name or (self._shown.name if self._shown else "parameters")
        text = preset_text(name.replace("\n", " "), self._state.asked)
        send_file(client, f"{safe_name(name, 'parameters')}.toml", text.encode())

    def _upload(self, name: str, content: bytes) -> None:
        try:
            params = self._parsed(name, content)
        except InputError as error:
            self._panel.tell(str(error), bad=True)
            return
        self._panel.tell(f"Parameters of {name}")
        self._desk.change(params=params)

    def _parsed(self, name: str, content: bytes) -> PipelineParams:
        """Read an uploaded file over what the method takes for the dataset."""
        tables = parse_toml(content, name, LARGEST)
        base = preferred_parameters(self._state.dataset, PipelineParams())
        return with_tables(METHODS[self._state.method].adapt(base), tables, name)
