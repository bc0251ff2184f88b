"""Commands for the keyboard: a palette (Ctrl/Cmd+K), single keys, and a page that lists them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any

import viser

from app.viewer.server.host import Host, PerPage, act_on, start_task
from app.viewer.server.internals import inputs_of
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.bridge import page_script

CAMERA_KEYS = frozenset("WASDQE") | {"arrowup", "arrowdown", "arrowleft", "arrowright"}
"""With these the browser flies the camera; a command on one of them would do both."""

BUTTONS = "Buttons"
"""Group of the commands that press a button."""

FLYING = (
    ("Drag", "turn the view"),
    ("Right drag", "move the view"),
    ("Wheel", "zoom"),
    ("W A S D Q E, arrows", "fly"),
    ("Shift + click", "read the values of a surface"),
)


@dataclass(frozen=True)
class Command:
    """A command as the help page lists it."""

    group: str
    label: str
    key: str | None
    modifier: str | None
    heard: str = ""

    @property
    def keys(self) -> str:
        if self.key is None:
            return self.heard
        parts = [*(self.modifier or "").split("+"), self.key]
        names = {"cmd/ctrl": "Ctrl/Cmd", "shift": "Shift", "alt": "Alt"}
        return " + ".join(names.get(part, part.capitalize()) for part in parts if part)


class Commands:
    """All commands of a session."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._commands: list[Command] = []
        self.add_for_page(
            "Help",
            "Show all keys and commands",
            lambda page: show_help(page, self.commands),
            key="H",
        )

    @property
    def commands(self) -> tuple[Command, ...]:
        return tuple(self._commands)

    def add(self, group: str, label: str, act: Callable[[], None], **keys: Any) -> None:
        """Add a command that does the same whichever page asks; see `add_for_page`."""
        self.add_for_page(group, label, lambda _: act(), **keys)

    def add_for_page(
        self,
        group: str,
        label: str,
        act: Callable[[viser.ClientHandle], None],
        *,
        key: Any = None,
        modifier: Any = None,
        heard: str = "",
    ) -> None:
        """Add a command, whose act runs in the server's event loop and must be quick.

        The help page has it under its group. ``heard`` is a key that a script of ours hears
        instead, where its part of a panel is visible.
        """
        if modifier is None and key in CAMERA_KEYS:
            raise ValueError(f"{label}: {key} flies the camera")
        taken = {(one.key or one.heard, one.modifier): one.label for one in self._commands}
        hears = key or heard, modifier
        if hears[0] and hears in taken:
            raise ValueError(f"{label}: {hears[0]} is taken by {taken[hears]!r}")
        self._commands.append(Command(group, label, key, modifier, heard))
        handle = self._host.gui.add_command(label, description=group, hotkey=key, modifier=modifier)

        @handle.on_trigger
        async def _(event: viser.CommandEvent) -> None:
            if event.client is not None:
                act(event.client)

    def add_buttons(self) -> None:
        """Add every button of the panels that has no command yet; call it when all are there."""
        labels = {command.label for command in self._commands}
        for handle in tuple(inputs_of(self._host).values()):
            if isinstance(handle, viser.GuiButtonHandle):
                presses = {handle.label: None}
            elif isinstance(handle, viser.GuiButtonGroupHandle):
                presses = {f"{handle.label}: {option}": option for option in handle.options}
            else:
                continue
            for label, option in presses.items():
                if label not in labels:
                    labels.add(label)
                    self.add_for_page(BUTTONS, label, partial(_press, handle, option, label))


def _press(handle: Any, option: str | None, label: str, page: viser.ClientHandle) -> None:
    """Press a button, or report that it cannot be pressed now."""
    if handle.disabled or not handle.visible:
        page.add_notification("Not possible now", label, auto_close_seconds=5.0)
        return
    start_task(act_on(handle, option, page))


_close_help = PerPage[Callable[[], None]]()


def show_help(client: viser.ClientHandle, commands: tuple[Command, ...]) -> None:
    """List all commands in a dialog on the page that asks; if it is there, close it."""
    if client in _close_help:
        _close_help.pop(client)()
        return
    modal = client.gui.add_modal("Keys and commands")
    _close_help[client] = modal.close
    with modal:
        client.gui.add_html(help_html(commands) + page_script("help.js"))
        close = client.gui.add_button("Close")
    on_press(close, lambda: show_help(client, commands))  # which closes it


def help_html(commands: tuple[Command, ...]) -> str:
    """Write the list, with a table per group."""
    groups: dict[str, list[tuple[str, str]]] = {"Picture": list(FLYING)}
    for command in commands:
        if command.group == BUTTONS:
            continue  # they are visible
        groups.setdefault(command.group, []).append((command.keys, command.label))
    tables = "".join(
        f'<div style="break-inside:avoid;margin-bottom:.8em"><b>{escape(group)}</b>'
        f'<table style="font-size:.85em">{"".join(_row(*row) for row in rows)}</table></div>'
        for group, rows in groups.items()
    )
    return (
        '<div data-testid="help" style="padding:0 .75em;columns:2 16em">'
        '<p style="font-size:.85em;margin-top:0;column-span:all">Press Ctrl/Cmd + K to find a '
        "command or a button by its name. Keys work while you do not type in a box: click the "
        "picture first.</p>"
        f"{tables}</div>"
    )


def _row(keys: str, label: str) -> str:
    key = f"<kbd>{escape(keys)}</kbd>" if keys else ""
    return (
        f'<tr><td style="padding:.1em .8em .1em 0;white-space:nowrap">{key}</td>'
        f"<td>{escape(label)}</td></tr>"
    )
