"""Undo and redo of the parameters: wires two buttons and two keys to their history."""

import threading
from collections.abc import Callable
from functools import partial
from typing import TypeAlias

from app.viewer.feature import Desk, Feature
from app.viewer.methods import MethodName
from app.viewer.params.history import History
from app.viewer.state import ViewState
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.types import Dataset

Setting: TypeAlias = tuple[MethodName, PipelineParams]
"""A method with its parameters."""


class UndoTool(Feature):
    """Remembers the method and its parameters.

    A press that moves a slider is one step, like any other change. A page says when it lets go of a
    slider. No clock does, for a busy machine has another one.
    """

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the buttons in the current container.

        Args:
            desk: Of the session.
            commands: Where their keys join.
        """
        self._desk = desk
        self._lock = threading.Lock()
        self._latest: Setting = setting_of(desk.state)
        self._history = History(self._latest)
        self._dataset: Dataset = desk.state.dataset
        self._gone = False  # elsewhere, since a hand has moved anything
        gui = desk.host.gui
        self._undo = gui.add_button(
            "Undo", disabled=True, hint="Goes back to the parameters before (Ctrl+Z)."
        )
        self._redo = gui.add_button(
            "Redo", disabled=True, hint="Takes the undo back (Ctrl+Shift+Z).", visible=False
        )
        for button, label, move, modifier in (
            (self._undo, "Undo", History[Setting].undo, "cmd/ctrl"),
            (self._redo, "Redo", History[Setting].redo, "cmd/ctrl+shift"),
        ):
            act = partial(self._go, move)
            on_press(button, act)
            commands.add("Parameters", label, act, key="Z", modifier=modifier)

    def follow(self, state: ViewState) -> None:
        """Follow the parameters; those of another dataset have a history of their own."""
        setting = setting_of(state)
        with self._lock:
            if state.dataset is not self._dataset:
                self._dataset, self._latest = state.dataset, setting
                self._history = History(setting)
                self._show()
            elif setting != self._latest:
                if not self._desk.moving:
                    # What a hand has moved before, and not let go of, is a step of its own.
                    self._history = self._history.push(self._latest).push(setting)
                self._latest = setting
                self._gone = False
                self._show()

    def rested(self, params: PipelineParams) -> None:
        """Remember where a hand has let go, unless that is undone already."""
        with self._lock:
            if not self._gone:
                self._history = self._history.push((self._latest[0], params))
                self._show()

    def _go(self, move: Callable[[History[Setting]], History[Setting]]) -> None:
        with self._lock:
            self._history = move(self._history.push(self._latest))
            method, params = self._latest = self._history.present
            self._gone = True
            self._show()
        self._desk.change(method=method, params=params)

    def _show(self) -> None:
        moved = self._latest != self._history.present
        self._undo.disabled = not (self._history.past or moved)
        self._redo.visible = bool(self._history.future) and not moved


def setting_of(state: ViewState) -> Setting:
    """Give what a person has set."""
    return state.method, state.asked
