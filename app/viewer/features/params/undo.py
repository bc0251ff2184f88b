"""Undo and redo of the parameters, and two snapshots of them, A and B."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from typing import Generic, Literal, TypeAlias, TypeVar

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.session.methods import MethodName
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_option, on_press
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import QUIET
from gpgrad_core.detection import PipelineParams
from gpgrad_core.params import get_path, parameters_of, with_unit

T = TypeVar("T")

LONGEST = 200
"""Values remembered; the oldest are forgotten first."""


@dataclass(frozen=True)
class History(Generic[T]):
    """The values that were settled on, in order; the functions return a changed copy."""

    present: T
    past: tuple[T, ...] = ()  # the newest last
    future: tuple[T, ...] = ()  # the next to be redone last

    def push(self, value: T) -> "History[T]":
        """Settle on a value; what was undone before is forgotten. The present one changes nothing.

        >>> History(1).push(2).push(2).undo()
        History(present=1, past=(), future=(2,))
        """
        if value == self.present:
            return self
        return History(value, (*self.past, self.present)[-LONGEST:])

    def undo(self) -> "History[T]":
        """Go back by one; the first stays."""
        if not self.past:
            return self
        return replace(
            self, present=self.past[-1], past=self.past[:-1], future=(*self.future, self.present)
        )

    def redo(self) -> "History[T]":
        """Take back an undo; the last stays."""
        if not self.future:
            return self
        return replace(
            self, present=self.future[-1], past=(*self.past, self.present), future=self.future[:-1]
        )


Setting: TypeAlias = tuple[MethodName, PipelineParams]
"""A method with its parameters."""


class UndoTool(Feature):
    """Remembers the method and its parameters.

    A press that moves a slider is one step, like any other change. A page says when it lets go of a
    slider. No clock does, for a busy machine has another one.
    """

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the buttons in the current container; the commands get their keys."""
        self._desk = desk
        self._lock = threading.Lock()
        self._latest: Setting = setting_of(desk.state)
        self._history = History(self._latest)
        self._gone = False  # elsewhere, since a hand has moved anything
        gui = desk.host.gui
        self._undo = gui.add_button(
            "Undo",
            disabled=True,
            icon=viser.Icon.ARROW_BACK_UP,
            hint="Goes back to the parameters before (Ctrl+Z).",
        )
        self._redo = gui.add_button(
            "Redo",
            disabled=False,
            icon=viser.Icon.ARROW_FORWARD_UP,
            hint="Takes the undo back (Ctrl+Shift+Z).",
            visible=False,
        )
        self.buttons = self._undo, self._redo
        for button, label, move, modifier in (
            (self._undo, "Undo", History[Setting].undo, "cmd/ctrl"),
            (self._redo, "Redo", History[Setting].redo, "cmd/ctrl+shift"),
        ):
            act = partial(self._go, move)
            on_press(button, act)
            commands.add("Parameters", label, act, key="Z", modifier=modifier)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the parameters; those of another dataset have a history of their own."""
        setting = setting_of(state.view)
        with self._lock:
            if state.view.dataset is not before.view.dataset:
                self._latest, self._history = setting, History(setting)
                self._show()
            elif setting != self._latest:
                if not state.moving:
                    # What a hand has moved before, and not let go of, is a step of its own.
                    self._history = self._history.push(self._latest).push(setting)
                self._latest = setting
                self._gone = False
                self._show()
            released = state.released
            if released is not None and released is not before.released and not self._gone:
                self._history = self._history.push((self._latest[0], released))
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


Name: TypeAlias = Literal["A", "B"]
KEEP: dict[str, Name] = {"Keep A": "A", "Keep B": "B"}
KEY = "9"
MOST_NAMED = 3
"""So many differences between A and B are named."""


class SnapshotsTool(Feature):
    """Keeps two sets of parameters, and changes between them."""

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the buttons in the current container; the commands get their keys."""
        self._desk = desk
        self._kept: dict[Name, Setting] = {}
        buttons = desk.host.gui.add_button_group(
            "Snapshots",
            (*KEEP, "A ⇄ B"),
            hint="Keeps the parameters as they are now. The last button, or the key "
            f"{KEY}, changes between A and B.",
        )
        self.note = desk.host.gui.add_html("")
        on_option(buttons, self._press)
        for label, name in KEEP.items():
            commands.add(
                "Parameters", f"{label}: these parameters", lambda name=name: self.keep(name)
            )
        commands.add("Parameters", "Change between A and B", self.switch, key=KEY)
        self._show()

    def keep(self, name: Name) -> None:
        """Keep the present parameters under a name."""
        self._kept[name] = setting_of(self._desk.state)
        self._show()

    def switch(self) -> None:
        """Change to the other one; to A from parameters that are neither."""
        wanted: Name = "B" if setting_of(self._desk.state) == self._kept.get("A") else "A"
        if wanted in self._kept:
            method, params = self._kept[wanted]
            self._desk.change(method=method, params=params)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Say which one is shown; those of another dataset are gone."""
        if state.view.dataset is not before.view.dataset:
            self._kept.clear()
        elif setting_of(state.view) == setting_of(before.view):
            return
        self._show()

    def _press(self, label: str) -> None:
        if label in KEEP:
            self.keep(KEEP[label])
        else:
            self.switch()

    def _show(self) -> None:
        text = escape(self._words())
        self.note.content = (
            f'<div data-testid="snapshots" role="status" style="padding:0 .75em;font-size:12px;'
            f'line-height:1.4;color:{QUIET}">{text}</div>'
            if text
            else ""
        )

    def _words(self) -> str:
        if not self._kept:
            return ""
        shown = [name for name, kept in self._kept.items() if kept == setting_of(self._desk.state)]
        here = f"{' and '.join(sorted(shown))} shown." if shown else "Neither is shown."
        if len(self._kept) < 2:
            (other,) = {"A", "B"} - set(self._kept)
            return f"{here} Change something, and keep it as {other}."
        (method, params), (other_method, other_params) = self._kept["A"], self._kept["B"]
        if method != other_method:
            return f"{here} A is the method {method}, B the method {other_method}."
        return f"{here} {differences(params, other_params)}"


def differences(first: PipelineParams, second: PipelineParams) -> str:
    """Say in what A and B differ."""
    told: list[str] = []
    for field in parameters_of(PipelineParams):
        before, after = get_path(first, field.path), get_path(second, field.path)
        if before != after:
            name = with_unit(field.name.replace("_", " "), field.bounds)
            told.append(f"{name} {_text(before)} → {_text(after)}")
    if not told:
        return "A and B are the same."
    more = len(told) - MOST_NAMED
    return ", ".join(told[:MOST_NAMED]) + (f", and {more} more" if more > 0 else "") + "."


def _text(value: object) -> str:
    if value is None:
        return "automatic"
    return f"{value:g}" if isinstance(value, float) else str(value)
