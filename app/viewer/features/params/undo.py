"""The history of the parameters: undo and redo, and A, which the present ones are shown beside."""

import threading
from functools import partial

import viser

from app.viewer.features.desk import Desk, Feature
from app.viewer.session.news import SessionState
from app.viewer.session.state import Setting
from app.viewer.widgets.actions import on_option, on_press
from app.viewer.widgets.commands import Commands

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
