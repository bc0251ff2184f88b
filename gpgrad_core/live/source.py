"""What every source of submaps has in common."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeAlias, runtime_checkable

from gpgrad_core.live.frames import Corrected, Kept, Refused, Submitted
from gpgrad_core.types import Submap

Answer: TypeAlias = Callable[[Kept | Refused], None]
"""Says to whoever sent a submap what became of it."""


def nobody(_: Kept | Refused) -> None:
    """Answer nobody: files do not listen."""


@dataclass(frozen=True, eq=False)
class Arrival:
    """A submap that has come."""

    submap: Submap  # the submap, with its odometry pose
    answer: Answer = nobody  # called once it is kept or refused


@dataclass(frozen=True)
class Trouble:
    """Something that could not be used; the source goes on."""

    text: str  # one line: what, where, and what to do


News: TypeAlias = Arrival | Trouble


@runtime_checkable
class Source(Protocol):
    """Where submaps come from: a folder, a recording that grows, a stream, a socket."""

    @property
    def name(self) -> str: ...

    def news(self, stopped: threading.Event) -> Iterator[News]:
        """Wait for news until `stopped` is set or no more will come.

        A source that can be read twice brings everything again if it is opened again.
        """
        ...

    def tell(self, corrected: Corrected) -> None:
        """Send the corrected poses back, as far as somebody listens; must be quick."""
        ...

    def keep(self, names: Callable[[], tuple[str, ...]]) -> None:
        """Set the function that gives the ids of stored submaps; called once, before `news`."""
        ...

    def close(self) -> None:
        """Let go of files and connections."""
        ...


class Silent:
    """What a source does to which nobody listens."""

    def tell(self, corrected: Corrected) -> None:
        """Tell nobody."""

    def keep(self, names: Callable[[], tuple[str, ...]]) -> None:
        """Tell nobody."""

    def close(self) -> None:
        """Hold nothing."""


def arrival_of(sent: Submitted, answer: Answer = nobody) -> Arrival:
    """Make a submap of a message."""
    return Arrival(sent.submap(), answer)
