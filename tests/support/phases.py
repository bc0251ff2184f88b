"""Plays the record of a run of *All pairs* to its time left."""

from collections.abc import Sequence

import numpy as np

from app.viewer.features.pairs.model import PHASES
from app.viewer.widgets.status import TimeLeft

MISLEADS = 0.5
"""A time told misleads if it is off by more than so much of the true one."""
GRACE = 1.0
"""A page tells whole seconds: so much is no misleading [s]."""


def misled(record: Sequence[tuple[float, float]]) -> list[float]:
    """Give the ratios of told to true times for a record of (seconds, fraction).

    Where they differ by less than a page can tell, the ratio is 1.
    """
    left, shown, ratios = TimeLeft(), -1.0, list[float]()
    times, fractions = np.array(record).T
    for now, fraction in record:
        if fraction - shown < 0.01:  # as `Work` tells it
            continue
        shown = fraction
        phase, told = left.at(fraction, now, PHASES)
        if told is None:
            continue
        ended = times[np.flatnonzero(fractions >= PHASES[phase] - 1e-9)]
        true = float(ended[0] if ended.size else times[-1]) - now
        ratios.append(1.0 if abs(told - true) < GRACE else told / max(true, 1e-9))
    return ratios
