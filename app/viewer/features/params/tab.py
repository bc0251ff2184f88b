"""The parameters: wires the sliders, and the tools beside them, to the session."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.params.presets import PresetsTool
from app.viewer.features.params.sensitivity import SensitivityTool
from app.viewer.features.params.terrain import FitTool, NoiseTool
from app.viewer.features.params.undo import HistoryTool, ReferenceTool
from app.viewer.session.methods import METHOD_NAMES, METHODS, MethodName
from app.viewer.session.news import SessionState
from app.viewer.session.state import Widget
from app.viewer.widgets.actions import on_choice, on_press
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
    "map.prior_mean": Widget("Prior mean", {"constant": "one height", "local": "heights around"}),
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
