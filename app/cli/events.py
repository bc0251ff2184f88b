"""What ``--json`` prints: an event in a line of JSON. The guide's table of events is a promise."""

import threading
from collections.abc import Generator
from contextlib import contextmanager

import msgspec
from msgspec import Struct

from gpgrad_core import __version__


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

    @contextmanager
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
