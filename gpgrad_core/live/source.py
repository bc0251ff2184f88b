"""What every source of submaps has in common, and the simplest one: a stream of frames."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from gpgrad_core.errors import InputError
from gpgrad_core.live.frames import Corrected, Hello, Kept, Receive, Refused, contents, from_robot
from gpgrad_core.types import Submap

LOOK = 0.5
"""Files and folders are looked at so often [s]."""
PATIENCE = 5.0
"""What cannot be used is reported once it has not changed for so long [s]."""
Stamp: TypeAlias = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file."""
Acknowledge: TypeAlias = Callable[[Kept | Refused], None]
"""Tells the sender of a submap what became of it."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """A submap that has come."""

    submap: Submap  # the submap, with its odometry pose
    answer: Acknowledge = lambda _: None  # called once it is kept or refused


@dataclass(frozen=True)
class Trouble:
    """Something that could not be used; the source goes on."""

    text: str  # one line: what, where, and what to do


News: TypeAlias = Arrival | Trouble


class Source:
    """Where submaps come from: a folder, a recording that grows, a stream, a socket."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._stored_ids: Callable[[], tuple[str, ...]] = tuple

    def news(self, stopped: threading.Event) -> Iterator[News]:
        """Wait for news until `stopped` is set or no more will come.

        A source that can be read twice brings everything again if it is opened again.
        """
        raise NotImplementedError

    def keep(self, names: Callable[[], tuple[str, ...]]) -> None:
        """Set the function that gives the ids of stored submaps; called once, before `news`."""
        self._stored_ids = names

    def tell(self, corrected: Corrected) -> None:
        """Send the corrected poses back, as far as somebody listens; must be quick."""

    def close(self) -> None:
        """Let go of files and connections."""


def mark_of(path: Path) -> Stamp | None:
    """A mark that differs once a file has changed; None if it is missing."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


class Stream(Source):
    """Reads frames from standard input, or any stream, until it ends; it answers nobody."""

    def __init__(self, receive: Receive, name: str = "standard input") -> None:
        super().__init__(name)
        self._receive = receive

    def news(self, stopped: threading.Event) -> Iterator[News]:
        for content in contents(self._receive, self.name):
            if stopped.is_set():
                return
            message = from_robot(content, self.name)
            if isinstance(message, Hello):
                continue
            try:
                yield Arrival(message.submap())
            except InputError as error:
                yield Trouble(str(error))
