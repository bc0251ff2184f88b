"""The host of a session: a server with all its pages, or one page.

viser's server and its handle of one client have the same ``gui`` and ``scene``, so that nothing
else needs to know which of the two it is drawing on.
"""

from collections.abc import Mapping
from typing import TypeAlias

import viser

PANEL_WIDTH = 310
"""Width of the panel of parameters [pixels]."""

Host: TypeAlias = viser.ViserServer | viser.ClientHandle


def pages(host: Host) -> Mapping[int, viser.ClientHandle]:
    """List the open pages that show what the host shows, by their number."""
    if isinstance(host, viser.ViserServer):
        return host.get_clients()
    return {host.client_id: host}


def set_theme(host: Host, *, dark: bool) -> None:
    """Make the pages light or dark, without what is viser's own.

    Args:
        host: Whose pages.
        dark: Light words on a dark page.
    """
    host.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark)
