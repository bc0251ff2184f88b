"""Uses a server's widgets as a user's browser does, without a browser."""

import asyncio
import itertools
import json
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import viser

from app.viewer.server.host import Host, act_on
from app.viewer.server.internals import inputs_of
from app.viewer.widgets.bridge import Bridge
from tests.support.page import FakePage

_numbers = itertools.count(1)


def find(host: Host, label: str) -> Any:
    """Find the widget of a label, or else the one whose label begins with that."""
    named = [(str(getattr(handle, "label", "")), handle) for handle in inputs_of(host).values()]
    handles = [handle for name, handle in named if name == label]
    handles = handles or [handle for name, handle in named if name.startswith(label)]
    assert len(handles) == 1, f"{len(handles)} widgets are called {label!r}"
    return handles[0]


def labels(host: Host) -> list[str]:
    """List the labels of all widgets."""
    return [str(handle.label) for handle in inputs_of(host).values()]


def said(host: Host, test_id: str = "") -> str:
    """Return all text in the panels, or that of the part of a name; empty if it says nothing."""
    gui: Any = host.gui  # viser has no public name for what lies in a panel
    parts = [
        part
        for container in gui._container_handle_from_uuid.values()
        for part in container._children.values()
    ]
    texts = [part.content for part in parts if isinstance(part, viser.GuiHtmlHandle)]
    return "".join(text for text in texts if not test_id or f'data-testid="{test_id}"' in text)


def node(host: Host, name: str) -> Any:
    """Find a node of the scene; None if there is none of that name."""
    return host.scene.get_handle_by_name(name)


def run_apart(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine in a thread: in the tests' own, a browser's driver has a loop already."""
    with ThreadPoolExecutor(1) as executor:
        executor.submit(asyncio.run, work).result()


def user_sets(handle: Any, value: object, page: FakePage | None = None) -> None:
    """Change a widget as a user does; unlike an assignment, the event has a client."""
    run_apart(act_on(handle, value, page))


def user_presses(handle: Any, page: FakePage | None = None) -> None:
    """Press a button as a user does."""
    user_sets(handle, True, page)


def html_says(bridge: Bridge, name: str, /, page: FakePage | None = None, **data: object) -> None:
    """Say something as a script of a page does."""
    message = {"number": next(_numbers), "times": 1, "name": name, "data": data}
    bridge.take(page or FakePage(), json.dumps(message))


def press_key(
    host: Host, key: str, modifier: str | None = None, page: FakePage | None = None
) -> None:
    """Let a page press the key of a command."""
    gui: Any = host.gui  # viser has no public name for its commands
    (handle,) = [
        handle
        for handle in gui._command_handle_from_uuid.values()
        if (handle.hotkey, handle.modifier) == (key, modifier)
    ]
    _trigger(handle, page)


def run_command(host: Host, label: str, page: FakePage | None = None) -> None:
    """Let a page choose a command from the palette."""
    gui: Any = host.gui
    (handle,) = [
        handle for handle in gui._command_handle_from_uuid.values() if handle.label == label
    ]
    _trigger(handle, page)


def _trigger(handle: Any, page: FakePage | None) -> None:
    event = viser.CommandEvent(client=page or FakePage(), client_id=1, target=handle)
    for callback in handle._impl.trigger_cb:
        run_apart(callback(event))
