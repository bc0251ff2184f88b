"""How much pages may ask of the viewer, so that none takes it from the others."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """What is served at once, and how fast.

    Attributes:
        pages: Open pages.
        waiting: Connections that are not a page yet: half of a request, or an answer that nobody
            fetches. The oldest are dropped first.
        rate: Messages that a page may send [1/s]. It is made to wait for more, not refused.
        burst: Messages that may come at once after a rest.
        message_bytes: The largest message; a picture of the page is the largest that there is.
        unfinished: Uploads of one page that are under way.
        idle_seconds: An upload of which nothing has come for so long is dropped [s].
        typing_seconds: A value that cannot be taken is refused so long after it came [s]: a person
            who types 15 where 10 is the least has typed 1 before.
    """

    pages: int = 100
    waiting: int = 256
    rate: float = 250.0
    burst: float = 500.0
    message_bytes: int = 32_000_000
    unfinished: int = 4
    idle_seconds: float = 60.0
    typing_seconds: float = 1.0


class Pace:
    """Says how long a page must wait with its next message."""

    def __init__(
        self, rate: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin rested.

        Args:
            rate: Messages in a second that go on for ever.
            burst: Messages at once after a rest.
            clock: Gives the time [s].
        """
        self._rate, self._burst, self._clock = rate, burst, clock
        self._left, self._last = burst, clock()

    def wait_seconds(self) -> float:
        """Count a message; give the time to wait before it is taken [s]."""
        now = self._clock()
        self._left = min(self._burst, self._left + self._rate * (now - self._last)) - 1.0
        self._last = now
        return max(0.0, -self._left / self._rate)
