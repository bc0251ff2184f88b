"""The work bar: what runs, how far it is, a button that cancels it, and what came of it."""

import math
import time
from collections.abc import Callable

import viser

from app.viewer.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import BAD, BUSY, message_line

TOLD_AFTER, LEAST_DONE = 2.0, 0.03
"""From so many seconds and such a share of the work on, the time left is told."""


class WorkBar:
    """Hidden while nothing runs, but for the last message."""

    def __init__(
        self,
        host: Host,
        cancel: str,
        test_id: str,
        *,
        starts: tuple[viser.GuiButtonHandle, ...] = (),
        done_color: str = BUSY,
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            cancel: Label of the button that cancels.
            test_id: Names the work for tests; see `message_line`.
            starts: Buttons that start the work; they are hidden while it runs.
            done_color: Of the message once the work is done.
        """
        gui = host.gui
        self._cancel = gui.add_button(cancel, visible=False, color="red")
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._message = gui.add_html("")
        self._test_id = test_id
        self._starts = starts
        self._done_color = done_color
        self._began: tuple[float, float] | None = None  # when [s], and at which fraction

    def on_cancel(self, act: Callable[[], None]) -> None:
        """Call something when a user cancels the work."""
        on_press(self._cancel, act)

    @property
    def said(self) -> str:
        """The message as HTML."""
        return self._message.content

    def running(self, what: str, fraction: float) -> None:
        """Show what runs and how far it is."""
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        self._say(f"{what} … {100 * fraction:.0f} %{self._time_left(fraction)}", BUSY)

    def _time_left(self, fraction: float) -> str:
        """Say how long it still takes, once that can be told."""
        now = time.monotonic()
        if self._began is None or fraction < self._began[1]:
            self._began = now, fraction
        began, first = self._began
        if now - began < TOLD_AFTER or fraction - first < LEAST_DONE:
            return ""
        left = (1.0 - fraction) * (now - began) / (fraction - first)
        return f", {time_in_words(left)} left"

    def idle(self) -> None:
        """Show that nothing runs, without a message."""
        self._set_running(False)
        self._message.content = ""

    def done(self, message: str) -> None:
        """Show that nothing runs any more, and what came of it."""
        self._set_running(False)
        self._say(message, self._done_color)

    def failed(self, message: str) -> None:
        """Show that nothing runs any more, and what went wrong."""
        self._set_running(False)
        self._message.content = message_line(f"{self._test_id}-error", message, BAD)

    def show(self, content: str) -> None:
        """Show that nothing runs any more, and a result as HTML that is safe."""
        self._set_running(False)
        self._message.content = content

    def _say(self, message: str, color: str) -> None:
        self._message.content = message_line(f"{self._test_id}-message", message, color)

    def _set_running(self, running: bool) -> None:
        self._cancel.visible = self._bar.visible = running
        if not running:
            self._began = None
        for button in self._starts:
            button.visible = not running


def time_in_words(seconds: float) -> str:
    """Round a time up to what a person wants to know.

    >>> time_in_words(7.2), time_in_words(61.0), time_in_words(8000.0)
    ('8 s', '2 min', '3 h')
    """
    if seconds > 5400.0:
        return f"{math.ceil(seconds / 3600.0)} h"
    return f"{math.ceil(seconds / 60.0)} min" if seconds > 60.0 else f"{math.ceil(seconds)} s"
