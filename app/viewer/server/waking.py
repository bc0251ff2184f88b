"""What is sent to pages may be handed over by any thread.

An event of `asyncio` belongs to the thread of its loop. viser sets the one that wakes a page's
sender from whatever thread has something to send, and then once more inside the loop. The first of
these fails now and then, with "deque mutated during iteration", when many pages come and go.
"""

import asyncio
import functools
from typing import Any

from viser.infra._async_message_buffer import AsyncMessageBuffer


class LoopEvent(asyncio.Event):
    """An event that only its loop sets; elsewhere, setting it does nothing."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Make it for a loop, which need not run yet."""
        super().__init__()
        self._of = loop

    def set(self) -> None:
        """Wake all that wait, if this is called inside the loop."""
        try:
            inside = asyncio.get_running_loop() is self._of
        except RuntimeError:  # no loop runs in this thread
            inside = False
        if inside:
            super().set()


def wake_in_the_loop() -> None:
    """Give viser's buffers such an event; once for the process, before a server starts."""
    buffers: Any = AsyncMessageBuffer
    make = buffers.__init__
    if hasattr(make, "__wrapped__"):
        return

    @functools.wraps(make)
    def made(buffer: AsyncMessageBuffer, *args: Any, **named: Any) -> None:
        make(buffer, *args, **named)
        buffer.message_event = LoopEvent(buffer.event_loop)

    buffers.__init__ = made
