"""The host of a session: a server with all its pages, or one page.

viser's server and its handle of one client have the same ``gui`` and ``scene``, so that nothing
else needs to know which of the two it is drawing on.
"""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, TypeAlias, TypeVar
from weakref import WeakKeyDictionary

import viser

from app.viewer.server.internals import connections_of, state_of

PANEL_WIDTH = 350
"""Width of the panel of parameters [pixels]."""

ALONE = "/alone"
"""Path of the pages that work alone."""

Host: TypeAlias = viser.ViserServer | viser.ClientHandle
V = TypeVar("V")


class PerPage(WeakKeyDictionary[viser.ClientHandle, V]):
    """What is known of each page, for as long as it is there."""


def pages(host: Host) -> Mapping[int, viser.ClientHandle]:
    """List the open pages that show what the host shows, by their number."""
    if isinstance(host, viser.ViserServer):
        return {
            number: page
            for number, page in host.get_clients().items()
            if not has_private_session(host, number)
        }
    return {host.client_id: host}


def has_private_session(server: viser.ViserServer, page: int) -> bool:
    """Whether a page receives nothing of what the server shows: it works for itself."""
    # Access control has created the connection; see `guard.Connection`.
    return getattr(connections_of(server).get(page), "is_alone", False)


def on_scene_click(
    host: Host,
    act: Callable[[viser.SceneClickEvent], None],
    modifier: Any = None,
) -> None:
    """Call something when a page of the host clicks into the scene; viser tells of all pages'."""

    @host.scene.on_click(modifier=modifier)
    def _(event: viser.SceneClickEvent) -> None:
        if event.client_id in pages(host):
            act(event)


_running: set[asyncio.Task[None]] = set()


def start_task(work: Coroutine[Any, Any, None]) -> None:
    """Run something in the event loop, which would forget a task that nobody holds."""
    task = asyncio.create_task(work)
    _running.add(task)
    task.add_done_callback(_running.discard)


async def act_on(handle: Any, value: object, page: viser.ClientHandle | None) -> None:
    """Act as a widget does when a user acts on it; None leaves the value of a button as it is."""
    state = state_of(handle)
    if value is not None:
        state.value = value
    number = 1 if page is None else page.client_id
    for act in tuple(state.update_cb):
        await act(viser.GuiEvent(page, number, handle))


def set_theme(host: Host) -> None:
    """Hide what is viser's own; whether it is dark, each page chooses (theme.js)."""
    host.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
