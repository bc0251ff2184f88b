"""The host of a session: a server with all its pages, or one page.

viser's server and its handle of one client have the same ``gui`` and ``scene``, so that nothing
else needs to know which of the two it is drawing on.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import viser
from viser._messages import Message

PANEL_WIDTH = 350
"""Width of the panel of parameters [pixels]."""

ALONE = "/alone"
"""Path of the pages that work alone."""

Host: TypeAlias = viser.ViserServer | viser.ClientHandle


def pages(host: Host) -> Mapping[int, viser.ClientHandle]:
    """List the open pages that show what the host shows, by their number."""
    if isinstance(host, viser.ViserServer):
        return {
            number: page
            for number, page in host.get_clients().items()
            if not has_private_session(page)
        }
    return {host.client_id: host}


def has_private_session(page: viser.ClientHandle) -> bool:
    """Say whether a page is told nothing of what the server shows: it works for itself."""
    sockets: Any = page._viser_server._websock_server  # pyright: ignore[reportPrivateUsage]
    # Which access control has made; see `guard.Connection`.
    return getattr(sockets._live_connections.get(page.client_id), "is_alone", False)


def on_scene_click(
    host: Host,
    act: Callable[[viser.SceneClickEvent], None],
    modifier: Any = None,
) -> None:
    """Call something whenever a page that shows what the host shows clicks into the scene.

    viser tells a server of the clicks of all pages.
    """

    @host.scene.on_click(modifier=modifier)
    def _(event: viser.SceneClickEvent) -> None:
        if event.client_id in pages(host):
            act(event)


def inputs_of(host: Host) -> list[Any]:
    """List the widgets that a user can act on; viser's kinds have no common class."""
    return list(host.gui._gui_input_handle_from_uuid.values())  # pyright: ignore[reportPrivateUsage]


def send_to(page: viser.ClientHandle, message: Message) -> None:
    """Send one page a message for which viser has no method."""
    page._websock_connection.queue_message(message)  # pyright: ignore[reportPrivateUsage]


def set_theme(host: Host, *, dark: bool) -> None:
    """Make the pages light or dark, without what is viser's own."""
    host.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
