"""The looks of viser's own widgets, and the title of its pages.

viser has no setting for any of these, but its pages take a style sheet in HTML. What is written
here depends on how viser builds its pages, as the bridge does, and a browser test watches it.
"""

import json
from typing import Any

import viser

from app.viewer.server.host import Host
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import run_when_shown

SOLID, SOLID_HOVER = "#1971c2", "#155fa3"
"""White words on them are readable, which they are not on viser's own blue."""


class Look:
    """The style sheet of a session's pages, and what their widgets lack."""

    def __init__(self, host: Host) -> None:
        """Put it into the current container, unseen."""
        host.gui.add_html(
            f"<style>{fill_page_file('look.css')}</style>"
            + "".join(
                run_when_shown(fill_page_file(f"{name}.js"))
                for name in ("tooltips", "reach", "connection")
            )
        )


def uuid_of(
    handle: viser.GuiInputHandle[Any]
    | viser.GuiButtonHandle
    | viser.GuiButtonGroupHandle
    | viser.GuiUploadButtonHandle,
) -> str:
    """Give the name by which a page knows a widget."""
    return handle._impl.uuid  # pyright: ignore[reportPrivateUsage]


def make_solid(host: Host, button: viser.GuiButtonHandle) -> None:
    """Let a button stand out: it does what its panel is for. All others are light."""
    style = fill_page_file("solid.css", UUID=uuid_of(button), SOLID=SOLID, SOLID_HOVER=SOLID_HOVER)
    host.gui.add_html(f"<style>{style}</style>")


def segment_style(buttons: viser.GuiButtonGroupHandle, chosen: int) -> str:
    """Write the style that turns a group of buttons into one control, without its label.

    Args:
        buttons: The group.
        chosen: Which of them is filled, from 0.
    """
    style = fill_page_file("segments.css", UUID=uuid_of(buttons), CHOSEN=chosen + 1, SOLID=SOLID)
    return f"<style>{style}</style>"


class PageTitle:
    """Names the pages of a session."""

    def __init__(self, host: Host) -> None:
        """Put the script into the current container, unseen."""
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
        self._script.content = title_html(f"{named} · gpgrad")


def title_html(title: str) -> str:
    """Write a script that names the page into which it is put.

    >>> title_html("a")
    '<img alt="" src="data:," style="display:none" onerror="document.title=&quot;a&quot;">'
    """
    return run_when_shown(f"document.title={json.dumps(title)}")
