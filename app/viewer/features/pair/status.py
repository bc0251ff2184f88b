"""Status of the pair's picture: what is computed, how far it is, and what took how long.

Its line has a place of one height, so that no slider below it moves under a hand.
"""

import math
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from html import escape
from typing import ParamSpec, TypeVar

from app.viewer.features.work import message_of
from app.viewer.server.host import Host
from app.viewer.session.jobs import Jobs, Lane
from app.viewer.widgets.bridge import Bridge, send
from app.viewer.widgets.html import BAD, BUSY, GOOD, button
from gpgrad_core.detection import fit_submap
from gpgrad_core.detection.pipeline import fit_roughly, thin_evenly
from gpgrad_core.detection.stages import STAGES
from gpgrad_core.methods.paper import register_as_printed
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo

P = ParamSpec("P")
R = TypeVar("R")

STAGE_OF: dict[Callable[..., object], str] = {
    **{stage.function: stage.phase for stage in STAGES},
    fit_submap: "fit",
    thin_evenly: "map",
    fit_roughly: "map",
    register_as_printed: "registration",
}
"""The stage that each function belongs to which the pipeline asks its memo for."""


class TimedMemo(Memo):
    """Passes everything on to another memo, and counts the seconds by stage."""

    def __init__(self, memo: Memo) -> None:
        """Begin at zero."""
        super().__init__(0)
        self._memo = memo
        self.seconds: dict[str, float] = {}

    def holds(self, function: Callable[..., object], *arguments: object) -> bool:
        """Whether calling with these arguments would compute nothing."""
        return self._memo.holds(function, *arguments)

    def __call__(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """Return what the other memo returns, and count how long that took."""
        with self._timed(function):
            return self._memo(function, *arguments, **unkeyed)

    def lasting(self, function: Callable[P, R], *arguments: P.args, **unkeyed: P.kwargs) -> R:
        """Return what the other memo keeps for later runs too, and count how long that took."""
        with self._timed(function):
            return self._memo.lasting(function, *arguments, **unkeyed)

    @contextmanager
    def _timed(self, function: Callable[..., object]) -> Generator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self.add(STAGE_OF.get(function, "other"), time.perf_counter() - start)

    def keep(self, result: R, function: Callable[..., R], *arguments: object) -> R:
        """Hand the other memo a result that was computed elsewhere, without counting it."""
        return self._memo.keep(result, function, *arguments)

    def add(self, stage: str, seconds: float) -> None:
        """Count seconds that were spent on a stage [s]."""
        self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds


NOTICED = 0.15
"""A picture that is shown sooner needs no word before it: each word costs the page time [s]."""
LATE = 0.15
"""What no longer fits the picture may stand so long [s]: to write it anew costs the page time."""
LONG = 1.0
"""What takes longer has a bar and can be cancelled [s]."""
WORTH_TELLING = 0.0005
"""Stages that took less are left out [s]: their results were there before."""
HEIGHT = 3.2
"""Of the place [lines of text]: two small lines and the bar. What is longer can be scrolled."""
BESIDE = "116px"
"""Room for the buttons that stand beside it."""
NOT_TAKEN = "Not taken"
READ_WITHIN = 8.0
"""What was refused is shown so long, beside the state of the picture, whatever comes of it [s]."""
BAR_STEP = 0.01
"""The bar is drawn anew once it has grown by this share of the whole."""
OUTDATED = "The picture is out of date"
CANCEL = "cancel-picture"
CANCEL_BUTTON = (
    '<div data-testid="cancel" style="position:relative;height:0"><div style="position:absolute;'
    f'right:.75em;bottom:8px">{button("Cancel computing", send(CANCEL), f"color:{BAD}")}</div>'
    "</div>"
)


class PictureStatus:
    """Watches one computation after the other: computing, up to date, or out of date.

    An error stays until the next good picture.
    """

    def __init__(
        self,
        host: Host,
        bridge: Bridge,
        jobs: Jobs,
        memo: Memo,
        on_cancel: Callable[[], None],
        on_late: Callable[[], None],
    ) -> None:
        """Make the line in the current container.

        ``on_late`` is called once of a computation, and once more after each preview, if the last
        finished picture has not been true for some time.
        """
        self._on_late, self._late_due = on_late, False
        self._lock = threading.Lock()
        self._shared_memo, self._memo = memo, TimedMemo(memo)
        self._began = time.monotonic()
        self._fraction = 0.0
        self._drawn: float | None = None  # as the bar shows it
        self._busy = self._word_due = False
        self._outdated_at: float | None = None  # since when the last finished picture is none
        self._patience: Lane[None, None] = Lane(
            jobs,
            lambda _nothing, _progress: self._be_patient(),
            lambda _nothing, _result, _seconds: None,
            lambda _, error: self.failed(message_of(error)),
            rest=LONG,
        )
        self._message = "Starting …", BUSY, "", ""
        self._refusal, self._refused_at = "", -math.inf
        self._handle = host.gui.add_html(status_html(*self._message))
        # Apart, for a button that is written anew between press and release is not pressed.
        self._cancel = host.gui.add_html("")
        bridge.hear(CANCEL, lambda page, data: on_cancel())  # noqa: ARG005

    @property
    def visible(self) -> bool:
        return self._handle.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._handle.visible = self._cancel.visible = visible

    @property
    def memo(self) -> Memo:
        """The memo to compute with, which counts what takes how long."""
        return self._memo

    def begin(self) -> None:
        """Watch a new computation."""
        self._began = time.monotonic()
        self._late_due = True
        if self._outdated_at is None:
            self._outdated_at = self._began
        self._fraction = 0.0
        self._memo = TimedMemo(self._shared_memo)
        self._word_due = True
        self._patience.cancel()
        self._patience.submit(None)

    def reported(self, progress: Progress) -> Progress:
        """Show what goes on, and how far it is, as soon as there is time to read it."""

        def report(fraction: float) -> None:
            progress(fraction)
            self._fraction = fraction
            taken = time.monotonic() - self._began
            self._tell_if_late()
            if taken > NOTICED:
                self._say_computing()
            if taken > LONG:
                self._draw_bar()

        return report

    @contextmanager
    def drawing(self) -> Generator[None]:
        """Count the time within as drawing."""
        start = time.perf_counter()
        yield
        self._memo.add("drawing", time.perf_counter() - start)

    def preview(self, seconds: float, *, coarse: bool) -> None:
        """Show after how long [s] surfaces are shown, and that the rest is being computed."""
        self._word_due = False
        self._late_due = True
        self._tell_if_late()
        now = "Coarse picture" if coarse else "Surfaces shown"
        then = "refining" if coarse else "matching"
        self._say_busy(f"{now} · {then} …", _took(seconds))

    def fitting(self, seconds: float) -> None:
        """Show after how long [s] the picture is shown, and that automatic numbers are fitted."""
        self._stop()
        self._say_busy("Fitting automatic numbers …", _took(seconds))

    def finished(self, seconds: float, details: str, *, newer_waits: bool) -> None:
        """Report that the picture is shown, with counts of what is drawn; a newer one may wait.

        How long it and its stages took [s] is shown where the pointer rests on it.
        """
        if newer_waits:
            self._end("Computing … (shown: the picture before)", BUSY, hint=_took(seconds))
            return
        took = " · ".join(filter(None, (_took(seconds), stages_text(self._memo.seconds))))
        self._end(f"Up to date · {details}", GOOD, hint=took)

    def cancelled(self) -> None:
        self._end("Cancelled: move a slider to compute again.", BAD, OUTDATED)

    def failed(self, message: str) -> None:
        """Show what went wrong; the last good picture stays."""
        self._end(message, BAD, OUTDATED)

    def refused(self, message: str) -> None:
        """Show why a value was refused; the picture is what it was, and so is the rest."""
        with self._lock:
            text, title = self._message[0], self._message[2]
            if title == NOT_TAKEN:
                text = text.removeprefix(self._refusal).removeprefix(" · ")
            self._refusal, self._refused_at = message, time.monotonic()
        self._say(text, BAD)

    def _stop(self) -> None:
        self._outdated_at, self._word_due = None, False
        self._patience.cancel()

    def _say_computing(self) -> None:
        if self._word_due:
            self._word_due = False
            self._say_busy("Computing …")

    def _say_busy(self, text: str, hint: str = "") -> None:
        with self._lock:
            self._busy = True
            if time.monotonic() - self._refused_at > READ_WITHIN:
                self._refusal = ""
        self._say(text, BUSY, hint=hint)

    def _end(self, text: str, color: str, title: str = "", hint: str = "") -> None:
        self._stop()
        with self._lock:
            self._busy, self._drawn = False, None
            self._cancel.content = ""
        self._say(text, color, title, hint)

    def _say(self, text: str, color: str, title: str = "", hint: str = "") -> None:
        with self._lock:
            if self._refusal and not title:
                text, color, title = f"{self._refusal} · {text}", BAD, NOT_TAKEN
            self._message = text, color, title, hint
            self._handle.content = status_html(*self._message, self._drawn)

    def _draw_bar(self) -> None:
        """Show how far it is and a button to cancel it, because it takes long.

        Where nothing is being computed any more, nothing is shown.
        """
        fraction = min(max(self._fraction, 0.0), 1.0)
        with self._lock:
            drawn = self._drawn
            if not self._busy or (drawn is not None and abs(fraction - drawn) < BAR_STEP):
                return
            self._drawn = fraction
            self._handle.content = status_html(*self._message, fraction)
            self._cancel.content = CANCEL_BUTTON

    def _tell_if_late(self) -> None:
        # The last finished picture may be older than this computation: in a drag, one supersedes
        # the other.
        since = self._outdated_at
        if self._late_due and since is not None and time.monotonic() - since > LATE:
            self._late_due = False
            self._on_late()

    def _be_patient(self) -> None:
        """Show how to cancel it, even if it reports nothing for a while."""
        self._tell_if_late()
        self._say_computing()
        self._draw_bar()


def _took(seconds: float) -> str:
    return f"{1000 * seconds:.0f} ms"


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
        f'background:var(--gg-line)"><div style="height:100%;border-radius:2px;'
        f'width:{100 * fraction:.0f}%;background:var(--gg-accent)"></div></div>'
    )
    words = (HEIGHT - 0.4) / 0.8  # in their own, smaller lines; the rest is for the bar
    return (
        f'<div style="height:{HEIGHT}em"><div data-testid="status" role="status"{told} '
        f'style="padding:.1em {BESIDE} .1em .75em;font-size:12px;line-height:1.4;'
        f"max-height:{words:.2f}em;"
        f'box-sizing:border-box;overflow-y:auto;overflow-wrap:anywhere">'
        f'<span style="color:{color}">●</span> {head}{escape(text)}</div>{bar}</div>'
    )
