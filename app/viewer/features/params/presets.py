"""Presets: sets of parameters with a name and what they are good for, built in or one's own."""

import re
import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import tomli_w
import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.work import safe_name, send_file
from app.viewer.session.methods import METHODS, MethodName
from app.viewer.session.news import SessionState
from app.viewer.widgets.actions import on_choice, on_press, on_press_by, on_upload
from app.viewer.widgets.html import BAD, FAINT, GOOD, paragraph
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError, writable
from gpgrad_core.io.records.files import replacing
from gpgrad_core.methods.paper import paper_params
from gpgrad_core.params import preferred_parameters, read_parameters, to_tables, with_tables
from gpgrad_core.reading.records import parse_toml

NAME = re.compile(r"[^\W_][\w .()+-]{0,59}")
"""What a preset may be called, so that it can be a file's name on every system."""

MOST = 200
"""Presets of one's own; any page may save some, and each session reads all of them."""


@dataclass(frozen=True)
class Preset:
    """Parameters worth coming back to."""

    name: str
    purpose: str  # what it is good for, in one line
    params: PipelineParams
    # whose parameters they are; None is any method's, as a file does not say
    method: MethodName | None = "gradient"

    def is_set(self, method: MethodName, params: PipelineParams) -> bool:
        return params == self.params and self.method in (None, method)


def _with(**groups: Mapping[str, object]) -> PipelineParams:
    return with_tables(PipelineParams(), groups, "preset")


BUILT_IN: tuple[Preset, ...] = (
    Preset(
        "default",
        "For stereo clouds of a rover with a point every few centimetres. It finds nearly all "
        "true closures, and no false one, on a Mars yard, a volcano and the Moon.",
        PipelineParams(),
    ),
    Preset(
        "paper",
        "The method of Le Gentil et al. 2020 with its own numbers: a tuning of every submap, 5,000 "
        "points, SURF, Algorithm 1 and five inliers.",
        paper_params(PipelineParams()),
        "paper",
    ),
    Preset(
        "rough ground",
        "For rocks and ripples of a few decimetres in dense clouds. A shorter length-scale keeps "
        "them, and the neighbours of each point measure its noise.",
        _with(map={"length_scale": 0.2, "noise_model": "measured"}),
    ),
    Preset(
        "smooth ground",
        "For swells of half a metre and more in noisy clouds. A longer length-scale averages over "
        "more points, and the neighbours of each point measure its noise.",
        _with(map={"length_scale": 0.45, "noise_model": "measured"}),
    ),
)


def _built_in(default: PipelineParams) -> tuple[Preset, ...]:
    """The presets that are built in, where the default is what the dataset prefers."""
    first, *others = BUILT_IN
    if default == first.params:
        return BUILT_IN
    preferred = "What this dataset was opened with."
    return (replace(first, purpose=preferred, params=default), *others)


def own_presets(folder: Path) -> tuple[tuple[Preset, ...], tuple[str, ...]]:
    """Read the user's presets by name, and say of each file in a line why it cannot be read."""
    presets: list[Preset] = []
    notes: list[str] = []
    try:
        paths = sorted(folder.glob("*.toml"))
    except OSError as error:  # another's home
        return (), (f"{folder}: {error.strerror or error}",)
    for path in paths:
        try:
            if not NAME.fullmatch(path.stem):
                raise InputError(f"{path.name}: cannot be the name of a preset")
            presets.append(_own(path, read_parameters(path, PipelineParams())))
        except (InputError, OSError) as error:
            notes.append(str(error))
    return tuple(presets), tuple(notes)


def save_preset(folder: Path, name: str, params: PipelineParams) -> Preset:
    """Save parameters as one of the user's presets, in place of one of the same name."""
    path = _path(folder, name)
    with writable(path):
        if len([other for other in folder.glob("*.toml") if other != path]) >= MOST:
            raise InputError(f"There are {MOST} presets, which is the most: delete one first")
        folder.mkdir(parents=True, exist_ok=True)
        with replacing(path) as unfinished:
            unfinished.write_text(preset_text(name, params), encoding="utf-8")
    return _own(path, params)


def delete_preset(folder: Path, name: str) -> None:
    """Delete one of the user's presets."""
    try:
        _path(folder, name).unlink()
    except OSError as error:
        raise InputError(f"{name}: is not one of your own presets") from error


def preset_text(name: str, params: PipelineParams) -> str:
    """Write the TOML of a preset."""
    return f"# gpgrad parameters: {name}\n{tomli_w.dumps(to_tables(params))}"


def _own(path: Path, params: PipelineParams) -> Preset:
    return Preset(path.stem, f"Your own: {path}", params, None)


def _path(folder: Path, name: str) -> Path:
    name = name.strip()
    if not NAME.fullmatch(name) or name.endswith("."):
        raise InputError(
            f"{name!r} cannot be a preset's name: use up to 60 letters, digits, spaces and . + - ()"
        )
    if any(name == preset.name for preset in BUILT_IN):
        raise InputError(f"{name!r} is a built-in preset: choose another name")
    return folder / f"{name}.toml"


CUSTOM: str = "custom"
LARGEST = 100_000
"""Bytes of a file of parameters; any real one has a hundredth. It is parsed in a thread of its own,
which such a file keeps busy for a tenth of a second at most."""


class PresetsTool(Feature):
    """Offers sets of parameters, and keeps the user's own."""

    def __init__(self, desk: Desk, default: PipelineParams) -> None:
        """Make the list, and a folded folder to keep one's own, in the current container."""
        self._desk = desk
        self._built_in = _built_in(default)
        self._lock = threading.Lock()
        self._own: tuple[Preset, ...] = ()
        gui, folder = desk.host.gui, desk.permissions.presets
        self._list: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Preset", (CUSTOM,), initial_value=CUSTOM, hint="A preset sets all parameters."
        )
        self.purpose = gui.add_html("")
        with gui.add_folder("Save as preset", expand_by_default=False):
            name = gui.add_text("Name", "", hint="Use letters, digits, spaces and . + - ( ).")
            save = gui.add_button(
                "Save preset",
                visible=folder is not None,
                hint="Saves the present parameters in the list, for later sessions too.",
            )
            self._delete_button = gui.add_button("Delete preset", visible=False, color="red")
            download = gui.add_button("Download parameters", hint="Saves a TOML file for --params.")
            upload = gui.add_upload_button(
                "Upload parameters",
                mime_type=".toml",
                hint="Loads a TOML file like those for --params.",
            )
        self.message = gui.add_html("")
        on_choice(self._list, self._choose)
        on_press_by(download, lambda page: self._download(name.value.strip(), page))
        on_upload(upload, self._upload)
        own: Iterable[Preset] = ()
        if folder is not None:
            on_press(save, lambda: self._answer(lambda: self._save(folder, name.value.strip())))
            on_press(self._delete_button, lambda: self._answer(lambda: self._delete(folder)))
            own, notes = own_presets(folder)
            for note in notes:
                self._tell(note, bad=True)
        self._offer(own)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Point at the preset that the parameters are; what a dataset opens with is the default."""
        with self._lock:
            if opened := state.opened_since(before):
                self._built_in = _built_in(opened.params)
            elif state.view.setting == before.view.setting:
                return
            self._show()

    def _offer(self, own: Iterable[Preset]) -> None:
        """Offer presets of the user's own too; no files are read anew, which would take time."""
        self._own = tuple(own)
        self._list.options = (CUSTOM, *(preset.name for preset in (*self._built_in, *self._own)))
        self._show()

    def _show(self) -> None:
        setting = self._desk.state.setting
        matching = [preset for preset in (*self._built_in, *self._own) if preset.is_set(*setting)]
        preset = matching[0] if matching else None
        self._list.value = CUSTOM if preset is None else preset.name
        self.purpose.content = "" if preset is None else paragraph(preset.purpose, FAINT)
        self._delete_button.visible = preset in self._own

    def _tell(self, message: str, *, bad: bool = False) -> None:
        colored = paragraph(message, f"color:{BAD if bad else GOOD};overflow-wrap:anywhere")
        self.message.content = f'<div data-testid="preset-message">{colored}</div>'

    def _answer(self, act: Callable[[], str]) -> None:
        """Run an act, and report its result or why it was refused."""
        try:
            self._tell(act())
        except InputError as error:
            self._tell(str(error), bad=True)

    def _choose(self, name: str) -> None:
        for preset in (*self._built_in, *self._own):
            if preset.name == name:
                self._desk.change(method=preset.method, params=preset.params)
                return

    def _save(self, folder: Path, name: str) -> str:
        with self._lock:
            saved = save_preset(folder, name, self._desk.state.asked)
            others = [preset for preset in self._own if preset.name != saved.name]
            self._offer(sorted((*others, saved), key=lambda preset: preset.name))
        return saved.purpose.replace("Your own", "Saved")

    def _delete(self, folder: Path) -> str:
        with self._lock:
            name = self._list.value
            delete_preset(folder, name)
            self._offer(preset for preset in self._own if preset.name != name)
        return f"Deleted: {name}"

    def _download(self, name: str, client: viser.ClientHandle) -> None:
        shown = self._list.value
        name = name or (shown if shown != CUSTOM else "parameters")
        text = preset_text(name.replace("\n", " "), self._desk.state.asked)
        send_file(client, f"{safe_name(name, 'parameters')}.toml", text.encode())

    def _upload(self, name: str, content: bytes) -> None:
        """Apply an uploaded file over what the method takes for the dataset."""

        def take() -> str:
            tables = parse_toml(content, name, LARGEST)
            base = preferred_parameters(self._desk.state.dataset, PipelineParams())
            params = with_tables(METHODS[self._desk.state.method].adapt(base), tables, name)
            self._desk.change(params=params)
            return f"Parameters of {name}"

        self._answer(take)
