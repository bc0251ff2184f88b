"""Undo and redo of the parameters: wires two buttons and two keys to their history."""

import threading
from collections.abc import Callable

import viser

from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.params.history import History
from app.viewer.state import ViewState
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.types import Dataset

SETTLED_AFTER = 0.7
"""Parameters that have not moved for so long are worth coming back to [s]: a drag is one step."""


class Undo(Part):
    """Remembers the parameters that sliders came to rest at."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        commands: Commands,
        *,
        on_params: Callable[[PipelineParams], None],
        settled_after: float = SETTLED_AFTER,
    ) -> None:
        """Make the buttons in the current container.

        Args:
            host: Whose GUI they join.
            state: The session as it is.
            commands: Where their keys join.
            on_params: Given the parameters to go to.
            settled_after: See `SETTLED_AFTER` [s].
        """
        self._on_params = on_params
        self._settled_after = settled_after
        self._lock = threading.Lock()
        self._history = History(state.params)
        self._dataset: Dataset = state.dataset
        self._latest = state.params
        self._timer: threading.Timer | None = None
        gui = host.gui
        self._undo = gui.add_button(
            "Undo", disabled=True, hint="Back to the parameters before (Ctrl+Z)."
        )
        self._redo = gui.add_button(
            "Redo", disabled=True, hint="Takes back an undo (Ctrl+Shift+Z).", visible=False
        )
        commands.add(
            "Parameters",
            "Undo",
            lambda client: self._go(History.undo),  # noqa: ARG005
            key="Z",
            modifier="cmd/ctrl",
        )
        commands.add(
            "Parameters",
            "Redo",
            lambda client: self._go(History.redo),  # noqa: ARG005
            key="Z",
            modifier="cmd/ctrl+shift",
        )

        @self._undo.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            self._go(History.undo)

        @self._redo.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            del event
            self._go(History.redo)

    def follow(self, state: ViewState) -> None:
        """Follow the parameters; those of another dataset have a history of their own."""
        with self._lock:
            if state.dataset is not self._dataset:
                self._stop()
                self._dataset, self._latest = state.dataset, state.params
                self._history = History(state.params)
                self._show()
            elif state.params != self._latest:
                self._latest = state.params
                self._stop()
                self._timer = threading.Timer(self._settled_after, self._settle)
                self._timer.daemon = True
                self._timer.start()
                self._show()

    def close(self) -> None:
        """Stop waiting."""
        with self._lock:
            self._stop()

    def _stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _settle(self) -> None:
        with self._lock:
            self._history = self._history.push(self._latest)
            self._show()

    def _go(self, move: Callable[[History[PipelineParams]], History[PipelineParams]]) -> None:
        with self._lock:
            self._stop()
            self._history = move(self._history.push(self._latest))
            params = self._latest = self._history.present
            self._show()
        self._on_params(params)

    def _show(self) -> None:
        moved = self._latest != self._history.present
        self._undo.disabled = not (self._history.past or moved)
        self._redo.visible = bool(self._history.future) and not moved
