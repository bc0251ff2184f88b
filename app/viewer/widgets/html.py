"""Small pieces of HTML; everything that came from a user is escaped here."""

from html import escape

# Of words, which must be readable on a light and on a dark page.
GOOD = "light-dark(#1a7f37, #5bd37c)"
BAD = "light-dark(#c23b36, #ff8a80)"
BUSY = "light-dark(#9a5b00, #f0b24a)"
# Of the ground that white words stand on.
GOOD_GROUND = "#177d34"
BAD_GROUND = "#c23b36"
BUSY_GROUND = "#8a5200"
FAINT = "opacity:.75"
# Of the words query and database: the colours of their outlines, made readable.
QUERY_WORDS = "light-dark(#1663a8, #7cb8f0)"
DATABASE_WORDS = "light-dark(#a04f00, #f2a65a)"
QUIET = "light-dark(#555, #bbb)"


def paragraph(text: str, style: str = "") -> str:
    """Write plain text as a paragraph of a panel."""
    look = f"padding:0 .75em;font-size:.85em;line-height:1.45;{style}"
    return f'<div style="{look}">{escape(text)}</div>'


def badge(text: str, ground: str, test_id: str) -> str:
    """Write a short headline in white on a coloured ground."""
    return (
        f'<div data-testid="{test_id}" style="background:{ground};color:#fff;border-radius:.4em;'
        f'padding:.35em .7em;font-weight:600;font-size:1em">{escape(text)}</div>'
    )


def button(text: str, act: str, style: str = "") -> str:
    """Write a light button of our own.

    Args:
        text: Its label.
        act: What it does: JavaScript, escaped as by `bridge.say`.
        style: More of its looks.
    """
    look = (
        "font:inherit;line-height:1.2;min-height:32px;padding:.2em .8em;border-radius:.3em;"
        "cursor:pointer;border:1px solid light-dark(#6f9fce,#5f86ad);"
        f"background:light-dark(#fff,#2b2b2b);color:light-dark(#1659a0,#8cc3f7);{style}"
    )
    return f'<button type="button" style="{look}" onclick="{act}">{escape(text)}</button>'


def table(rows: tuple[tuple[str, str], ...]) -> str:
    """Write rows of a name and a value."""
    cells = "".join(
        f'<tr><td style="{FAINT};padding:.05em .8em .05em 0;white-space:nowrap">{escape(name)}</td>'
        f'<td style="font-variant-numeric:tabular-nums">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f'<table style="border-collapse:collapse;font-size:.85em">{cells}</table>'


def message_line(test_id: str, message: str, color: str) -> str:
    """Write what happens or came of something as a small line; empty for an empty message."""
    return box(test_id, escape(message), f"font-size:.8em;color:{color}") if message else ""


def box(test_id: str, content: str, style: str = "") -> str:
    """Put HTML that is safe between the margins of a panel, where screen readers hear of it."""
    return (
        f'<div data-testid="{test_id}" role="status" style="padding:.1em .75em;'
        f'overflow-wrap:anywhere;{style}">{content}</div>'
    )
