"""What a fit costs: told before the work, so that what costs too much is refused and not begun."""

from dataclasses import dataclass

MOST_SECONDS = 30.0
"""Longest time that a fit may be estimated to take, on two cores of 2.8 GHz."""
MOST_BYTES = 1.35e9
"""Largest memory that a fit may be estimated to take. With the fields of the largest grid and what
a process needs anyway, it stays below 2 GB."""


@dataclass(frozen=True)
class Cost:
    """The estimated cost of a fit and its samples.

    Attributes:
        seconds: Time on two cores of 2.8 GHz [s].
        num_bytes: Largest memory at a time [bytes].
    """

    seconds: float
    num_bytes: float

    @property
    def excess(self) -> float:
        """How many times more than allowed it is; at most 1 if it is allowed."""
        return max(self.seconds / MOST_SECONDS, self.num_bytes / MOST_BYTES)

    def __str__(self) -> str:
        """Say it in words, with what is allowed."""
        if self.seconds / MOST_SECONDS >= self.num_bytes / MOST_BYTES:
            return f"about {self.seconds:,.0f} s (at most {MOST_SECONDS:g} s)"
        return f"about {self.num_bytes / 1e9:,.2f} GB (at most {MOST_BYTES / 1e9:g} GB)"
