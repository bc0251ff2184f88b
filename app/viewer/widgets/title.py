"""The title: which pair of which dataset a page shows, in the browser's tab and on the panel."""

import json

from app.viewer.host import Host
from app.viewer.widgets.bridge import run_when_shown

PROGRAM = "gpgrad"


class PageTitle:
    """Names the pages of a session."""

    def __init__(self, host: Host) -> None:
        """Put the script into the current container, unseen.

        Args:
            host: Whose pages are named.
        """
        self._host = host
        self._shown = ""
        self._script = host.gui.add_html("")

    def show(self, pair: str, dataset: str) -> None:
        """Name a pair and its dataset; nothing is sent if they are named already."""
        named = f"{pair} · {dataset}"
        if named == self._shown:
            return
        self._shown = named
        self._host.gui.set_panel_label(named)
        self._script.content = title_html(f"{named} · {PROGRAM}")


def title_html(title: str) -> str:
    """Write a script that names the page into which it is put.

    >>> title_html("a")
    '<img alt="" src="data:," style="display:none" onerror="document.title=&quot;a&quot;">'
    """
    return run_when_shown(f"document.title={json.dumps(title)}")
