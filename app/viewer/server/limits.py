"""What the viewer may read and write, and how much pages may ask, so that none takes it all.

A page that drags a slider sends 20 values a second, and what follows from one takes milliseconds.
With fifty such pages the server would do nothing else, and be ever further behind. So messages of
one are merged until they are read, and pages act in turn.
"""

import asyncio
import time
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

REST = 1.0
"""Time between two turns, as a share of the time that the first took: for pictures, newcomers and
all else that the server does."""


@dataclass(frozen=True)
class Permissions:
    """Folders and sizes that the person who starts the viewer allows it to use."""

    # folder of the user's own presets and the list of recent datasets; None keeps neither
    config: Path | None = None
    # datasets outside of this folder are not opened, except the demo and uploads; None allows
    # whatever the person who started the viewer can read
    root: Path | None = None
    # existing folder for what pages upload, which its maker removes; None allows no uploads
    uploads: Path | None = None
    # largest file that can be uploaded [bytes]. An archive may unpack to
    # `app.viewer.features.data.unpacking.MOST_GROWTH` times as much
    max_upload: int = 200_000_000
    # whether pages may have datasets built, in new folders inside of the root, if any
    writes: bool = False

    @property
    def presets(self) -> Path | None:
        return None if self.config is None else self.config / "presets"


READ_ALL = Permissions()
"""Read whatever the person who started the viewer can read; keep nothing, take no uploads."""


@dataclass(frozen=True)
class Limits:
    """What is served at once, and how fast."""

    pages: int = 100  # open pages
    # connections that are not a page yet: half of a request, or an answer that nobody fetches. The
    # oldest are dropped first
    waiting: int = 256
    # turns that a page may have [1/s]. It has to wait for more, and is not refused
    rate: float = 250.0
    # that wait for a page's turn and that nothing newer replaces. It is read on when there are
    # fewer
    messages: int = 32
    # the largest message; a picture of the page is the largest that there is
    message_bytes: int = 32_000_000
    # what all pages together may have begun to send and not ended
    unfinished_bytes: int = 150_000_000
    # the largest file that may be uploaded, and all that are under way at once
    upload_bytes: int = 0
    uploads: int = 4  # files of one page that are under way
    idle_seconds: float = 60.0  # an upload of which nothing has come for so long is dropped [s]
    # a value that cannot be taken is refused so long after it came [s]: a person who types 15 where
    # 10 is the least has typed 1 before
    typing_seconds: float = 1.0


class CoalescingQueue:
    """What a page has sent and the server has not acted on, in order.

    A value replaces the one that its widget had before it, unless something else than values was
    sent in between: a button acts on what was set before it was pressed.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, tuple[dict[str, Any], int]] = {}
        self._num_acts = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def num_bytes(self) -> int:
        return sum(num_bytes for _, num_bytes in self._waiting.values())

    def put(self, key: Hashable | None, message: dict[str, Any], num_bytes: int) -> None:
        """Add a message that sets what a key names, or with None one that nothing replaces."""
        self._num_acts += key is None
        place = self._num_acts, key
        self._waiting.pop(place, None)
        self._waiting[place] = message, num_bytes

    def take(self) -> dict[str, Any] | None:
        oldest = next(iter(self._waiting), None)
        return None if oldest is None else self._waiting.pop(oldest)[0]


class RoundRobin:
    """Lets pages act one after the other, in the order of their requests."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()

    async def wait(self) -> None:
        """Wait for a turn, which ends with the tasks that are begun before the next `await`."""
        await self._lock.acquire()
        loop, since = asyncio.get_running_loop(), time.perf_counter()

        def end() -> None:
            loop.call_later(REST * (time.perf_counter() - since), self._lock.release)

        loop.call_soon(loop.call_soon, end)  # after the tasks that are created until then
