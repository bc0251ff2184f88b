"""The history of the parameters: undo and redo, and two that a person keeps, A and B."""

import threading
from functools import partial
from html import escape
from typing import Literal, TypeAlias

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.session.methods import MethodName
from app.viewer.session.news import SessionState
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_option, on_press
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import QUIET
from gpgrad_core.detection import PipelineParams
from gpgrad_core.params import AUTOMATIC, get_path, parameters_of, with_unit

LONGEST = 200
"""Steps remembered; the oldest are forgotten first."""
Setting: TypeAlias = tuple[MethodName, PipelineParams]
"""A method with its parameters."""
Name: TypeAlias = Literal["A", "B"]
KEEP: dict[str, Name] = {"Keep A": "A", "Keep B": "B"}
KEY = "9"
MOST_NAMED = 3
"""So many differences between A and B are named."""


class HistoryTool(Feature):
    """Remembers the method and its parameters; another dataset has a history of its own.

    A press that moves a slider is one step, like any other change. A page says when it lets go of a
    slider. No clock does, for a busy machine has another one.
    """

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the buttons in the current container; the commands get their keys."""
        self._desk, self._commands = desk, commands
        self._lock = threading.Lock()
        self._latest = setting_of(desk.state)
        self._note: viser.GuiHtmlHandle | None = None
        self._gone = False  # elsewhere, since a hand has moved anything
        self._begin()
        gui = desk.host.gui
        self._undo = gui.add_button(
            "Undo",
            disabled=True,
            icon=viser.Icon.ARROW_BACK_UP,
            hint="Goes back to the parameters before (Ctrl+Z).",
        )
        self._redo = gui.add_button(
            "Redo",
            icon=viser.Icon.ARROW_FORWARD_UP,
            hint="Takes the undo back (Ctrl+Shift+Z).",
            visible=False,
        )
        self.buttons = self._undo, self._redo
        for button, step, modifier in (
            (self._undo, -1, "cmd/ctrl"),
            (self._redo, 1, "cmd/ctrl+shift"),
        ):
            act = partial(self._go, step)
            on_press(button, act)
            commands.add("Parameters", button.label, act, key="Z", modifier=modifier)

    def add_snapshots(self) -> None:
        gui = self._desk.host.gui
        buttons = gui.add_button_group(
            "Snapshots",
            (*KEEP, "A ⇄ B"),
            hint="Keeps the parameters as they are now. The last button, or the key "
            f"{KEY}, changes between A and B.",
        )
        self._note = gui.add_html("")
        on_option(buttons, lambda label: self._keep(KEEP[label]) if label in KEEP else self._swap())
        for label, name in KEEP.items():
            act = partial(self._keep, name)
            self._commands.add("Parameters", f"{label}: these parameters", act)
        self._commands.add("Parameters", "Change between A and B", self._swap, key=KEY)

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the parameters, and remember where a hand has let go, unless that is undone."""
        setting = setting_of(state.view)
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
                self._push((self._latest[0], released))
            self._show()

    def _begin(self) -> None:
        self._steps, self._at = [self._latest], 0
        self._kept: dict[Name, Setting] = {}

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

    def _keep(self, name: Name) -> None:
        """Keep the present parameters under a name."""
        with self._lock:
            self._kept[name] = setting_of(self._desk.state)
            self._show()

    def _swap(self) -> None:
        """Change to the other one; to A from parameters that are neither."""
        wanted: Name = "B" if setting_of(self._desk.state) == self._kept.get("A") else "A"
        if wanted in self._kept:
            method, params = self._kept[wanted]
            self._desk.change(method=method, params=params)

    def _show(self) -> None:
        moved = self._latest != self._steps[self._at]
        self._undo.disabled = not (self._at or moved)
        self._redo.visible = self._at < len(self._steps) - 1 and not moved
        text = escape(self._words())
        if self._note is not None:
            self._note.content = (
                f'<div data-testid="snapshots" role="status" style="padding:0 .75em;font-size:12px;'
                f'line-height:1.4;color:{QUIET}">{text}</div>'
                if text
                else ""
            )

    def _words(self) -> str:
        if not self._kept:
            return ""
        shown = [name for name, kept in self._kept.items() if kept == self._latest]
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
        return AUTOMATIC
    return f"{value:g}" if isinstance(value, float) else str(value)


def setting_of(state: ViewState) -> Setting:
    """Give what a person has set."""
    return state.method, state.asked
