"""The jobs of a session: a few threads that run them, and how much of the machine they may hold.

A `Lane` always ends on its newest job, because sliders outrun the pipeline. A `Throttle` acts for
everybody who asks, but not more often than makes sense. What waits, for its time or for a slot,
holds no thread.
"""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from heapq import heappop, heappush
from itertools import count
from typing import Any, Generic, TypeAlias, TypeVar

from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.run.helper import Helper
from gpgrad_core.run.threads import num_workers

Job = TypeVar("Job")
Result = TypeVar("Result")
Key = TypeVar("Key", bound=Hashable)
Turn: TypeAlias = Callable[[], None]

_log = logging.getLogger(__name__)

MOST_THREADS = 8
"""Of a session."""

GRACE_S = 0.15
"""A run younger than this may finish though a newer job waits [s].

Cancelling at every tick of a slider would starve the picture: each run would be cancelled a
moment before it is done.
"""

MAX_STALE_S = 0.25
"""Superseded runs may leave the picture unchanged for this long; then one is let finish [s].

Grace alone shows nothing during a long drag over work that takes longer than it lasts.
"""


class Jobs:
    """A pool of threads; each starts when it is needed and ends when nothing is left to do."""

    def __init__(self) -> None:
        # guards the pool and all its lanes; notified of what happens to them
        self.changed = threading.Condition()
        self.lanes: list[Lane[Any, Any]] = []  # all that have work done here
        self.closing = False  # whether nothing may begin any more, and what runs is to end
        self._due: list[tuple[float, int, Turn]] = []  # a heap: when each may begin
        self._numbers = count()
        self._threads: set[threading.Thread] = set()
        self._one_waits = False  # of the threads, for the time of the first turn

    @property
    def is_busy(self) -> bool:
        """Whether anything runs or waits that somebody waits for."""
        return any(lane.is_busy for lane in self.lanes if not lane.background)

    def schedule(self, turn: Turn, delay: float = 0.0) -> bool:
        """Schedule a turn after a delay [s]; returns whether it will run."""
        with self.changed:
            if self.closing:
                return False
            heappush(self._due, (time.monotonic() + delay, next(self._numbers), turn))
            self._call_thread()
            return True

    def close(self) -> None:
        """Stop: cancels what runs at its next progress call, and joins the threads."""
        with self.changed:
            self.closing = True
            for lane in self.lanes:
                lane.forget_turn()
            self.changed.notify_all()
            threads = self._threads - {threading.current_thread()}
        for thread in threads:
            thread.join()

    def _call_thread(self) -> None:
        """Wake the thread that waits for what is due, or start another."""
        if self._one_waits:
            self.changed.notify_all()
        elif len(self._threads) < MOST_THREADS:
            thread = threading.Thread(target=self._work, name="job", daemon=True)
            thread.start()
            self._threads.add(thread)

    def _work(self) -> None:
        while (turn := self._take()) is not None:
            turn()

    def _take(self) -> Turn | None:
        """Pop the first turn once it is due; None if another thread waits for it, or for none."""
        with self.changed:
            while self._due:
                delay = self._due[0][0] - time.monotonic()
                if delay <= 0 or self.closing:
                    turn = heappop(self._due)[2]
                    if self._due and not self.closing:
                        self._call_thread()
                    return turn
                if self._one_waits:
                    break
                self._one_waits = True
                self.changed.wait(delay)
                self._one_waits = False
            self._threads.discard(threading.current_thread())
            return None


class Slots:
    """So many jobs may run at once, of all sessions; whoever has waited longest is next."""

    def __init__(self, num_free: float) -> None:
        self._num_free = num_free
        self._waiting: deque[Turn] = deque()
        self._lock = threading.Lock()

    def take(self, on_free: Turn) -> bool:
        """Acquire a slot; if there is none, ``on_free`` is called once, which then has one."""
        with self._lock:
            if self._num_free:
                self._num_free -= 1
                return True
            self._waiting.append(on_free)
            return False

    def forget(self, on_free: Turn) -> None:
        with self._lock:
            self._waiting = deque(one for one in self._waiting if one is not on_free)

    def release(self) -> None:
        with self._lock:
            on_free = self._waiting.popleft() if self._waiting else None
            self._num_free += on_free is None
        if on_free is not None:
            on_free()


@dataclass(eq=False)
class Lane(Generic[Job, Result]):
    """One slot for jobs: the newest replaces a waiting one and supersedes a running one.

    Jobs are run in the order they were submitted and never two at once, so a result can never
    be overtaken by an older one, and the last job submitted is always the last one shown.

    A job may have previews, rougher results that come sooner: each is shown at once, and the
    next and the work itself begin only if no newer job waits by then.

    The callbacks are called from a thread of the pool. What they or the work raise becomes a value
    for ``on_error``; nothing but the end of the pool ends the lane.
    """

    jobs: Jobs  # whose threads do the work
    # Calls its progress hook every few hundredths of a second: there it is stopped when it is no
    # longer needed.
    work: Callable[[Job, Progress], Result]
    on_result: Callable[[Job, Result, float], None]  # with the seconds it took
    on_error: Callable[[Job, Exception], None]
    _: KW_ONLY
    previews: Sequence[Callable[[Job, Progress], Result | None]] = ()
    on_cancel: Callable[[Job], None] | None = None  # of what `cancel` stopped, or did not let begin
    grace: float = GRACE_S
    max_stale: float = MAX_STALE_S
    rest: float = 0.0  # before each job [s]: of what may wait until a picture has been drawn
    pause: float = 0.0  # from the end of a job to the next, at least [s]
    slots: Slots | None = None  # one is held while a job runs, which is chosen when it has come
    background: bool = False  # nobody waits for it, and it gives way to all other lanes

    def __post_init__(self) -> None:
        self._changed = self.jobs.changed
        self._slots = self.slots or Slots(math.inf)
        self._waiting: list[Job] = []  # none or one
        self._dropped: list[Job] = []  # by `cancel`, before its turn came
        self._in_turn = self._running = self._cancelling = self.is_busy = False
        self._turn_number = 0  # of the turn that counts; those before are void
        self._on_slot: Turn = lambda: None  # called with a slot, if it waits for one
        self._last_end, self._last_shown = -math.inf, time.monotonic()
        with self._changed:
            self.jobs.lanes.append(self)

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs or waits; says whether that came true within the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self.is_busy, timeout)

    def submit(self, job: Job) -> None:
        """Ask for a job; returns at once. A job still waiting is forgotten."""
        with self._changed:
            if self.jobs.closing:
                return
            if not self._running and not self._waiting:
                # The picture was up to date until now: staleness begins here.
                self._last_shown = time.monotonic()
            self._waiting = [job]
            if not self.is_busy:
                self._ask_turn()

    def cancel(self) -> None:
        """Stop what runs at its next progress call, and forget what waits; returns at once."""
        with self._changed:
            waiting, self._waiting = self._waiting, []
            if self._running:  # it tells of the cancel
                self._cancelling = True
                return
            if self.on_cancel is not None:
                self._dropped += waiting
            if waiting and not self._in_turn:  # else that turn asks for the next
                self.forget_turn()
                if self._dropped:
                    self._ask_turn()

    @property
    def newer_waits(self) -> bool:
        return bool(self._waiting)

    def forget_turn(self) -> None:
        """Cancel the requested turn that has not begun; `changed` is held."""
        self._turn_number += 1
        self._slots.forget(self._on_slot)
        self.is_busy = False
        self._changed.notify_all()

    def _ask_turn(self) -> None:
        left = self._last_end + self.pause - time.monotonic()
        delay = max(self.rest, left) if self._waiting else 0.0  # a cancel is reported at once
        self.is_busy = self.jobs.schedule(partial(self._turn, self._turn_number), delay)

    def _turn(self, number: int) -> None:
        """Report what was cancelled before its turn, and run the newest job once it has a slot."""
        while True:
            with self._changed:
                if self.jobs.closing or number != self._turn_number:
                    return
                dropped, self._dropped = self._dropped, []
                self._in_turn = bool(dropped)
                if not dropped and not self._waiting:
                    self._leave()
                    return
                if not dropped:
                    self._on_slot = partial(self._go_on, number)
                    if not self._slots.take(self._on_slot):
                        return
                    break
            for job in dropped:
                self._guard(self._tell_cancelled, job)
        self._run_newest(number)

    def _go_on(self, number: int) -> None:
        """Run the newest job with a slot that another has left, whatever thread that is in."""
        if not self.jobs.schedule(partial(self._run_newest, number)):
            self._slots.release()

    def _run_newest(self, number: int) -> None:
        """Run the newest job, if it was not cancelled while it waited; gives its slot back."""
        jobs: list[Job] = []
        with self._changed:
            if number == self._turn_number and not self.jobs.closing:
                jobs, self._waiting = self._waiting, []
                self._in_turn = self._running = True
                self._cancelling = False
        for job in jobs:
            self._guard(self._run, job)
        self._slots.release()
        if jobs:
            with self._changed:
                self._leave()

    def _leave(self) -> None:
        """End a turn; what has come meanwhile has another."""
        self._in_turn = self._running = self.is_busy = False
        self._last_end = time.monotonic()
        if self._waiting or self._dropped:
            self._ask_turn()
        self._changed.notify_all()

    def _guard(self, act: Callable[[Job], None], job: Job) -> None:
        """Make whatever is raised a value for ``on_error``."""
        try:
            act(job)
        except Exception as error:
            try:
                self.on_error(job, error)
            except Exception:
                _log.exception("reporting an error failed")
            self._last_shown = time.monotonic()

    def _tell_cancelled(self, job: Job) -> None:
        if self.on_cancel is not None:
            self.on_cancel(job)

    def _run(self, job: Job) -> None:
        start = time.monotonic()
        hopeless_after = start + self.grace
        must_show = start - self._last_shown > self.max_stale

        def progress(fraction: float) -> None:  # noqa: ARG001
            if self.jobs.closing or self._cancelling:
                raise Cancelled
            if self.background and self.jobs.is_busy:
                self.submit(job)  # it goes on after another rest
                raise Cancelled
            if self._waiting and not must_show and time.monotonic() > hopeless_after:
                raise Cancelled

        try:
            for make in self.previews:
                rough = make(job, progress)
                if rough is not None:
                    self._show(job, rough, start)
                    must_show = False
                    if self._waiting:
                        return
            result = self.work(job, progress)
        except Cancelled:
            if self._cancelling:
                self._tell_cancelled(job)
            return
        self._show(job, result, start)

    def _show(self, job: Job, result: Result, start: float) -> None:
        self.on_result(job, result, time.monotonic() - start)
        self._last_shown = time.monotonic()


def _nothing(*_: object) -> None: ...


class Throttle(Lane[None, None], Generic[Key]):
    """Acts for each requested key, then pauses; what is requested meanwhile comes after that."""

    def __init__(self, jobs: Jobs, act: Callable[[Key], None], pause: float) -> None:
        """Begin at rest; it pauses after each round [s], and an error in an act is logged."""
        super().__init__(jobs, self._serve, _nothing, _nothing, pause=pause)
        self._act = act
        self._requested: dict[Key, None] = {}

    def request(self, key: Key) -> None:
        """Request an act for a key; returns at once."""
        with self._changed:
            self._requested[key] = None
            self.submit(None)

    def _serve(self, _job: None, _progress: Progress) -> None:
        with self._changed:
            asked, self._requested = self._requested, {}
        for key in asked:
            if self.jobs.closing:
                return
            try:
                self._act(key)
            except Exception:
                _log.exception("could not be done")


@dataclass(frozen=True, eq=False)
class Capacity:
    """What a job must hold while it computes.

    Work that takes longer than a picture goes one at a time. It is apart from the pictures, so
    that sliders answer meanwhile.
    """

    pictures: Slots = field(default_factory=lambda: Slots(max(1, num_workers())))  # of the pair
    long: Slots = field(default_factory=lambda: Slots(1))
    background: Slots = field(default_factory=lambda: Slots(1))
    # A process that infers one of two submaps; None where there is one processor.
    helper: Helper | None = None
