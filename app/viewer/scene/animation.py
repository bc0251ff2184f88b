"""Something that moves for a while: played live, or frame by frame into a page."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gpgrad_core.run.progress import Progress, silent

FRAMES_A_SECOND = 24


@dataclass(frozen=True, eq=False)
class Animation:
    """A function that draws any moment of a motion.

    Attributes:
        seconds: How long it takes.
        draw: Draws the moment at a share of the whole in [0, 1].
        rest: How long the first and the last moment stand still, where it is played over and
            over [s].
    """

    seconds: float
    draw: Callable[[float], None]
    rest: float = 1.0


def play(animation: Animation, progress: Progress = silent) -> None:
    """Play once, in real time; a slow machine shows fewer pictures, not a slower motion.

    Args:
        animation: What to play.
        progress: Called once a picture; may raise Cancelled.
    """
    start = time.monotonic()
    share = 0.0
    while share < 1.0:
        share = min((time.monotonic() - start) / max(animation.seconds, 1e-6), 1.0)
        progress(share)
        animation.draw(share)
        time.sleep(1 / FRAMES_A_SECOND)


def frames(animation: Animation) -> Iterator[float]:
    """Draw every picture, and give how long each stands [s]."""
    count = max(2, round(animation.seconds * FRAMES_A_SECOND) + 1)
    for k in range(count):
        animation.draw(k / (count - 1))
        resting = animation.rest if k in (0, count - 1) else 0.0
        yield 1 / FRAMES_A_SECOND + resting


def ease(share: float) -> float:
    """Ease in and out.

    >>> ease(0.0), ease(0.5), ease(1.0)
    (0.0, 0.5, 1.0)
    """
    return share * share * (3.0 - 2.0 * share)
