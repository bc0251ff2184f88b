"""The parameters: wires the sliders, their history and the tools beside them to the session."""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.params.presets import PresetsTool
from app.viewer.features.params.sensitivity import SensitivityTool
from app.viewer.features.params.terrain import FitTool, NoiseTool
from app.viewer.session.methods import METHOD_NAMES, METHODS, MethodName
from app.viewer.session.news import SessionState
from app.viewer.session.state import Setting, Widget
from app.viewer.widgets.actions import on_choice, on_option, on_press
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import put_in_a_row
from app.viewer.widgets.panel import Panel
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams

MAIN_PARAMETERS = {
    "map.length_scale": "Length-scale",
    "map.noise_std": "Noise",
    "features.max_std_ratio": "Variance mask",
    "registration.inlier_radius": "Inlier radius",
    "closure.min_inliers": "Minimum inliers",
    "closure.min_score": "Minimum score",
}
"""The parameters that stand above the folded folder, and what people call them."""
FOLDED = {
    "map.noise_model": Widget(
        "Noise model",
        {"auto": "automatic", "range": "grows with range", "file": "from the file"},
    ),
    "map.signal_std": Widget("Relief"),
    "map.max_points": Widget("Largest cloud", automatic="All points"),
    "map.resolution": Widget("Cell size"),
    "map.scale": Widget("Finest detail"),
    "features.max_keypoints": Widget("Most keypoints"),
    "features.detector.name": Widget("Detector"),
    "features.detector.gradient_range": Widget("White slope"),
    "matching.ratio": Widget("Ratio test"),
    "matching.mutual": Widget("Only mutual"),
    "registration.trials": Widget("RANSAC trials"),
    "registration.hypotheses": Widget("RANSAC motions"),
    "registration.searched": Widget("Search motions"),
    "registration.seed": Widget("Random seed"),
    "closure.max_mean_dissimilarity": Widget("Most h of a cell", automatic="Any h of a cell"),
    "closure.max_std": Widget("Max deviation"),
    "closure.others": Widget(
        "Other pairs",
        {"off": "ignored", "terrain": "their terrain", "odometry": "and odometry"},
    ),
    "closure.images": Widget(
        "Camera images",
        {"off": "ignored", "show": "only shown", "veto": "may refuse", "require": "must confirm"},
    ),
}
"""What people call those below it, and the choices among them."""
LIMIT = "closure.max_dissimilarity"
"""It stands there too, but has no number until a person sets one."""
MORE = "More"
OF_EACH = {
    path: f"{name} per submap"
    for path, name in (
        ("map.length_scale", "Length-scale"),
        ("map.noise_std", "Noise"),
        ("map.signal_std", "Relief"),
    )
}
"""What the box for "automatic" says where a method fits these to every submap."""


LONGEST = 200
"""Steps remembered; the oldest are forgotten first."""
KEEP, SWAP, LEAVE = "Keep as A", "A ⇄ B", "Leave"


class HistoryTool(Feature):
    """Remembers the method and its parameters; another dataset has a history of its own.

    A press that moves a slider is one step, like any other change. A page says when it lets go of a
    slider. No clock does, for a busy machine has another one.
    """

    def __init__(self, desk: Desk, commands: Commands) -> None:
        self._desk = desk
        self._lock = threading.Lock()
        self._latest = desk.state.setting
        self._gone = False  # elsewhere, since a hand has moved anything
        self._begin()
        gui = desk.host.gui
        self._redo = gui.add_button(
            "Redo",
            icon=viser.Icon.ARROW_FORWARD_UP,
            hint="Takes the undo back (Ctrl+Shift+Z).",
            visible=False,
        )
        self._undo = gui.add_button(
            "Undo",
            disabled=True,
            icon=viser.Icon.ARROW_BACK_UP,
            hint="Goes back to the parameters before (Ctrl+Z).",
        )
        self.buttons = self._undo, self._redo
        for button, step, modifier in (
            (self._undo, -1, "cmd/ctrl"),
            (self._redo, 1, "cmd/ctrl+shift"),
        ):
            act = partial(self._go, step)
            on_press(button, act)
            commands.add("Parameters", button.label, act, key="Z", modifier=modifier)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the parameters, and remember where a hand has let go, unless that is undone."""
        setting = state.view.setting
        with self._lock:
            if state.view.dataset is not before.view.dataset:
                self._latest = setting
                self._begin()
            elif setting != self._latest:
                if not state.moving:
                    # What a hand has moved before, and not let go of, is a step of its own.
                    self._push(self._latest)
                    self._push(setting)
                self._latest, self._gone = setting, False
            released = state.released
            if released is not None and released is not before.released and not self._gone:
                self._push(Setting(self._latest.method, released))
            self._show()

    def _begin(self) -> None:
        self._steps, self._at = [self._latest], 0

    def _push(self, setting: Setting) -> None:
        """Settle on a setting; what was undone before is forgotten. The present one stays."""
        if setting != self._steps[self._at]:
            self._steps = [*self._steps[: self._at + 1], setting][-LONGEST - 1 :]
            self._at = len(self._steps) - 1

    def _go(self, step: int) -> None:
        """Undo (-1) or redo (1); the first and the last stay."""
        with self._lock:
            self._push(self._latest)
            self._at = min(max(self._at + step, 0), len(self._steps) - 1)
            method, params = self._latest = self._steps[self._at]
            self._gone = True
            self._show()
        self._desk.change(method=method, params=params)

    def _show(self) -> None:
        moved = self._latest != self._steps[self._at]
        self._undo.disabled = not (self._at or moved)
        self._undo.visible = self._desk.now.mode == "Tune"
        self._redo.visible = self._undo.visible and self._at < len(self._steps) - 1 and not moved


class ReferenceTool(Feature):
    """Sets the setting that the present one is shown beside: A, while the sliders change B."""

    def __init__(self, desk: Desk, commands: Commands) -> None:
        self._desk = desk
        acts = {KEEP: self._keep, SWAP: self._swap, LEAVE: desk.leave_reference}
        self._buttons = desk.host.gui.add_button_group(
            "A | B",
            (KEEP,),
            hint="Keeps the parameters as they are as A. From then on the scene shows A beside B, "
            "which the sliders change.",
        )
        on_option(self._buttons, lambda label: acts[label]())
        for label, key in ((KEEP, "0"), (SWAP, "9"), (LEAVE, None)):
            commands.add("Parameters", f"A | B: {label}", acts[label], key=key)

    def on_state(self, before: SessionState, state: SessionState) -> None:  # noqa: ARG002
        options = (KEEP,) if state.view.reference is None else (KEEP, SWAP, LEAVE)
        if self._buttons.options != options:
            self._buttons.options = options

    def _keep(self) -> None:
        self._desk.change(reference=self._desk.state.setting)

    def _swap(self) -> None:
        state = self._desk.state
        if state.reference is not None:
            method, params = state.reference
            self._desk.change(method=method, params=params, reference=state.setting)


class ParamsTab(Feature):
    """Sliders that change the session's parameters, and that follow where others change them."""

    def __init__(
        self,
        desk: Desk,
        default: PipelineParams,
        commands: Commands,
        on_error: Callable[[str], None],
    ) -> None:
        """Make the widgets in the current container; the default is what the reset goes to."""
        self._desk = desk
        self._default = default
        self._shown: MethodName = desk.state.method
        self._add_row(commands)
        # the folder in which all of it lies
        self.container = desk.host.gui.add_folder("Parameters")
        with self.container:
            self._panel: Panel[PipelineParams] = Panel(
                desk.host,
                desk.state.asked,
                self._change,
                widgets={path: Widget(name) for path, name in MAIN_PARAMETERS.items()}
                | {LIMIT: Widget("Maximum h", automatic="no limit on h")}
                | {path: replace(widget, folded=True) for path, widget in FOLDED.items()},
                folder=MORE,
                below={
                    LIMIT: lambda: self._add_reference(commands),
                    MORE: self._add_tools,
                },
                numbers=desk.numbers,
                used=desk.state.params,
                default=default,
                on_move=lambda params: self._change(params, moving=True),
                on_error=on_error,
            )
        desk.join(SensitivityTool(desk, MAIN_PARAMETERS, self._panel.uuid_of))
        desk.numbers.refuse, desk.numbers.rested = on_error, self._rest
        self._show_method(desk.state.method)

    def _add_row(self, commands: Commands) -> None:
        """Add undo, redo and reset as icons beside the status; the first stands at the right."""
        desk = self._desk
        self._reset = desk.host.gui.add_button(
            "Reset parameters",
            icon=viser.Icon.RESTORE,
            hint="Goes back to the parameters that this dataset started with.",
        )
        on_press(self._reset, lambda: desk.change(params=self._panel.reset()))
        history = desk.join(HistoryTool(desk, commands))
        put_in_a_row(desk.host, (self._reset, *history.buttons))

    def _add_reference(self, commands: Commands) -> None:
        self._desk.join(ReferenceTool(self._desk, commands))

    def _add_tools(self) -> None:
        desk = self._desk
        self._method = desk.host.gui.add_dropdown(
            "Method",
            METHOD_NAMES,
            initial_value=desk.state.method,
            hint=" ".join(f"{name}: {method.summary}" for name, method in METHODS.items())
            + " Each method keeps its own parameters.",
        )
        on_choice(self._method, lambda name: desk.change(method=name))
        desk.join(PresetsTool(desk, self._default))
        desk.join(FitTool(desk))
        desk.join(NoiseTool(desk))

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Move the sliders to parameters that came from elsewhere, or from a fit."""
        view = state.view
        self._reset.visible = state.mode == "Tune"
        if (view.asked, view.params) != (self._panel.value, self._panel.used):
            self._panel.set(view.asked, view.params)
        opened = state.opened_since(before)
        if opened is not None:
            self._default = opened.params
        if opened is not None or view.method != self._shown:
            self._show_method(view.method)

    def _show_method(self, name: MethodName) -> None:
        """Show what the method can use, and reset to what it begins with."""
        self._shown, method = name, METHODS[name]
        self._method.value = name
        automatic = OF_EACH if method.fits_each else {}
        self._panel.adapt(method.adapt(self._default), method.unused, automatic)

    def _rest(self, widget: str, value: float | None) -> None:
        params = self._desk.state.asked
        with suppress(InputError):  # what no slider of ours says
            if value is not None:
                params = self._panel.with_moved(params, widget, value)
            self._desk.release(params)

    def _change(self, asked: PipelineParams, *, moving: bool = False) -> None:
        before = self._desk.state
        terrain = with_noise_set(asked.map, before.asked.map, before.params.map)
        self._desk.change(params=replace(asked, map=terrain), moving=moving)


def with_noise_set(asked: MapParams, before: MapParams, used: MapParams) -> MapParams:
    """Choose the noise model that noise of which a person has set a part belongs to.

    It is the one in use, unless that would ignore the noise set: then it is constant.
    """
    names = ("noise_growth", "noise_factor")
    moved = {name: getattr(asked, name) for name in names}
    moved = {name: value for name, value in moved.items() if value != getattr(before, name)}
    if asked.noise_std is None and moved:
        asked = replace(asked, noise_std=used.noise_std)
    if not before.chooses_noise or asked.noise_std is None or asked.noise_model != "auto":
        return asked
    if not moved and used.noise_model not in ("constant", "range"):
        return asked  # automatic with a noise is constant
    kept = {name: getattr(used, name) for name in names} | moved
    return replace(asked, noise_model=used.noise_model, **kept)
