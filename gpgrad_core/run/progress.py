"""How long work reports where it is, and how it is told to stop."""

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[float], None]
"""Called with the fraction done in [0, 1], once a tile or a block; may raise Cancelled."""


class Cancelled(Exception):
    """Raised by a progress hook to stop the work below it; nothing of it is kept."""


def silent(fraction: float) -> None:
    """Report to nobody; the default."""


def part(progress: Progress, start: float, stop: float) -> Progress:
    """Let a stage report 0..1 into the stretch ``start..stop`` of the whole.

    Args:
        progress: The hook of the whole.
        start: Fraction of the whole at which the stage begins.
        stop: Fraction of the whole at which it ends.
    """
    return lambda fraction: progress(start + (stop - start) * fraction)
