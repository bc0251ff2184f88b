"""Submaps in the order of their numbers, though they may come late, or not at all."""

import heapq
from collections import deque
from dataclasses import dataclass

from gpgrad_core.io.folder import index_of

WINDOW = 2
"""How many later submaps may come before one that is waited for."""
PATIENCE = 5.0
"""How long it is waited for [s]."""
NUMBERED = 1000
"""Steps between numbers from here on are those of times, not of a count."""


@dataclass(frozen=True)
class Ready:
    """A submap whose turn has come."""

    id: str
    note: str = ""  # what is odd about it, in a line; empty if nothing is


class Order:
    """Gives submaps in the order of the numbers in their ids.

    A gap is waited for as long as later submaps are few and young. Then the submaps of the gap
    count as missing, and odometry bridges them. If one comes after all, it is taken as the next.

    Attributes:
        num_missing, num_late, num_reordered: Numbers of submaps that are missing, came too late for
            their place, and were put in their place.
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
        """Give the one whose turn has come, if there is one; at the end, gaps stay gaps."""
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
