"""What the command line says: results, notes, progress, and errors as exit codes.

With ``--json`` all of it is events on standard output, each in a line of JSON. The guide's table of
events is a promise.
"""

import contextlib
import logging
import sys
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import Executor
from pathlib import Path

import msgspec
from msgspec import Struct

from app.ending import code_of, reason_of, stop_printing, stopped_by, termination_raised
from gpgrad_core import __version__
from gpgrad_core.errors import InputError, message_of
from gpgrad_core.run import Progress, silent

FAILED = 2
BETWEEN = 0.5
"""Least time between two lines of progress [s]."""
NO_ROOM = "there is too little memory, or a library cannot be loaded"
"""What it means that the system refuses memory or a library."""


class Event(Struct, tag_field="event", tag=str.lower):
    """One line; its first key is ``event``, the name of the class in small letters."""


class Started(Event):
    """The first event of a run."""

    verb: str
    gpgrad: str = __version__


class ProgressEvent(Event, tag="progress"):
    """How much of a stage is done, at most twice a second, and 1 at its end."""

    stage: str
    fraction: float


class Info(Event):
    """A line of information."""

    text: str


class Warned(Event, tag="warning"):
    """What was left out or assumed; standard error has it too."""

    text: str


class Closure(Event):
    """A loop closure, as soon as it is decided."""

    query: str
    database: str
    method: str
    score: float
    num_inliers: int
    overlap_area: float
    reason: str
    T_database_query: dict[str, float] | None
    z_offset: float | None


class Result(Event):
    """The last event of a run that succeeds."""

    text: list[str]
    output: str | None
    values: dict[str, object]


class Error(Event):
    """The last event of a run that fails; standard error has its text too."""

    exit_code: int
    text: str


class Events:
    """Writes events to standard output, on request; threads may share it."""

    def __init__(self) -> None:
        self.wanted = False
        self._lock = threading.Lock()
        self._encoder = msgspec.json.Encoder()

    @contextlib.contextmanager
    def on(self, wanted: bool) -> Generator[None]:
        before, self.wanted = self.wanted, wanted
        try:
            yield
        finally:
            self.wanted = before

    def tell(self, event: Event) -> None:
        """Write an event; numbers that are not finite become null."""
        if self.wanted:
            line = self._encoder.encode(event).decode("utf-8")
            with self._lock:
                print(line, flush=True)  # noqa: T201 - the output


EVENTS = Events()


def exit_code(work: Callable[[], None]) -> int:
    """Run a verb's work, and turn how it ends into an exit code.

    It is 0, or 2 after one line on standard error that says what was wrong, or 130 if interrupted
    and 143 if terminated, or 141 without a word if nobody reads its output to the end.
    """
    # It warns of a home that it cannot write to, which nobody requested.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)
    try:
        with termination_raised():
            work()
    except KeyboardInterrupt as stopped:
        return _tell_end(stopped)
    except Exception as error:
        stopped = stopped_by()
        if stopped is not None:
            return _tell_end(stopped)
        if isinstance(error, InputError):
            _tell_error(FAILED, one_line(str(error)))
        elif isinstance(error, BrokenPipeError):
            return stop_printing()
        elif isinstance(error, OSError):
            what = error.strerror or str(error)
            _tell_error(FAILED, one_line(f"{error.filename}: {what}" if error.filename else what))
        elif _is_want_of_memory(error):
            _tell_error(FAILED, f"{NO_ROOM}: {message_of(error)}")
        else:
            raise
        return FAILED
    return 0


def _is_want_of_memory(error: Exception) -> bool:
    if isinstance(error, RuntimeError):
        return "start new thread" in str(error)
    is_library = isinstance(error, ImportError) and not isinstance(error, ModuleNotFoundError)
    return is_library or isinstance(error, MemoryError)


def _tell_end(stopped: KeyboardInterrupt) -> int:
    _tell_error(code_of(stopped), reason_of(stopped))
    return code_of(stopped)


def _tell_error(code: int, text: str) -> None:
    _complain(text)
    with contextlib.suppress(BrokenPipeError):  # the exit code says it too
        EVENTS.tell(Error(code, text))


def say(*lines: str) -> None:
    """Print lines of information."""
    for line in lines:
        if EVENTS.wanted:
            EVENTS.tell(Info(line))
        else:
            print(line, flush=True)  # noqa: T201


def conclude(*lines: str, output: Path | None = None, **values: object) -> None:
    """Print what came of a verb, in lines; with ``--json`` also in numbers, by their names."""
    if EVENTS.wanted:
        EVENTS.tell(Result(list(lines), None if output is None else str(output), values))
    else:
        say(*lines)


def warn(*lines: str) -> None:
    """Print lines on standard error, where they do not mix with the requested output."""
    for line in lines:
        _complain(line)
        EVENTS.tell(Warned(line))


def _complain(line: str) -> None:
    print(f"gpgrad: {line}", file=sys.stderr, flush=True)  # noqa: T201


@contextlib.contextmanager
def working(what: str, num_jobs: int) -> Generator[tuple[Progress, Executor]]:
    """Draw a bar while workers do so many jobs, as many at a time as there are cores."""
    from gpgrad_core.run.parallel import workers  # noqa: PLC0415 - loads slowly
    from gpgrad_core.run.threads import num_workers  # noqa: PLC0415

    with progress_bar(what) as progress, workers(num_workers(), num_jobs) as executor:
        yield progress, executor


@contextlib.contextmanager
def progress_bar(what: str) -> Generator[Progress]:
    """Draw a bar on a terminal, nothing into a file or pipe; with ``--json``, send it as events."""
    if EVENTS.wanted:
        last, last_time = -1.0, -BETWEEN

        def tell(fraction: float) -> None:
            nonlocal last, last_time
            now = time.monotonic()
            if fraction > last and (now - last_time >= BETWEEN or fraction >= 1.0):
                last, last_time = fraction, now
                EVENTS.tell(ProgressEvent(what, round(min(fraction, 1.0), 4)))

        yield tell
        tell(1.0)
        return
    if not sys.stderr.isatty():
        yield silent
        return
    from tqdm import tqdm  # noqa: PLC0415 - for terminals only

    layout = "{desc:>9} {percentage:3.0f} %|{bar}| {elapsed}<{remaining}"
    with tqdm(total=1.0, desc=what, bar_format=layout, leave=False) as bar:

        def progress(fraction: float) -> None:
            bar.n = fraction
            bar.refresh()

        yield progress


def one_line(text: str) -> str:
    r"""Join the lines of a text.

    >>> one_line("one  and\n  two")
    'one and two'
    """
    return " ".join(text.split())
