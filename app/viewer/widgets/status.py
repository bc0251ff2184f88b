"""A bar for each longer work: what runs, how far it is, and what came of it."""

import math
import time
from collections.abc import Callable, Mapping

import numpy as np
import viser

from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.html import BAD, BUSY, message_line

WHOLE: dict[str, float] = {"": 1.0}
"""Work of a single phase, which needs no name."""
TOLD_AFTER, LEAST_DONE = 2.0, 0.03
"""From so many seconds and such a share of a phase on, the time left is shown."""
LATELY = 6.0
"""The pace is that of so many seconds, or of the second half of the time if that is longer."""
STEADY = 2.0
"""No time is shown while the pace changes by more than this factor."""


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

        ``cancel`` is the label of the button that cancels; buttons that start the work are hidden
        while it runs. The id names the work for tests.
        """
        gui = host.gui
        self._cancel = gui.add_button(cancel, visible=False)
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._message = gui.add_html("")
        self._test_id = test_id
        self._starts = starts
        self._done_color = done_color
        self._time_left = TimeLeft()

    def on_cancel(self, act: Callable[[], None]) -> None:
        on_press(self._cancel, act)

    @property
    def said(self) -> str:
        return self._message.content

    def running(self, what: str, fraction: float, phases: Mapping[str, float] = WHOLE) -> None:
        """Show what runs and how far it is.

        The phases are the fractions at which each ends, by its name, in order. Each has a pace of
        its own, and the time left is that of the present one.
        """
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        phase, left = self._time_left.at(fraction, time.monotonic(), phases)
        told = ", ".join(
            filter(None, (phase, "" if left is None else f"{time_in_words(left)} left"))
        )
        line = f"{what} … {100 * fraction:.0f} %{told and f', {told}'}"
        self._message.content = self._line(line, BUSY)

    def show(self, content: str) -> None:
        """Show that nothing runs any more, and a result as HTML that is safe."""
        self._set_running(False)
        self._message.content = content

    def idle(self) -> None:
        self.show("")

    def done(self, message: str) -> None:
        self.show(self._line(message, self._done_color))

    def failed(self, message: str) -> None:
        self.show(message_line(f"{self._test_id}-error", message, BAD))

    def _line(self, message: str, color: str) -> str:
        return message_line(f"{self._test_id}-message", message, color)

    def _set_running(self, running: bool) -> None:
        self._cancel.visible = self._bar.visible = running
        if not running:
            self._time_left.forget()
        for start in self._starts:
            start.visible = not running


class TimeLeft:
    """How long a phase of work still takes, by its pace of late, and only while that is steady."""

    def __init__(self) -> None:
        self._phase = ""
        self._times: list[float] = []
        self._fractions: list[float] = []

    def forget(self) -> None:
        self._times, self._fractions = [], []

    def at(
        self, fraction: float, now: float, phases: Mapping[str, float] = WHOLE
    ) -> tuple[str, float | None]:
        """The phase and the time that is left of it [s]; None if that is too uncertain."""
        phase, end = next(
            (item for item in phases.items() if fraction < item[1]), list(phases.items())[-1]
        )
        if phase != self._phase or (self._fractions and fraction < self._fractions[-1]):
            self.forget()
        self._phase = phase
        self._times.append(now)
        self._fractions.append(fraction)
        began = self._times[0]
        least = LEAST_DONE * (end - self._fractions[0])
        if now - began < TOLD_AFTER or fraction - self._fractions[0] < least:
            return phase, None
        start = max(began, now - max(LATELY, (now - began) / 2))
        at_start, at_middle = np.interp((start, (start + now) / 2), self._times, self._fractions)
        first, second = at_middle - at_start, fraction - at_middle
        if second <= 0 or not 1 / STEADY <= first / second <= STEADY:
            return phase, None
        return phase, (end - fraction) * (now - start) / float(fraction - at_start)


def time_in_words(seconds: float) -> str:
    """Round a time up to what a person wants to know.

    >>> time_in_words(7.2), time_in_words(61.0), time_in_words(8000.0)
    ('8 s', '2 min', '3 h')
    """
    if seconds > 5400.0:
        return f"{math.ceil(seconds / 3600.0)} h"
    return f"{math.ceil(seconds / 60.0)} min" if seconds > 60.0 else f"{math.ceil(seconds)} s"
