"""Status of the pair's picture: what is computed, how far it is, and what took how long."""

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

from app.viewer.features.work import message_of
from app.viewer.server.host import Host
from app.viewer.session.jobs import Jobs, Lane
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.status import StatusLine
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
        """Say whether calling with these arguments would compute nothing."""
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


class PictureStatus:
    """Watches one computation after the other, and writes the status line."""

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
        self.line = StatusLine(host, bridge, on_cancel)
        self._shared_memo = memo
        self._memo = TimedMemo(memo)
        self._began = time.monotonic()
        self._fraction = 0.0
        self._word_due = False
        self._outdated_at: float | None = None  # since when the last finished picture is none
        self._patience: Lane[None, None] = Lane(
            jobs,
            lambda _nothing, _progress: self._be_patient(),
            lambda _nothing, _result, _seconds: None,
            lambda _, error: self.failed(message_of(error)),
            rest=LONG,
        )

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
                self.line.progress(fraction)

        return report

    @contextmanager
    def drawing(self) -> Generator[None]:
        """Count the time within as drawing."""
        start = time.perf_counter()
        yield
        self._memo.add("drawing", time.perf_counter() - start)

    def preview(self, seconds: float, *, coarse: bool) -> None:
        """Say that surfaces are shown, and that the rest is being made."""
        self._word_due = False
        self._late_due = True
        self._tell_if_late()
        self.line.preview(seconds, coarse=coarse)

    def fitting(self, seconds: float) -> None:
        """Say that the picture is shown, and that numbers which are automatic are being fitted."""
        self._end()
        self.line.fitting(seconds)

    def finished(self, seconds: float, details: str, *, newer_waits: bool) -> None:
        """Say that the picture is shown, with counts of what is drawn; a newer one may wait."""
        self._end()
        if newer_waits:
            self.line.stale(seconds)
        else:
            self.line.up_to_date(seconds, details, self._memo.seconds)

    def cancelled(self) -> None:
        """Say that a user has cancelled the computation."""
        self._end()
        self.line.cancelled()

    def failed(self, message: str) -> None:
        """Say what went wrong."""
        self._end()
        self.line.error(message)

    def _end(self) -> None:
        self._outdated_at, self._word_due = None, False
        self._patience.cancel()

    def _say_computing(self) -> None:
        if self._word_due:
            self._word_due = False
            self.line.computing()

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
        self.line.progress(self._fraction)
