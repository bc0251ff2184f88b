"""How work is run: progress and cancelling here; caches, threads and processes in the modules."""

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction done in [0, 1], once per tile or block; may raise Cancelled."""


class Cancelled(Exception):
    """Raised by a progress hook to stop the work that calls it; none of its results are stored."""


def silent(fraction: float) -> None:
    """Ignore the progress; the default hook."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Make a hook for one stage, whose 0 to 1 becomes ``start`` to ``stop`` of the whole."""
    return lambda fraction: progress(start + (stop - start) * fraction)
