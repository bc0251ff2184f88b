"""One line that says whether the picture is what the sliders say, and a place for errors."""

from html import escape

from app.host import Host
from app.panels.text import BAD, BUSY, GOOD


class StatusLine:
    """Computing, up to date, or out of date; an error stays until the next good picture."""

    def __init__(self, host: Host) -> None:
        """Make it in the current container."""
        self._handle = host.gui.add_html(status_html("Starting …", BUSY))
        self._error: str | None = None

    def computing(self, what: str = "Computing …") -> None:
        """Say that the picture is about to change."""
        self._handle.content = status_html(what, BUSY)

    def preview(self, seconds: float, *, coarse: bool) -> None:
        """Say that surfaces came, and that what is found on them is being made.

        Args:
            seconds: From the beginning of the computation to the picture.
            coarse: Whether finer surfaces are being made too.
        """
        now = "Coarse picture" if coarse else "Surfaces shown"
        then = "refining" if coarse else "matching"
        self._handle.content = status_html(f"{now} · {1000 * seconds:.0f} ms · {then} …", BUSY)

    def up_to_date(self, seconds: float, details: str) -> None:
        """Say that the picture is what was asked for.

        Args:
            seconds: From the beginning of the computation to the finished picture.
            details: Counts of what is drawn.
        """
        self._handle.content = status_html(
            f"Up to date · {1000 * seconds:.0f} ms · {details}", GOOD
        )

    def stale(self, seconds: float) -> None:
        """Say that a picture came, and that a newer one is being made."""
        self._handle.content = status_html(
            f"Computing … (shown: a moment ago, {1000 * seconds:.0f} ms)", BUSY
        )

    def error(self, message: str) -> None:
        """Say what went wrong; the last good picture stays."""
        self._handle.content = status_html(message, BAD, title="The picture is out of date")


def status_html(text: str, color: str, title: str = "") -> str:
    """Write the line: a coloured dot and words, and for an error a title above."""
    head = f'<b style="color:{color}">{escape(title)}</b><br>' if title else ""
    return (
        f'<div data-testid="status" role="status" style="padding:.1em .75em;font-size:.8em;'
        f'line-height:1.4;overflow-wrap:anywhere"><span style="color:{color}">●</span> '
        f"{head}{escape(text)}</div>"
    )
