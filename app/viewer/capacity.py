"""How many sessions may compute at once: the processors are shared, and so are their turns."""

import threading
from dataclasses import dataclass, field

from gpgrad_core.run.helper import Helper
from gpgrad_core.run.threads import num_workers


@dataclass(frozen=True, eq=False)
class Turns:
    """What a worker must hold while it computes.

    Attributes:
        pictures: For the pair that a session shows: as many as there are processors.
        long: For what takes a processor for longer than a picture, one at a time; apart from the
            pictures, so that sliders follow the hand meanwhile.
        helper: Takes one of two submaps off a session's hands; None where there is one processor.
    """

    pictures: threading.Semaphore = field(
        default_factory=lambda: threading.Semaphore(max(1, num_workers()))
    )
    long: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(1))
    helper: Helper | None = None
