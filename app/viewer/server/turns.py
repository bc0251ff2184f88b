"""Many pages at once: what one has said is merged until it is read, and pages act in turn.

A page that drags a slider sends 20 values a second, and what follows from one takes milliseconds.
With fifty such pages the server would do nothing else, and be ever further behind.
"""

import asyncio
import time
from collections.abc import Hashable
from typing import Any

MOST_WAITING = 32
"""Messages of a page that nothing newer replaces; the page is read on when there are fewer."""
MOST_BYTES = 1_000_000
"""The same for their size together: two parts of a file."""
REST = 1.0
"""Time between two turns, as a share of the time that the first took: for pictures, newcomers and
all else that the server does."""


class CoalescingQueue:
    """What a page has said and the server has not acted on, in order.

    A value replaces the one that its widget had before it, unless something else than values was
    said in between: a button acts on what was set before it was pressed.
    """

    def __init__(self) -> None:
        """Begin with nothing said."""
        self._waiting: dict[Hashable, tuple[dict[str, Any], bytes]] = {}
        self._num_acts = 0
        self._changed = asyncio.Event()
        self._end: BaseException | None = None
        self.num_bytes = 0

    def __len__(self) -> int:
        """Count the messages."""
        return len(self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether the page should be read no further now."""
        return len(self) >= MOST_WAITING or self.num_bytes >= MOST_BYTES

    def put(self, key: Hashable | None, message: dict[str, Any], frame: bytes) -> None:
        """Add a message, and the frame it came in.

        Args:
            key: Of what it sets: it takes the place of the last with the same key. None keeps it.
            message: Taken apart.
            frame: As it came.
        """
        if key is None:
            self._num_acts += 1
            key = object()
        else:
            key = self._num_acts, key
        self._drop(key)
        self._waiting[key] = message, frame
        self.num_bytes += len(frame)
        self._changed.set()

    def end(self, error: BaseException) -> None:
        """Say that nothing more comes, and why."""
        self._end = error
        self._changed.set()

    async def filled(self) -> None:
        """Wait until something was said; raises why nothing more is."""
        while not self._waiting:
            if self._end is not None:
                raise self._end
            await self.changed()

    async def changed(self) -> None:
        """Wait until something was said or taken, or `wake`."""
        self._changed.clear()
        await self._changed.wait()

    def wake(self) -> None:
        """Let whoever waits look again."""
        self._changed.set()

    def take(self) -> tuple[dict[str, Any], bytes]:
        """Take the oldest message and its frame; there must be one."""
        key = next(iter(self._waiting))
        taken = self._waiting[key]
        self._drop(key)
        self._changed.set()
        return taken

    def _drop(self, key: Hashable) -> None:
        if key in self._waiting:
            self.num_bytes -= len(self._waiting.pop(key)[1])


class RoundRobin:
    """Lets pages act one after the other, in the order in which they asked."""

    def __init__(self) -> None:
        """Begin with nobody's turn."""
        self._lock = asyncio.Lock()
        self._since = 0.0

    async def wait(self) -> None:
        """Wait for a turn. It is for what is done before the next `await`, and the tasks of that.

        It ends by itself, when these have run as far as they go at once.
        """
        await self._lock.acquire()
        self._since = time.perf_counter()
        loop = asyncio.get_running_loop()
        loop.call_soon(loop.call_soon, self._end)  # after the tasks that are made until then

    def _end(self) -> None:
        took = time.perf_counter() - self._since
        asyncio.get_running_loop().call_later(REST * took, self._lock.release)
