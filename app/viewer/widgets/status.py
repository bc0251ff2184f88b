"""The status line: whether the picture is up to date, and what went wrong."""

import threading
from collections.abc import Callable, Mapping
from html import escape

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import BAD, BUSY, GOOD

WORTH_TELLING = 0.0005
"""Stages that took less are left out [s]: what they gave was known before."""


class StatusLine:
    """Computing, up to date, or out of date; an error stays until the next good picture."""

    def __init__(self, host: Host, on_cancel: Callable[[], None] = lambda: None) -> None:
        """Make it in the current container.

        Args:
            host: Whose GUI it joins.
            on_cancel: Called when what is being computed is no longer wanted.
        """
        self._lock = threading.Lock()
        self._busy = False
        self._handle = host.gui.add_html(status_html("Starting …", BUSY))
        self._bar = host.gui.add_progress_bar(0.0, visible=False, animated=True)
        self._cancel = host.gui.add_button("Cancel computing", visible=False, color="red")

        on_press(self._cancel, on_cancel)

    def computing(self, what: str = "Computing …") -> None:
        """Say that the picture is about to change."""
        with self._lock:
            self._busy = True
        self._handle.content = status_html(what, BUSY)

    def progress(self, fraction: float) -> None:
        """Show how far it is and a button to cancel it, because it takes long.

        Where nothing is being computed any more, nothing is shown.
        """
        with self._lock:
            if self._busy:
                self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
                self._bar.visible = self._cancel.visible = True

    def preview(self, seconds: float, *, coarse: bool) -> None:
        """Say that surfaces are shown, and that the rest is being computed.

        Args:
            seconds: From the beginning of the computation to the picture.
            coarse: Whether finer surfaces are being made too.
        """
        with self._lock:
            self._busy = True
        now = "Coarse picture" if coarse else "Surfaces shown"
        then = "refining" if coarse else "matching"
        self._handle.content = status_html(f"{now} · {1000 * seconds:.0f} ms · {then} …", BUSY)

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
        self._handle.content = status_html(
            f"Up to date · {1000 * seconds:.0f} ms · {details}", GOOD, below=stages_text(stages)
        )

    def stale(self, seconds: float) -> None:
        """Say that a picture is shown, and that a newer one is being computed."""
        self._rest()
        self._handle.content = status_html(
            f"Computing … (shown: the picture before, {1000 * seconds:.0f} ms)", BUSY
        )

    def cancelled(self) -> None:
        """Say that the picture is out of date because the user cancelled it."""
        self._rest()
        self._handle.content = status_html(
            "Cancelled: move a slider to compute again.", BAD, title="The picture is out of date"
        )

    def refused(self, message: str) -> None:
        """Say why a value was not taken; the picture is what it was, and so is the rest."""
        self._handle.content = status_html(message, BAD, title="Not taken")

    def error(self, message: str) -> None:
        """Say what went wrong; the last good picture stays."""
        self._rest()
        self._handle.content = status_html(message, BAD, title="The picture is out of date")

    def _rest(self) -> None:
        with self._lock:
            self._busy = False
            self._bar.visible = self._cancel.visible = False


def stages_text(stages: Mapping[str, float] | None) -> str:
    """Write the milliseconds of each stage; stages that computed nothing are left out.

    >>> stages_text({"map": 0.12, "matching": 0.0001, "drawing": 0.008})
    'map 120 · drawing 8 ms'
    """
    shown = {stage: s for stage, s in (stages or {}).items() if s >= WORTH_TELLING}
    return " · ".join(f"{stage} {1000 * s:.0f}" for stage, s in shown.items()) + " ms" * bool(shown)


def status_html(text: str, color: str, title: str = "", below: str = "") -> str:
    """Write the line: a coloured dot and words, for an error a title above, and a fainter line."""
    head = f'<b style="color:{color}">{escape(title)}</b><br>' if title else ""
    foot = f'<div data-testid="stages" style="opacity:.7">{escape(below)}</div>' if below else ""
    return (
        f'<div data-testid="status" role="status" style="padding:.1em .75em;font-size:.8em;'
        f'line-height:1.4;overflow-wrap:anywhere"><span style="color:{color}">●</span> '
        f"{head}{escape(text)}{foot}</div>"
    )
