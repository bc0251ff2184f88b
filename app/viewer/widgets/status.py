"""The status line: whether the picture is up to date, and what went wrong.

Its place is always of one height, so that no slider below it moves under a hand.
"""

import threading
from collections.abc import Callable, Mapping
from html import escape

from app.viewer.server.host import Host
from app.viewer.widgets.bridge import Bridge, say
from app.viewer.widgets.html import BAD, BUSY, GOOD, QUIET, button

WORTH_TELLING = 0.0005
"""Stages that took less are left out [s]: what they gave was known before."""
HEIGHT = 4.1
"""Of the place [lines of text]: three small lines and the bar. What is longer can be scrolled."""
BAR_STEP = 0.01
"""The bar is drawn anew once it has grown by this share of the whole."""


class StatusLine:
    """Computing, up to date, or out of date; an error stays until the next good picture."""

    def __init__(
        self, host: Host, bridge: Bridge, on_cancel: Callable[[], None] = lambda: None
    ) -> None:
        """Make it in the current container.

        Args:
            host: Whose GUI it joins.
            bridge: Hears its button.
            on_cancel: Called when what is being computed is no longer wanted.
        """
        self._lock = threading.Lock()
        self._busy = False
        self._fraction: float | None = None  # as the bar shows it
        self._said = "Starting …", BUSY, "", ""
        self._handle = host.gui.add_html(status_html("Starting …", BUSY))
        # Apart, for a button that is written anew between press and release is not pressed.
        self._cancel = host.gui.add_html("")
        bridge.hear(CANCEL, lambda page, data: on_cancel())  # noqa: ARG005

    def computing(self, what: str = "Computing …") -> None:
        """Say that the picture is about to change."""
        self._begin()
        self._say(what, BUSY)

    def progress(self, fraction: float) -> None:
        """Show how far it is and a button to cancel it, because it takes long.

        Where nothing is being computed any more, nothing is shown.
        """
        fraction = min(max(fraction, 0.0), 1.0)
        with self._lock:
            shown = self._fraction
            if not self._busy or (shown is not None and abs(fraction - shown) < BAR_STEP):
                return
            self._fraction = fraction
            self._handle.content = status_html(*self._said, fraction)
            if shown is None:
                self._cancel.content = CANCEL_BUTTON

    def preview(self, seconds: float, *, coarse: bool) -> None:
        """Say that surfaces are shown, and that the rest is being computed.

        Args:
            seconds: From the beginning of the computation to the picture.
            coarse: Whether finer surfaces are being made too.
        """
        self._begin()
        now = "Coarse picture" if coarse else "Surfaces shown"
        then = "refining" if coarse else "matching"
        self._say(f"{now} · {1000 * seconds:.0f} ms · {then} …", BUSY)

    def up_to_date(
        self, seconds: float, details: str, stages: Mapping[str, float] | None = None
    ) -> None:
        """Say that the picture is what was asked for.

        Args:
            seconds: From the beginning of the computation to the finished picture.
            details: Counts of what is drawn.
            stages: Seconds of these by stage.
        """
        self._rest()
        self._say(
            f"Up to date · {1000 * seconds:.0f} ms · {details}", GOOD, below=stages_text(stages)
        )

    def stale(self, seconds: float) -> None:
        """Say that a picture is shown, and that a newer one is being computed."""
        self._rest()
        self._say(f"Computing … (shown: the picture before, {1000 * seconds:.0f} ms)", BUSY)

    def cancelled(self) -> None:
        """Say that the picture is out of date because the user cancelled it."""
        self._rest()
        self._say(
            "Cancelled: move a slider to compute again.", BAD, title="The picture is out of date"
        )

    def refused(self, message: str) -> None:
        """Say why a value was not taken; the picture is what it was, and so is the rest."""
        self._say(message, BAD, title="Not taken")

    def error(self, message: str) -> None:
        """Say what went wrong; the last good picture stays."""
        self._rest()
        self._say(message, BAD, title="The picture is out of date")

    def _begin(self) -> None:
        with self._lock:
            self._busy = True

    def _rest(self) -> None:
        with self._lock:
            self._busy = False
            self._fraction = None
            if self._cancel.content:
                self._cancel.content = ""

    def _say(self, text: str, color: str, title: str = "", below: str = "") -> None:
        with self._lock:
            self._said = text, color, title, below
            self._handle.content = status_html(*self._said, self._fraction)


def stages_text(stages: Mapping[str, float] | None) -> str:
    """Write the milliseconds of each stage; stages that computed nothing are left out.

    >>> stages_text({"map": 0.12, "matching": 0.0001, "drawing": 0.008})
    'map 120 · drawing 8 ms'
    """
    shown = {stage: s for stage, s in (stages or {}).items() if s >= WORTH_TELLING}
    return " · ".join(f"{stage} {1000 * s:.0f}" for stage, s in shown.items()) + " ms" * bool(shown)


def status_html(
    text: str, color: str, title: str = "", below: str = "", fraction: float | None = None
) -> str:
    """Write the line: a coloured dot and words, for an error a title above, and a fainter line.

    Args:
        text: What is the case.
        color: Of the dot and the title.
        title: Above it.
        below: Below it.
        fraction: How far the work is, as a bar; None draws none.
    """
    head = f'<b style="color:{color}">{escape(title)}</b><br>' if title else ""
    foot = f'<div data-testid="stages" style="color:{QUIET}">{escape(below)}</div>' if below else ""
    bar = (
        ""
        if fraction is None
        else '<div data-testid="progress" style="height:4px;margin:1px .6em 0;border-radius:2px;'
        f'background:light-dark(#dcdcdc,#4a4a4a)"><div style="height:100%;border-radius:2px;'
        f'width:{100 * fraction:.0f}%;background:#1971c2"></div></div>'
    )
    words = (HEIGHT - 0.4) / 0.8  # in their own, smaller lines; the rest is for the bar
    return (
        f'<div style="height:{HEIGHT}em"><div data-testid="status" role="status" '
        f'style="padding:.1em .75em;font-size:.8em;line-height:1.4;max-height:{words:.2f}em;'
        f'box-sizing:border-box;overflow-y:auto;overflow-wrap:anywhere">'
        f'<span style="color:{color}">●</span> {head}{escape(text)}{foot}</div>{bar}</div>'
    )


CANCEL = "cancel-picture"
CANCEL_BUTTON = (
    '<div style="position:relative;height:0"><div style="position:absolute;right:.75em;'
    f'bottom:8px">{button("Cancel computing", say(CANCEL), f"color:{BAD}")}</div></div>'
)
