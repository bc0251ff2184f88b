"""Workers with a thread of their own, and how much of the machine they may hold.

A `Runner` always ends on the newest job, because sliders outrun the pipeline. A `Throttle` acts for
everybody who asks, but not more often than makes sense.
"""

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Generator, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.run.helper import Helper
from gpgrad_core.run.threads import num_workers

Job = TypeVar("Job")
Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)

_log = logging.getLogger(__name__)

GRACE_S = 0.15
"""A run younger than this is let finish though a newer job waits [s].

Cancelling at every tick of a slider would starve the picture: each run would be given up a
moment before it is done.
"""

MAX_STALE_S = 0.25
"""Superseded runs may leave the picture unchanged for this long; then one is let finish [s].

Patience alone shows nothing during a long drag over work that takes longer than patience.
"""


class Worker(Protocol):
    """Something that works in a thread of its own."""

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        ...

    def close(self) -> None:
        """Stop."""
        ...


class Runner(Generic[Job, Result]):
    """One thread, one slot: the newest job replaces a waiting one and supersedes a running one.

    Jobs are run in the order they were submitted and never two at once, so a result can never
    be overtaken by an older one, and the last job submitted is always the last one shown.

    A job may have previews, rougher results that are made sooner: each is shown at once, and the
    next and the work itself begin only if no newer job waits by then.

    The callbacks are called from the worker's thread. What they or the work raise becomes a
    value for ``on_error``; nothing but `close` ends the worker.
    """

    def __init__(
        self,
        work: Callable[[Job, Progress], Result],
        on_result: Callable[[Job, Result, float], None],
        on_error: Callable[[Job, Exception], None],
        *,
        on_start: Callable[[Job], None] | None = None,
        previews: Sequence[Callable[[Job, Progress], Result | None]] = (),
        on_cancel: Callable[[Job], None] | None = None,
        grace: float = GRACE_S,
        max_stale: float = MAX_STALE_S,
        rest: float = 0.0,
        slots: threading.Semaphore | None = None,
        name: str = "runner",
    ) -> None:
        """Start the worker.

        Args:
            work: Turns a job into a result; should call its progress hook every few
                hundredths of a second, for there it is stopped when it is no longer wanted.
            on_result: Given the job, its result and the seconds it took.
            on_error: Given the job and what was raised.
            on_start: Told of a job that begins.
            previews: Each turns a job into a rougher result for ``on_result``, or None for none.
            on_cancel: Told of a job that `cancel` has stopped, or that waited for its turn.
            grace: See `GRACE_S` [s].
            max_stale: See `MAX_STALE_S` [s].
            rest: Pause before each job [s]: of what may wait until a picture has been drawn.
            slots: One is held while a job runs; None shares the processors with nobody. The job is
                chosen when the turn has come: still the newest.
            name: Of the thread, for debuggers.
        """
        self._work = work
        self._on_result = on_result
        self._on_error = on_error
        self._on_start = on_start
        self._previews = previews
        self._on_cancel = on_cancel
        self._patience = grace
        self._longest_blind = max_stale
        self._rest = rest
        self._slots = slots
        self._changed = threading.Condition()
        self._waiting: list[Job] = []  # none or one
        self._dropped: list[Job] = []  # by `cancel`, before its turn came
        self._running = False
        self._closing = False
        self._cancelling = False
        self._last_shown = time.monotonic()
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self._thread.start()

    def submit(self, job: Job) -> None:
        """Ask for a job; returns at once. A job still waiting is forgotten."""
        with self._changed:
            if self._closing:
                return
            if not self._running and not self._waiting:
                # The picture was up to date until now: blindness begins here.
                self._last_shown = time.monotonic()
            self._waiting = [job]
            self._changed.notify_all()

    def cancel(self) -> None:
        """Stop what runs at its next progress call, and forget what waits; returns at once."""
        with self._changed:
            if not self._running:  # else what runs tells of it
                self._dropped = self._waiting
            self._waiting = []
            self._cancelling = self._running
            self._changed.notify_all()

    @property
    def newer_waits(self) -> bool:
        """Whether what runs now is already superseded."""
        return bool(self._waiting)

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs or waits; says whether that came true within the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._running or self._waiting or self._dropped), timeout
            )

    def close(self) -> None:
        """Stop: cancels what runs at its next progress call, and joins the thread."""
        with self._changed:
            self._closing = True
            self._waiting = []
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _loop(self) -> None:
        while True:
            with self._changed:
                self._running = False
                self._changed.notify_all()
                self._changed.wait_for(
                    lambda: bool(self._waiting or self._dropped) or self._closing
                )
                self._changed.wait_for(lambda: self._closing, self._rest)
            if self._closing:
                return
            with self._turn():
                self._run_next()

    def _run_next(self) -> None:
        """Run a job, if one is left; nothing of it is held when it is done."""
        job = self._take()
        if job is not None:
            try:
                self._run(job)
            except Exception as error:
                self._report(job, error)

    @contextlib.contextmanager
    def _turn(self) -> Generator[None]:
        """Hold a turn, unless there is nothing left to do with it."""
        if self._slots is None:
            yield
            return
        has_turn = False
        while not has_turn and self._waiting and not self._closing:
            has_turn = self._slots.acquire(timeout=0.05)  # then it looks whether it is wanted
        try:
            yield
        finally:
            if has_turn:
                self._slots.release()

    def _take(self) -> Job | None:
        """Take the newest job; tell of one that was cancelled before its turn."""
        with self._changed:
            dropped, self._dropped = self._dropped, []
            if self._closing:
                return None
            self._running, self._cancelling = True, False  # telling of a cancel is work too
            if self._waiting:
                return self._waiting.pop()
        for job in dropped:
            try:
                if self._on_cancel is not None:
                    self._on_cancel(job)
            except Exception as error:
                self._report(job, error)
        return None

    def _run(self, job: Job) -> None:
        if self._on_start is not None:
            self._on_start(job)
        start = time.monotonic()
        hopeless_after = start + self._patience
        must_show = start - self._last_shown > self._longest_blind

        def progress(fraction: float) -> None:  # noqa: ARG001
            if self._closing or self._cancelling:
                raise Cancelled
            if self._waiting and not must_show and time.monotonic() > hopeless_after:
                raise Cancelled

        try:
            for make in self._previews:
                rough = make(job, progress)
                if rough is not None:
                    self._show(job, rough, start)
                    must_show = False
                    if self._waiting:
                        return
            result = self._work(job, progress)
        except Cancelled:
            if self._cancelling and self._on_cancel is not None:
                self._on_cancel(job)
            return
        self._show(job, result, start)

    def _show(self, job: Job, result: Result, start: float) -> None:
        self._on_result(job, result, time.monotonic() - start)
        self._last_shown = time.monotonic()

    def _report(self, job: Job, error: Exception) -> None:
        try:
            self._on_error(job, error)
        except Exception:
            _log.exception("reporting an error failed")
        self._last_shown = time.monotonic()


class Throttle(Generic[Key]):
    """One thread that acts for each key that has asked, and then pauses.

    Whoever asks during the pause is served after it, once, so the last wish is always fulfilled.
    """

    def __init__(self, act: Callable[[Key], None], pause: float, name: str) -> None:
        """Start the thread, which pauses after each round [s]; an error in an act is logged."""
        self._act = act
        self._pause = pause
        self._asked: dict[Key, None] = {}
        self._busy = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def request(self, key: Key) -> None:
        """Have it act for a key soon; returns at once."""
        with self._changed:
            self._asked[key] = None
            self._changed.notify_all()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nobody waits; says whether that came true within the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._asked and not self._busy, timeout)

    def close(self) -> None:
        """Stop; who still waits is not served."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._asked or self._closing)
                if self._closing:
                    return
                asked, self._asked, self._busy = self._asked, {}, True
            for key in asked:
                try:
                    self._act(key)
                except Exception:
                    _log.exception("could not be done")
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                end = time.monotonic() + self._pause
                while not self._closing and (left := end - time.monotonic()) > 0:
                    self._changed.wait(left)


@dataclass(frozen=True, eq=False)
class Capacity:
    """What a worker must hold while it computes.

    Attributes:
        pictures: For the pair that a session shows: as many slots as there are processors.
        long: For work that takes longer than a picture, one at a time. It is apart from the
            pictures, so that sliders answer meanwhile.
        helper: A process that infers one of two submaps; None where there is one processor.
    """

    pictures: threading.Semaphore = field(
        default_factory=lambda: threading.Semaphore(max(1, num_workers()))
    )
    long: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(1))
    helper: Helper | None = None
