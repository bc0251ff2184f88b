"""Undo and redo of the parameters: wires two buttons and two keys to their history."""

import threading
from collections.abc import Callable
from functools import partial

from app.viewer.feature import Desk, Feature
from app.viewer.params.history import History
from app.viewer.state import ViewState
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams, is_resolved
from gpgrad_core.types import Dataset

SETTLED_AFTER = 0.7
"""Parameters that have not moved for so long are worth coming back to [s]: a drag is one step."""


class UndoTool(Feature):
    """Remembers the parameters at which the sliders came to rest."""

    def __init__(
        self, desk: Desk, commands: Commands, *, settled_after: float = SETTLED_AFTER
    ) -> None:
        """Make the buttons in the current container.

        Args:
            desk: Of the session.
            commands: Where their keys join.
            settled_after: See `SETTLED_AFTER` [s].
        """
        self._desk = desk
        self._settled_after = settled_after
        self._lock = threading.Lock()
        self._history = History(desk.state.params)
        self._dataset: Dataset = desk.state.dataset
        self._latest = desk.state.params
        self._timer: threading.Timer | None = None
        gui = desk.host.gui
        self._undo = gui.add_button(
            "Undo", disabled=True, hint="Goes back to the parameters before (Ctrl+Z)."
        )
        self._redo = gui.add_button(
            "Redo", disabled=True, hint="Takes the undo back (Ctrl+Shift+Z).", visible=False
        )
        for button, label, move, modifier in (
            (self._undo, "Undo", History[PipelineParams].undo, "cmd/ctrl"),
            (self._redo, "Redo", History[PipelineParams].redo, "cmd/ctrl+shift"),
        ):
            act = partial(self._go, move)
            on_press(button, act)
            commands.add("Parameters", label, act, key="Z", modifier=modifier)

    def follow(self, state: ViewState) -> None:
        """Follow the parameters; those of another dataset have a history of their own."""
        with self._lock:
            if state.dataset is not self._dataset:
                self._stop()
                self._dataset, self._latest = state.dataset, state.params
                self._history = History(state.params)
                self._show()
            elif is_resolved(self._latest) and not is_resolved(state.params):
                pass  # a fit follows, whose result is what can be undone
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
        self._desk.change(params=params)

    def _show(self) -> None:
        moved = self._latest != self._history.present
        self._undo.disabled = not (self._history.past or moved)
        self._redo.visible = bool(self._history.future) and not moved
