"""The parameters: wires the sliders, and the tools beside them, to the session."""

from collections.abc import Callable
from contextlib import suppress

from app.viewer.feature import Desk, Feature
from app.viewer.opened import Opened
from app.viewer.params.fit import FitTool
from app.viewer.params.panel import ParamsPanel
from app.viewer.params.presets import PresetsTool
from app.viewer.params.sensitivity import SensitivityTool
from app.viewer.params.snapshots import SnapshotsTool
from app.viewer.params.undo import UndoTool
from app.viewer.state import ViewState
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.commands import Commands
from gpgrad_core.errors import InputError
from gpgrad_core.pipeline import PipelineParams, is_resolved

SWEPT = (
    "map.length_scale",
    "map.noise_std",
    "features.max_std_ratio",
    "registration.inlier_radius",
)
"""Those of the main parameters that change the score; the others are thresholds of it."""
MAIN_PARAMETERS = {
    "map.length_scale": "Length-scale",
    "map.noise_std": "Noise",
    "features.max_std_ratio": "Variance mask",
    "registration.inlier_radius": "Inlier radius",
    "closure.min_inliers": "Minimum inliers",
    "closure.min_score": "Minimum score",
}
"""The parameters that stand above the folded folder, and what people call them."""


class ParamsTab(Feature):
    """Sliders that change the session's parameters, and that follow where others change them."""

    def __init__(
        self,
        desk: Desk,
        default: PipelineParams,
        commands: Commands,
        on_error: Callable[[str], None],
    ) -> None:
        """Make the widgets in the current container.

        Args:
            desk: Of the session.
            default: What "Reset parameters" goes back to.
            commands: Get undo and redo.
            on_error: Given the message if a value is refused.
        """
        self._params = desk.state.params
        self._panel: ParamsPanel[PipelineParams] = ParamsPanel(
            desk.host,
            desk.state.params,
            lambda params: desk.change(params=params),
            main=MAIN_PARAMETERS,
            on_error=on_error,
            on_move=lambda params: desk.change(params=params, moving=True),
            numbers=desk.numbers,
        )
        desk.numbers.refuse, desk.numbers.rested = on_error, self._rest
        self._desk = desk
        self._panel.set_default(default)
        self._fit = desk.join(FitTool(desk))
        desk.join(UndoTool(desk, commands))
        reset = desk.host.gui.add_button(
            "Reset parameters", hint="Goes back to the parameters that this dataset started with."
        )
        on_press(reset, lambda: desk.change(params=self._panel.reset()))
        desk.join(SnapshotsTool(desk, commands))
        desk.join(SensitivityTool(desk, commands, {path: MAIN_PARAMETERS[path] for path in SWEPT}))
        desk.join(PresetsTool(desk))

    def follow(self, state: ViewState) -> None:
        """Move the sliders to parameters that came from elsewhere; fit what was made automatic."""
        before, self._params = self._params, state.params
        if _made_automatic(before, state.params):
            self._fit.choose(state.params)
        if state.params != self._panel.value:
            self._panel.set(state.params)

    def _rest(self, widget: str, value: float | None) -> None:
        """Tell where a slider was let go."""
        params = self._desk.state.params
        with suppress(InputError):  # what no slider of ours says
            if value is not None:
                params = self._panel.with_moved(params, widget, value)
            self._desk.tell(Feature.rested, params)

    def opened(self, opened: Opened) -> None:
        """Reset to what the new dataset prefers."""
        self._panel.set_default(opened.params)


def _made_automatic(before: PipelineParams, after: PipelineParams) -> bool:
    """Tell whether a parameter that is fitted to the dataset had a value, and no longer has."""
    return is_resolved(before) and not is_resolved(after)
