"""How well submaps lie on one another: a measure of a map that needs no true poses."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from gpgrad_core.evaluation.overlap import compare_footprints, make_footprint
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Submap

FEWEST_SHARE = 0.2
"""Share of the smaller submap's cells that must be common. A smaller overlap is an edge that both
submaps saw from far away."""


@dataclass(frozen=True)
class Consistency:
    """Differences in height where submaps overlap.

    Attributes:
        count: Number of pairs of submaps that share more than a fifth of their 10 cm cells.
        median: Median of the pairs' median height differences [m]; None if there is no such pair.
        high: 95th percentile of them [m]; None if there is no such pair.
    """

    count: int
    median: float | None
    high: float | None


def measure_consistency(submaps: Iterable[Submap], poses: Mapping[str, Pose]) -> Consistency:
    """Compare the heights of all submaps that overlap.

    Args:
        submaps: Any iterable; it is iterated once, and only the 10 cm cells are kept in memory.
        poses: ``T_world_submap`` by id; submaps without a pose are left out.
    """
    footprints = [
        make_footprint(poses[submap.id].apply(submap.points))
        for submap in submaps
        if submap.id in poses
    ]
    found: list[float] = []
    low = np.array([one.low for one in footprints]).reshape(-1, 2)
    high = np.array([one.high for one in footprints]).reshape(-1, 2)
    for k in range(1, len(footprints)):
        meeting = np.all((low[:k] < high[k]) & (high[:k] > low[k]), axis=1)
        for other in np.flatnonzero(meeting):
            _, overlap, difference = compare_footprints(footprints[k], footprints[other])
            if overlap > FEWEST_SHARE and np.isfinite(difference):
                found.append(difference)
    if not found:
        return Consistency(0, None, None)
    return Consistency(len(found), float(np.median(found)), float(np.quantile(found, 0.95)))
