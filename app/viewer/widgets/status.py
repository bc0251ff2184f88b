"""What runs and what came of it: a line on the picture, and a bar for each longer work.

The line's place is always of one height, so that no slider below it moves under a hand.
"""

import math
import threading
import time
from collections.abc import Callable, Mapping
from html import escape

import numpy as np
import viser

from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_press
from app.viewer.widgets.bridge import Bridge, send
from app.viewer.widgets.html import BAD, BUSY, GOOD, button, message_line

WORTH_TELLING = 0.0005
"""Stages that took less are left out [s]: what they gave was known before."""
HEIGHT = 3.2
"""Of the place [lines of text]: two small lines and the bar. What is longer can be scrolled."""
NOT_TAKEN = "Not taken"
READ_WITHIN = 8.0
"""What was refused is told so long, beside the state of the picture, whatever comes of it [s]."""
BAR_STEP = 0.01
"""The bar is drawn anew once it has grown by this share of the whole."""
WHOLE: dict[str, float] = {"": 1.0}
"""Work of a single phase, which needs no name."""
TOLD_AFTER, LEAST_DONE = 2.0, 0.03
"""From so many seconds and such a share of a phase on, the time left is told."""
LATELY = 6.0
"""The pace is that of so many seconds, or of the second half of the time if that is longer."""
STEADY = 2.0
"""Nothing is told while the pace changes by more than this factor."""


class StatusLine:
    """Computing, up to date, or out of date; an error stays until the next good picture."""

    def __init__(
        self, host: Host, bridge: Bridge, on_cancel: Callable[[], None] = lambda: None
    ) -> None:
        """Make it in the current container; ``on_cancel`` is called when its button is pressed."""
        self._lock = threading.Lock()
        self._busy = False
        self._fraction: float | None = None  # as the bar shows it
        self._said = "Starting …", BUSY, "", ""
        self._refusal, self._refused_at = "", -math.inf
        self._handle = host.gui.add_html(status_html("Starting …", BUSY))
        # Apart, for a button that is written anew between press and release is not pressed.
        self._cancel = host.gui.add_html("")
        bridge.hear(CANCEL, lambda page, data: on_cancel())  # noqa: ARG005

    @property
    def visible(self) -> bool:
        """Whether it is seen."""
        return self._handle.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._handle.visible = self._cancel.visible = visible

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
        """Say after how long [s] surfaces are shown, and that the rest is being computed."""
        self._begin()
        now = "Coarse picture" if coarse else "Surfaces shown"
        then = "refining" if coarse else "matching"
        self._say(f"{now} · {then} …", BUSY, hint=f"{1000 * seconds:.0f} ms")

    def fitting(self, seconds: float) -> None:
        """Say after how long [s] the picture is shown, and that automatic numbers are fitted."""
        self._begin()
        took = f"{1000 * seconds:.0f} ms"
        self._say("Fitting automatic numbers …", BUSY, hint=took)

    def up_to_date(
        self, seconds: float, details: str, stages: Mapping[str, float] | None = None
    ) -> None:
        """Say that the picture is what was asked for.

        How long it and its stages took [s] is shown where the pointer rests on it.
        """
        self._rest()
        took = " · ".join(filter(None, (f"{1000 * seconds:.0f} ms", stages_text(stages))))
        self._say(f"Up to date · {details}", GOOD, hint=took)

    def stale(self, seconds: float) -> None:
        """Say that a picture is shown, and that a newer one is being computed."""
        self._rest()
        took = f"{1000 * seconds:.0f} ms"
        self._say("Computing … (shown: the picture before)", BUSY, hint=took)

    def cancelled(self) -> None:
        """Say that the picture is out of date because the user cancelled it."""
        self._rest()
        self._say(
            "Cancelled: move a slider to compute again.", BAD, title="The picture is out of date"
        )

    def refused(self, message: str) -> None:
        """Say why a value was not taken; the picture is what it was, and so is the rest."""
        with self._lock:
            text, title = self._said[0], self._said[2]
            if title == NOT_TAKEN:
                text = text.removeprefix(self._refusal).removeprefix(" · ")
            self._refusal, self._refused_at = message, time.monotonic()
        self._say(text, BAD)

    def error(self, message: str) -> None:
        """Say what went wrong; the last good picture stays."""
        self._rest()
        self._say(message, BAD, title="The picture is out of date")

    def _begin(self) -> None:
        with self._lock:
            self._busy = True
            if time.monotonic() - self._refused_at > READ_WITHIN:
                self._refusal = ""

    def _rest(self) -> None:
        with self._lock:
            self._busy = False
            self._fraction = None
            if self._cancel.content:
                self._cancel.content = ""

    def _say(self, text: str, color: str, title: str = "", hint: str = "") -> None:
        with self._lock:
            if self._refusal and not title:
                text, color, title = f"{self._refusal} · {text}", BAD, NOT_TAKEN
            self._said = text, color, title, hint
            self._handle.content = status_html(*self._said, self._fraction)


def stages_text(stages: Mapping[str, float] | None) -> str:
    """Write the milliseconds of each stage; stages that computed nothing are left out.

    >>> stages_text({"map": 0.12, "matching": 0.0001, "drawing": 0.008})
    'map 120 · drawing 8 ms'
    """
    shown = {stage: s for stage, s in (stages or {}).items() if s >= WORTH_TELLING}
    return " · ".join(f"{stage} {1000 * s:.0f}" for stage, s in shown.items()) + " ms" * bool(shown)


def status_html(
    text: str, color: str, title: str = "", hint: str = "", fraction: float | None = None
) -> str:
    """Write the line: a coloured dot and words, for an error a title above, and a hint on it.

    How far the work is stands below it as a bar; None draws none.
    """
    head = f'<b style="color:{color}">{escape(title)}</b><br>' if title else ""
    told = f' title="{escape(hint)}"' if hint else ""
    bar = (
        ""
        if fraction is None
        else '<div data-testid="progress" style="height:4px;margin:1px .6em 0;border-radius:2px;'
        f'background:light-dark(#dcdcdc,#4a4a4a)"><div style="height:100%;border-radius:2px;'
        f'width:{100 * fraction:.0f}%;background:#1971c2"></div></div>'
    )
    words = (HEIGHT - 0.4) / 0.8  # in their own, smaller lines; the rest is for the bar
    return (
        f'<div style="height:{HEIGHT}em"><div data-testid="status" role="status"{told} '
        f'style="padding:.1em .75em;font-size:12px;line-height:1.4;max-height:{words:.2f}em;'
        f'box-sizing:border-box;overflow-y:auto;overflow-wrap:anywhere">'
        f'<span style="color:{color}">●</span> {head}{escape(text)}</div>{bar}</div>'
    )


CANCEL = "cancel-picture"
CANCEL_BUTTON = (
    '<div style="position:relative;height:0"><div style="position:absolute;right:.75em;'
    f'bottom:8px">{button("Cancel computing", send(CANCEL), f"color:{BAD}")}</div></div>'
)


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
        self._time_left = TimeLeft()

    def on_cancel(self, act: Callable[[], None]) -> None:
        """Call something when a user cancels the work."""
        on_press(self._cancel, act)

    @property
    def said(self) -> str:
        """The message as HTML."""
        return self._message.content

    def running(self, what: str, fraction: float, phases: Mapping[str, float] = WHOLE) -> None:
        """Show what runs and how far it is.

        Args:
            what: As a person calls it.
            fraction: Of the work that is done.
            phases: The fraction at which each phase ends, by its name, in order. Each has a pace of
                its own, and the time left is told of the present one.
        """
        self._set_running(True)
        self._bar.value = 100 * min(max(fraction, 0.0), 1.0)
        phase, left = self._time_left.at(fraction, time.monotonic(), phases)
        told = ", ".join(
            filter(None, (phase, "" if left is None else f"{time_in_words(left)} left"))
        )
        self._say(f"{what} … {100 * fraction:.0f} %{told and f', {told}'}", BUSY)

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
            self._time_left.forget()
        for start in self._starts:
            start.visible = not running


class TimeLeft:
    """How long a phase of work still takes, by its pace of late, and only while that is steady."""

    def __init__(self) -> None:
        """Begin."""
        self._phase = ""
        self._times: list[float] = []
        self._fractions: list[float] = []

    def forget(self) -> None:
        """Begin anew with what comes next."""
        self._times, self._fractions = [], []

    def at(
        self, fraction: float, now: float, phases: Mapping[str, float] = WHOLE
    ) -> tuple[str, float | None]:
        """Give the phase and the time that is left of it [s]; None if that cannot be told.

        Args:
            fraction: Of the whole work that is done.
            now: The time [s].
            phases: See `WorkBar.running`.
        """
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
