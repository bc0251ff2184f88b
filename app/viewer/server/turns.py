"""Many pages at once: messages of one are merged until they are read, and pages act in turn.

A page that drags a slider sends 20 values a second, and what follows from one takes milliseconds.
With fifty such pages the server would do nothing else, and be ever further behind.
"""

import asyncio
import time
from collections.abc import Hashable
from typing import Any

REST = 1.0
"""Time between two turns, as a share of the time that the first took: for pictures, newcomers and
all else that the server does."""


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
        """Pop the oldest message, if there is any."""
        oldest = next(iter(self._waiting), None)
        return None if oldest is None else self._waiting.pop(oldest)[0]


class RoundRobin:
    """Lets pages act one after the other, in the order of their requests."""

    def __init__(self) -> None:
        self._lock = asyncio.Lock()

    async def wait(self) -> None:
        """Wait for a turn. It is for what is done before the next `await`, and the tasks of that.

        It ends by itself, when these have run as far as they go at once.
        """
        await self._lock.acquire()
        loop, since = asyncio.get_running_loop(), time.perf_counter()

        def end() -> None:
            loop.call_later(REST * (time.perf_counter() - since), self._lock.release)

        loop.call_soon(loop.call_soon, end)  # after the tasks that are created until then
