"""Follows a source: stores what comes, puts it in order, has it compared, and sends the track."""

import heapq
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from math import inf
from pathlib import Path
from typing import TypeAlias

from gpgrad_core.errors import InputError, readable, writable
from gpgrad_core.io.folder import index_of
from gpgrad_core.io.poses import pose_row
from gpgrad_core.io.records.files import check_output, replacing
from gpgrad_core.live.frames import Corrected, Kept, Refused
from gpgrad_core.live.keeping import Keeper
from gpgrad_core.live.source import Arrival, Source, Trouble
from gpgrad_core.reading.files import read_regular
from gpgrad_core.reading.text import write_lines
from gpgrad_core.run import Cancelled, Progress
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Submap

CompareSubmap: TypeAlias = Callable[[Submap, Progress], Corrected]
"""Compares a submap with the earlier ones, and gives the corrected poses of all so far. An
`InputError` leaves the submap out; its progress may raise `Cancelled`."""
Settle: TypeAlias = Callable[[Progress], Corrected | None]
"""Corrects the poses once more, with more time; None if nothing is left to correct. Its progress
may raise `Cancelled`."""
Say: TypeAlias = Callable[[str], None]
"""Shows a line to whoever watches."""
WINDOW = 2
"""How many later submaps may come before one that is waited for."""
PATIENCE = 5.0
"""How long it is waited for [s]."""
NUMBERED = 1000
"""Steps between numbers from here on are those of times, not of a count."""
REST = 3.0
"""If nothing has come for so long [s], there is time to settle."""
LONGEST_READ = 1.0
"""Time [s] after which a source that does not stop is left to itself: a pipe may be silent for
ever."""
MOST_INDEX = 10**15 - 1
"""Of a row of a track: those who read it as a float read all digits."""
TRACK_HEAD = "# index tx ty tz qx qy qz qw   (corrected: p_world = R p_submap + t)"
"""First row of the file of the corrected track, by which it is known again."""


def check_track(path: Path) -> None:
    """Check that a track can be written to a file: it is new, or a track already."""
    check_output(path)
    with readable(path):
        if path.exists() and not read_regular(path).startswith(TRACK_HEAD.encode()):
            raise InputError(f"{path}: is no track that gpgrad wrote; name another file")


@dataclass(frozen=True)
class Ready:
    """A submap whose turn has come."""

    id: str
    note: str = ""  # what is odd about it, in a line; empty if nothing is


class Order:
    """Gives submaps in the order of the numbers in their ids.

    A gap is waited for as long as later submaps are few and young. Then its submaps are missing,
    and odometry bridges them. If one comes after all, it is taken as the next.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[int, float, str]] = []
        self._last: tuple[int, str] | None = None
        self._highest = 0
        self._free: deque[Ready] = deque()
        self.num_missing = self.num_late = self.num_reordered = 0

    def push(self, name: str, now: float) -> None:
        number = index_of(name)
        if number is None:
            self._free.append(Ready(name))
        elif self._last is not None and number < self._last[0]:
            self.num_late += 1
            self.num_missing -= self.num_missing > 0
            note = f"submap {name} came after {self._last[1]}: it is taken out of its order"
            self._free.append(Ready(name, note))
        else:
            self.num_reordered += number < self._highest
            self._highest = max(number, self._highest)
            heapq.heappush(self._waiting, (number, now, name))

    def passed(self, name: str) -> None:
        """Count on from a submap that had its turn in an earlier run."""
        number = index_of(name)
        if number is not None and (self._last is None or number > self._last[0]):
            self._last = number, name

    @property
    def waiting(self) -> int:
        return len(self._waiting) + len(self._free)

    def next(self, now: float, *, at_end: bool = False) -> Ready | None:
        """The next one in order, if it has come; at the end, gaps stay gaps."""
        if self._free:
            return self._free.popleft()
        if not self._waiting:
            return None
        number, _, name = self._waiting[0]
        gap = 0 if self._last is None else number - self._last[0] - 1
        oldest = min(came for _, came, _ in self._waiting)
        patient = len(self._waiting) <= WINDOW and now - oldest < PATIENCE
        if 0 < gap <= WINDOW and patient and not at_end:
            return None
        note = self._missing(gap)
        heapq.heappop(self._waiting)
        self._last = number, name
        return Ready(name, note)

    def deadline(self) -> float | None:
        """When a gap is given up [s]; None if none is waited for."""
        oldest = min((came for _, came, _ in self._waiting), default=None)
        return None if oldest is None else oldest + PATIENCE

    def _missing(self, gap: int) -> str:
        if not 0 < gap < NUMBERED or self._last is None:
            return ""
        self.num_missing += gap
        first = self._last[0] + 1
        which = f"submap {first} is" if gap == 1 else f"submaps {first} to {first + gap - 1} are"
        return f"{which} missing: odometry bridges the gap"


@dataclass(frozen=True)
class Counts:
    """How many submaps came, and what became of them."""

    compared: int = 0  # that the track has
    doubled: int = 0  # that came again, with the same content
    refused: int = 0  # whose id came before with another content, or that are no submaps
    left_out: int = 0  # that are kept, but could not be compared
    missing: int = 0  # whose numbers never came
    late: int = 0  # that came too late for their place
    reordered: int = 0  # that came out of order, and were put in their place

    def spelled(self) -> str:
        """Write them in a line.

        >>> Counts(compared=12, doubled=1, late=2).spelled()
        '12 submaps compared; 1 doubled, 2 late'
        """
        words = {"left_out": "left out", "reordered": "put in order"}
        odd = [(words.get(name, name), number) for name, number in asdict(self).items() if number]
        rest = ", ".join(f"{number:,} {what}" for what, number in odd if what != "compared")
        submaps = "submap" if self.compared == 1 else "submaps"
        return f"{self.compared:,} {submaps} compared{'; ' * bool(rest)}{rest}"


class Follower:
    """Receives submaps from a source in one thread, and has them compared in another."""

    def __init__(
        self,
        source: Source,
        keeper: Keeper,
        compare: CompareSubmap,
        say: Say,
        *,
        track: Path | None = None,
        ended: Callable[[], None] = lambda: None,
        settle: Settle = lambda _: None,
    ) -> None:
        """Be ready to begin; what an earlier run has left in `keeper` is compared first.

        `track` is a file, written anew after each submap. `ended` is called once the source has no
        more and all is compared, `settle` when nothing has come for a while and at the end.
        """
        self._source, self._keeper, self._compare, self._say = source, keeper, compare, say
        self._settle, self._rests_at = settle, inf  # when it has rested enough to settle
        self._track, self._on_end, self._order = track, ended, Order()
        self._changed = threading.Condition()
        self._stopped = threading.Event()
        self._counts = Counts()
        self._recovered = list(keeper.names)  # what an earlier run has kept, in its order
        self._earlier = set(self._recovered)  # a file of it that is read again is no news
        self._ended = False
        self._busy = False
        self.failure: BaseException | None = None
        """What has ended it, if it could not go on: an error of the source, or of the program."""
        self._owners: dict[int, str] = {}  # ids of the track, by their numbers
        for name in self._recovered:
            self._check_index(name)
        source.keep(lambda: keeper.names)
        self._listener = threading.Thread(target=self._run, args=(self._listen,), daemon=True)
        self._worker = threading.Thread(target=self._run, args=(self._work,), daemon=True)

    def start(self) -> None:
        self._worker.start()
        self._listener.start()

    @property
    def counts(self) -> Counts:
        with self._changed:
            return replace(
                self._counts,
                missing=self._order.num_missing,
                late=self._order.num_late,
                reordered=self._order.num_reordered,
            )

    @property
    def ended(self) -> bool:
        """Whether the source has no more, and all that came is compared."""
        with self._changed:
            return self._ended and not (self._busy or self._recovered or self._order.waiting)

    def wait(self, is_reached: Callable[[Counts], bool], timeout: float | None = None) -> bool:
        """Wait until counts are reached, or it has failed; gives whether they are reached."""
        with self._changed:
            self._changed.wait_for(
                lambda: self.failure is not None or is_reached(self.counts), timeout
            )
            return is_reached(self.counts)

    def close(self) -> None:
        """Stop: what is on the disk stays there, and the next run goes on with it."""
        self._stopped.set()
        with self._changed:
            self._changed.notify_all()
        self._source.close()
        for thread, seconds in ((self._worker, None), (self._listener, LONGEST_READ)):
            if thread.ident is not None and thread is not threading.current_thread():
                thread.join(seconds)

    def _run(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            with self._changed:
                self.failure = self.failure or error
                self._changed.notify_all()

    # One thread listens …

    def _listen(self) -> None:
        for news in self._source.news(self._stopped):
            if isinstance(news, Trouble):
                self._say(news.text)
            else:
                self._take(news)
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def _take(self, arrival: Arrival) -> None:
        name = arrival.submap.id
        try:
            self._check_index(name)
            is_new = self._keeper.keep(arrival.submap)
        except InputError as error:
            reason = str(error)
            self._count(refused=1)
            self._say(reason)
            arrival.answer(Refused(name, reason))
            return
        arrival.answer(Kept(name, again=not is_new))
        if is_new:
            with self._changed:
                self._order.push(name, time.monotonic())
                self._changed.notify_all()
        elif name in self._earlier:
            self._earlier.discard(name)
        else:
            self._count(doubled=1)
            self._say(f"submap {name} came again, with the same content")

    def _check_index(self, name: str) -> None:
        """Check that a track can be read back with a submap: by the number in its id."""
        if self._track is None:
            return
        index = index_of(name)
        if index is None or index > MOST_INDEX:
            raise InputError(
                f"submap {name}: the rows of a track are known by a number in the id, of up to 15 "
                "digits; give it one, or leave --track out"
            )
        first = self._owners.setdefault(index, name)
        if first != name:
            raise InputError(
                f"submap {name}: has the number of {first}, by which the rows of a track are "
                "known; give it another, or leave --track out"
            )

    # … and one works.

    def _work(self) -> None:
        while (name := self._next()) is not None:
            try:
                corrected = self._compare(self._keeper.submap(name), self._progress)
            except Cancelled:
                return
            except InputError as error:
                self._say(f"submap {name} is left out: {error}")
                self._count(left_out=1)
                continue
            if corrected.closures:
                places = ", ".join(database for _, database in corrected.closures)
                self._say(f"submap {name} closes a loop with {places}")
            self._publish(corrected)
            self._rests_at = time.monotonic() + REST
            self._count(compared=1)
        if not self._stopped.is_set():
            self._on_end()

    def _settle_now(self) -> None:
        self._rests_at = inf
        try:
            corrected = self._settle(self._progress_at_rest)
        except Cancelled:
            self._rests_at = time.monotonic() + REST
            return
        if corrected is not None:
            self._publish(corrected)

    def _publish(self, corrected: Corrected) -> None:
        if self._track is not None:
            self._write_track(self._track, corrected)
        self._source.tell(corrected)

    def _progress_at_rest(self, fraction: float) -> None:
        self._progress(fraction)
        if self._order.waiting:
            raise Cancelled

    def _progress(self, _: float) -> None:
        if self._stopped.is_set():
            raise Cancelled

    def _next(self) -> str | None:
        """Wait for the submap whose turn it is; None when it is to stop, or no more will come."""
        while True:
            note = ""
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                if self._stopped.is_set():
                    return None
                if self._recovered:
                    self._busy = True
                    name = self._recovered.pop(0)
                    self._order.passed(name)
                    return name
                ready = self._order.next(time.monotonic(), at_end=self._ended)
                if ready is None:
                    now = time.monotonic()
                    if self._ended and self._rests_at == inf:
                        return None
                    if not self._ended and now < self._rests_at:
                        due = min(self._order.deadline() or inf, self._rests_at)
                        self._changed.wait(None if due == inf else max(0, due - now))
                        continue
                else:
                    note = ready.note
                self._busy = True
            if ready is None:
                self._settle_now()
                continue
            if note:
                self._say(note)
            return ready.id

    def _write_track(self, path: Path, corrected: Corrected) -> None:
        rows = [TRACK_HEAD]
        for name, pose in corrected.poses.items():
            rows.append(pose_row(f"{index_of(name)}", Pose.of_row(pose)))
        try:
            with writable(path), replacing(path) as unfinished:
                write_lines(unfinished, rows)
        except InputError as error:
            self._say(str(error))

    def _count(self, **more: int) -> None:
        with self._changed:
            now = {key: getattr(self._counts, key) + number for key, number in more.items()}
            self._counts = replace(self._counts, **now)
            self._changed.notify_all()
