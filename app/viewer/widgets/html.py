"""How panels look: colours, small pieces of HTML, viser's own widgets, and the title of the pages.

What came from a user is escaped here. viser has no setting for the looks of its widgets, but its
pages take a style sheet in HTML; that depends on how viser builds its pages, as the bridge does,
and a browser test watches it.
"""

import json
from collections.abc import Iterable
from html import escape
from typing import Any

import viser

from app.viewer.server.host import Host
from app.viewer.server.internals import state_of
from app.viewer.web import fill_page_file
from app.viewer.widgets.bridge import inline_script, page_script

# The names of the palette (palette.css). Words in these are readable on a light and a dark page.
GOOD, BAD, BUSY = "var(--gg-good)", "var(--gg-bad)", "var(--gg-warn)"
TEXT, QUIET, ACCENT = "var(--gg-text)", "var(--gg-dim)", "var(--gg-accent)"
QUERY_WORDS, DATABASE_WORDS = "var(--gg-query)", "var(--gg-database)"
SURFACE, RAISED, LINE = "var(--gg-surface)", "var(--gg-raised)", "var(--gg-line)"
SMALL, MEDIUM, LARGE = "var(--gg-small)", "var(--gg-medium)", "var(--gg-large)"
# The ground that words stand on.
GOOD_GROUND = "background:var(--gg-good-ground);color:#fff"
BAD_GROUND = "background:var(--gg-bad-ground);color:#fff"
BUSY_GROUND = "background:var(--gg-warn-ground);color:#fff"
AMBER_GROUND = "background:#f5b83d;color:#1f1400"
GREY_GROUND = "background:#5f6368;color:#fff"
FAINT = "opacity:.75"
SOLID = "var(--gg-accent-ground)"
SOLID_HOVER = "color-mix(in srgb,var(--gg-accent-ground) 85%,#000)"


def paragraph(text: str, style: str = "") -> str:
    """Write plain text as a paragraph of a panel."""
    look = f"padding:0 .75em;font-size:13px;line-height:1.45;{style}"
    return f'<div style="{look}">{escape(text)}</div>'


def summary(test_id: str, lines: tuple[str, ...]) -> str:
    """Write plain lines of which the first stands out."""
    head, *rest = lines
    others = "".join(paragraph(line, FAINT) for line in rest)
    return f'<div data-testid="{test_id}">{paragraph(head, "font-weight:600")}{others}</div>'


def button(text: str, act: str, style: str = "") -> str:
    """Write a light button of our own, which runs JavaScript that is escaped as by `bridge.say`."""
    look = (
        "font:inherit;line-height:1.2;min-height:32px;padding:.2em .8em;border-radius:.3em;"
        f"cursor:pointer;border:1px solid {LINE};background:{RAISED};color:{ACCENT};{style}"
    )
    return f'<button type="button" style="{look}" onclick="{act}">{escape(text)}</button>'


def table(rows: tuple[tuple[str, str], ...]) -> str:
    """Write rows of a name and a value."""
    cells = "".join(
        f'<tr><td style="{FAINT};padding:.05em .8em .05em 0;white-space:nowrap">{escape(name)}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<table style="border-collapse:collapse;font-size:13px">{cells}</table>'


def figures(
    test_id: str, rows: tuple[tuple[str, str], ...], lead: str = "", below: str = ""
) -> str:
    """Write a table, and above and below it HTML that is safe."""
    inner = f"{lead}{table(rows)}{below}"
    return f'<div data-testid="{test_id}" style="padding:.1em .75em .3em">{inner}</div>'


def message_line(test_id: str, message: str, color: str) -> str:
    """Write what happens or came of something as a small line; empty for an empty message."""
    return box(test_id, escape(message), f"font-size:12px;color:{color}") if message else ""


def box(test_id: str, content: str, style: str = "") -> str:
    """HTML that is safe between the margins of a panel, announced by screen readers."""
    return (
        f'<div data-testid="{test_id}" role="status" style="padding:.1em .75em;'
        f'overflow-wrap:anywhere;{style}">{content}</div>'
    )


def add_scripts(host: Host) -> None:
    """Add what the widgets of a session's pages lack; their style sheet comes with the page."""
    names = "tooltips", "reach", "connection", "folders"
    host.gui.add_html("".join(page_script(f"{name}.js") for name in names))


def uuid_of(
    handle: viser.GuiInputHandle[Any]
    | viser.GuiButtonHandle
    | viser.GuiButtonGroupHandle
    | viser.GuiUploadButtonHandle,
) -> str:
    """The UUID by which a page refers to a widget."""
    return state_of(handle).uuid


def make_solid(host: Host, button: viser.GuiButtonHandle) -> None:
    """Let a button stand out: it does what its panel is for. All others are light."""
    style = fill_page_file("solid.css", UUID=uuid_of(button), SOLID=SOLID, SOLID_HOVER=SOLID_HOVER)
    host.gui.add_html(f"<style>{style}</style>")


def segment_style(buttons: viser.GuiButtonGroupHandle, chosen: int) -> str:
    """Write the style that turns a group of buttons into one control; one, from 0, is filled."""
    style = fill_page_file("segments.css", UUID=uuid_of(buttons), CHOSEN=chosen + 1, SOLID=SOLID)
    return f"<style>{style}</style>"


def put_in_a_row(host: Host, buttons: tuple[viser.GuiButtonHandle, ...]) -> None:
    """Let buttons with icons stand beside each other, without their labels, which are read out."""
    style = fill_page_file("row.css", UUIDS=",".join(f'[id="{uuid_of(each)}"]' for each in buttons))
    host.gui.add_html(f"<style>{style}</style>")


def show_as_eyes(
    host: Host,
    eyes: Iterable[viser.GuiInputHandle[Any]],
    below: Iterable[viser.GuiInputHandle[Any]],
) -> None:
    """Let checkboxes be rows with an eye before their name; what belongs to one stands below it."""
    style = fill_page_file(
        "eyes.css",
        EYES=",".join(f'[id="{uuid_of(each)}"]' for each in eyes),
        NAMES=",".join(f'[for="{uuid_of(each)}"]' for each in eyes),
        BELOW=",".join(f'[for="{uuid_of(each)}"]' for each in below) or "[for=none]",
    )
    host.gui.add_html(f"<style>{style}</style>")


class PageTitle:
    """Names the pages of a session."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._shown = ""
        self._script = host.gui.add_html("")

    def show(self, pair: str, dataset: str) -> None:
        """Name a pair and its dataset; nothing is sent if they are named already."""
        named = f"{pair} · {dataset}"
        if named == self._shown:
            return
        self._shown = named
        self._host.gui.set_panel_label(dataset)  # the canvas names the pair
        title = json.dumps(f"{named} · gpgrad")
        self._script.content = inline_script(f"document.title={title}")
