"""Two snapshots of the parameters, A and B, and one key that changes between them."""

from html import escape
from typing import Literal, TypeAlias

from app.viewer.feature import Desk, Feature
from app.viewer.params.undo import Setting, setting_of
from app.viewer.state import ViewState
from app.viewer.widgets.actions import on_option
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import QUIET
from gpgrad_core.params.fields import get_path, parameters_of, with_unit
from gpgrad_core.pipeline import PipelineParams

Name: TypeAlias = Literal["A", "B"]
KEEP: dict[str, Name] = {"Keep A": "A", "Keep B": "B"}
SWITCH = "A ⇄ B"
KEY = "9"
MOST_NAMED = 3
"""So many differences between A and B are named."""


class SnapshotsTool(Feature):
    """Keeps two sets of parameters, and changes between them."""

    def __init__(self, desk: Desk, commands: Commands) -> None:
        """Make the buttons in the current container.

        Args:
            desk: Of the session.
            commands: Where the keys join.
        """
        self._desk = desk
        self._state = desk.state
        self._kept: dict[Name, Setting] = {}
        buttons = desk.host.gui.add_button_group(
            "Snapshots",
            (*KEEP, SWITCH),
            hint="Keeps the parameters as they are now. The last button, or the key "
            f"{KEY}, changes between A and B.",
        )
        self._note = desk.host.gui.add_html("")
        on_option(buttons, self._press)
        for label, name in KEEP.items():
            commands.add(
                "Parameters", f"{label}: these parameters", lambda name=name: self.keep(name)
            )
        commands.add("Parameters", "Change between A and B", self.switch, key=KEY)
        self._show()

    def keep(self, name: Name) -> None:
        """Keep the present parameters under a name."""
        self._kept[name] = setting_of(self._state)
        self._show()

    def switch(self) -> None:
        """Change to the other one; to A from parameters that are neither."""
        wanted: Name = "B" if setting_of(self._state) == self._kept.get("A") else "A"
        if wanted in self._kept:
            method, params = self._kept[wanted]
            self._desk.change(method=method, params=params)

    def follow(self, state: ViewState) -> None:
        """Say which one is shown; those of another dataset are gone."""
        before, self._state = self._state, state
        if state.dataset is not before.dataset:
            self._kept.clear()
        elif setting_of(state) == setting_of(before):
            return
        self._show()

    def _press(self, label: str) -> None:
        if label in KEEP:
            self.keep(KEEP[label])
        else:
            self.switch()

    def _show(self) -> None:
        text = escape(self._said())
        self._note.content = (
            f'<div data-testid="snapshots" role="status" style="padding:0 .75em;font-size:.8em;'
            f'line-height:1.4;color:{QUIET}">{text}</div>'
            if text
            else ""
        )

    def _said(self) -> str:
        if not self._kept:
            return ""
        shown = [name for name, kept in self._kept.items() if kept == setting_of(self._state)]
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
    found: list[str] = []
    for field in parameters_of(PipelineParams):
        before, after = get_path(first, field.path), get_path(second, field.path)
        if before != after:
            name = with_unit(field.name.replace("_", " "), field.bounds)
            found.append(f"{name} {_text(before)} → {_text(after)}")
    if not found:
        return "A and B are the same."
    more = len(found) - MOST_NAMED
    return ", ".join(found[:MOST_NAMED]) + (f", and {more} more" if more > 0 else "") + "."


def _text(value: object) -> str:
    if value is None:
        return "automatic"
    return f"{value:g}" if isinstance(value, float) else str(value)
