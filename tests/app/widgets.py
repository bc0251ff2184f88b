"""Uses a server's widgets as a user's browser does, without a browser."""

import asyncio
import itertools
import json
from typing import Any

import viser

from app.viewer.widgets.bridge import Bridge

_numbers = itertools.count(1)


def find(server: viser.ViserServer, label: str) -> Any:
    """Find the widget whose label begins with a text."""
    found = [
        handle
        for handle in server.gui._gui_input_handle_from_uuid.values()
        if str(getattr(handle, "label", "")).startswith(label)
    ]
    assert len(found) == 1, f"{len(found)} widgets are called {label!r}"
    return found[0]


def labels(server: viser.ViserServer) -> list[str]:
    """List the labels of all widgets."""
    return [str(handle.label) for handle in server.gui._gui_input_handle_from_uuid.values()]


def html(server: viser.ViserServer) -> str:
    """Return all text in the panels."""
    containers = server.gui._container_handle_from_uuid.values()
    parts = [part for container in containers for part in container._children.values()]
    return "".join(part.content for part in parts if isinstance(part, viser.GuiHtmlHandle))


def user_sets(handle: Any, value: object) -> None:
    """Change a widget as a user does; unlike an assignment, the event has a client."""
    handle._impl.value = value
    event = viser.GuiEvent(client=None, client_id=1, target=handle)  # type: ignore[arg-type]
    for callback in handle._impl.update_cb:
        asyncio.run_coroutine_threadsafe(callback(event), handle._impl.gui_api._event_loop).result(
            timeout=60
        )


def user_presses(handle: Any) -> None:
    """Press a button as a user does."""
    user_sets(handle, True)


def html_says(bridge: Bridge, name: str, **data: object) -> None:
    """Say something as a script of a page does."""
    page = object.__new__(viser.ClientHandle)  # of no server; it only says who speaks
    page.client_id = 1
    page._websock_connection = Deaf()  # pyright: ignore[reportAttributeAccessIssue]
    said = {"number": next(_numbers), "times": 1, "name": name, "data": data}
    bridge._take(page, json.dumps(said))


class Deaf:
    """Stands for the connection to a page that takes no answer."""

    def queue_message(self, message: object) -> None:
        """Drop it."""
