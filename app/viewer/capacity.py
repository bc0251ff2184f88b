"""How much sessions may compute at once: they share the processors."""

import threading
from dataclasses import dataclass, field

from gpgrad_core.run.helper import Helper
from gpgrad_core.run.threads import num_workers


@dataclass(frozen=True, eq=False)
class Capacity:
    """What a worker must hold while it computes.

    Attributes:
        pictures: For the pair that a session shows: as many slots as there are processors.
        long: For work that takes longer than a picture, one at a time. It is apart from the
            pictures, so that sliders answer meanwhile.
        helper: A process that infers one of two submaps; None where there is one processor.
    """

    pictures: threading.Semaphore = field(
        default_factory=lambda: threading.Semaphore(max(1, num_workers()))
    )
    long: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(1))
    helper: Helper | None = None
