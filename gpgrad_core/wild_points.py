"""Finds wild points: those that no ground around them could explain.

One point a kilometre above the others would move the mean height of a submap, widen its map, and
spoil what is fitted to it. The cloud itself says how much heights differ over a distance; a point
that differs from all its neighbours by many times that, or that has no neighbours at all, is wild.
A few points that are near each other explain each other: a wall, a bush or a far slope stays.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray

LEAST_POINTS = 50
"""In a smaller cloud nothing is called wild: it says too little of its ground."""
EXPLAINED_BY = 3
"""Number of neighbours that must agree with a point, so that two wild ones do not explain each
other."""
ASKED = 12
"""Number of nearest neighbours that may explain a point."""
OUTLYING, OUTLYING_ALONE = 12.0, 5.0
"""Heights over a distance may differ by this many times what is usual over it: less where points
are few, so that one alone is judged by what is far. On five sets of terrain and the demo, whole,
thinned to 1,000 points, and thinned and noisy, no point differs by more than 11.0 times, and none
whose neighbours are four usual spacings away by more than 3.0 times."""
ROUGH = 3.0
"""… and by this many times what is usual where the cloud is roughest, in bushes for instance."""
ROUGHEST = 0.98
"""The share of a cloud's points that differ less from their neighbours than the roughest."""
LONELY = 30.0
"""A point further than this many usual spacings from its neighbours is wild; in the clouds above,
none is further than 21."""
LONELY_SHARE = 0.75
"""… but in a sparse cloud it is wild already if further than this share of the longer side."""
LEAST_WIDTH = 1e-6
"""In a cloud that is not wider than this [m] nothing is called wild."""
CORE = 0.02
"""Share of the points left out at each side where the width of a cloud is measured."""
LEAST_STEP, LEAST_SLOPE = 0.002, 0.03
"""Heights usually differ by this much at least [m], and per distance [m/m]: a cloud without any
noise does not make every pebble wild."""
COMPARED = 200
"""Number of points whose heights are compared over larger distances."""
SAMPLED = 500
"""Number of points that tell how rough a cloud is."""
POINTS_A_BIN = 300
"""Smallest number of differences of heights of which a median is taken."""


def find_wild_points(points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
    """Find the points that no ground around them could explain.

    Args:
        points: Positions (n, 3) [m], all finite; z points up.

    Returns:
        Which points are wild (n,).
    """
    # Imported here because it loads slowly, and only clouds need it.
    from scipy.spatial import cKDTree  # noqa: PLC0415

    wild = np.zeros(len(points), bool)
    if len(points) < LEAST_POINTS:
        return wild
    xy, heights = points[:, :2], points[:, 2]
    low, high = np.quantile(xy, (CORE, 1 - CORE), axis=0)
    sides = high - low
    if sides.min() <= LEAST_WIDTH:  # a line, which is refused elsewhere
        return wild
    # Along a narrow strip points follow each other.
    spacing = max(float(np.sqrt(sides.prod() / len(points))), float(sides.max() / len(points)))
    order, starts = _by_cells(xy, low, np.sqrt(9.0) * spacing)
    usual = _UsualDifference.of(points, order)
    doubtful = _doubtful(heights, order, starts, OUTLYING * usual(np.zeros(1))[0])
    if not len(doubtful):
        return wild
    tree = cKDTree(xy, balanced_tree=False)

    def unlikeness(rows: Int[NDArray[np.intp], "k"]) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        """By how many times what is usual points differ from others, and how far these are [m]."""
        distances, neighbours = map(np.asarray, tree.query(xy[rows], ASKED + 1))
        times = np.abs(heights[neighbours] - heights[rows, None]) / usual(distances)
        # The first in order is the point itself, which differs by nothing.
        return np.sort(times, axis=1)[:, EXPLAINED_BY], distances[:, EXPLAINED_BY]

    times, reach = unlikeness(doubtful)
    too_far = min(LONELY * spacing, LONELY_SHARE * float(sides.max()))
    wild[doubtful[reach > too_far]] = True
    limits = np.clip(OUTLYING * 2 * spacing / np.maximum(reach, spacing), OUTLYING_ALONE, OUTLYING)
    unlike = times > limits
    if unlike.any():
        doubtful, times, reach = doubtful[unlike], times[unlike], reach[unlike]
        roughest = np.quantile(unlikeness(_evenly(order, SAMPLED))[0], ROUGHEST)
        limits = np.maximum(limits[unlike], ROUGH * float(roughest))
        # A wall has points above each other: those that are near in space explain it.
        in_space = cKDTree(points, balanced_tree=False)
        apart = np.asarray(in_space.query(points[doubtful], EXPLAINED_BY + 1)[0])[:, EXPLAINED_BY]
        unexplained = (times > limits) & (apart > np.maximum(limits * usual(reach), reach))
        wild[doubtful[unexplained | (apart > too_far)]] = True
    return wild


def _evenly(rows: Int[NDArray[np.intp], "n"], count: int) -> Int[NDArray[np.intp], "k"]:
    """Choose so many rows at most, evenly spaced."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), count)).astype(int)]


def _by_cells(
    xy: Float[Array, "n 2"], low: Float[Array, "2"], side: float
) -> tuple[Int[NDArray[np.intp], "n"], Int[NDArray[np.intp], "cells"]]:
    """Sort points by square cells: their order, and where each occupied cell starts in it."""
    column, row = np.floor((xy - low) / side).astype(np.int64).T
    order = np.lexsort((column, row))
    column, row = column[order], row[order]
    changes = (np.diff(column) != 0) | (np.diff(row) != 0)
    return order, np.concatenate([[0], np.flatnonzero(changes) + 1])


def _doubtful(
    heights: Float[Array, "n"],
    order: Int[NDArray[np.intp], "n"],
    starts: Int[NDArray[np.intp], "cells"],
    allowed: float,
) -> Int[NDArray[np.intp], "k"]:
    """Find the points that those of their own cell do not explain at once; mostly they are few."""
    in_order = heights[order]
    ranges = np.maximum.reduceat(in_order, starts) - np.minimum.reduceat(in_order, starts)
    counts = np.diff(starts, append=len(order))
    explained = (counts > EXPLAINED_BY) & (ranges <= allowed)
    return order[~np.repeat(explained, counts)]


class _UsualDifference:
    """How much two heights of a cloud usually differ over a distance: its robust variogram."""

    def __init__(self, distances: Float[Array, "b"], differences: Float[Array, "b"]) -> None:
        self._distances, self._differences = distances, differences

    @classmethod
    def of(
        cls, points: Float[Array, "n 3"], order: Int[NDArray[np.intp], "n"]
    ) -> "_UsualDifference":
        """Measure it on points that follow each other in an order of cells, and on far ones."""
        pairs = np.column_stack([order[:-1], order[1:]])
        near = pairs[_evenly(np.arange(len(pairs)), 10 * COMPARED)]
        some = _evenly(order, COMPARED)
        first, second = np.triu_indices(len(some), 1)
        far = np.column_stack([some[first], some[second]])
        start, end = points[np.concatenate([near, far]).T]
        distances = np.hypot(*(start[:, :2] - end[:, :2]).T)
        differences = np.abs(start[:, 2] - end[:, 2])
        nearest_first = np.argsort(distances)
        num_bins = int(np.log2(len(distances) / POINTS_A_BIN)) + 1
        ends = np.geomspace(min(POINTS_A_BIN, len(distances)), len(distances), num_bins + 1)
        bins = np.split(nearest_first, np.unique(ends.astype(int))[:-1])
        medians = np.array([(np.median(distances[b]), np.median(differences[b])) for b in bins])
        # 1.48 times the median is the standard deviation of a normal variable.
        return cls(medians[:, 0], 1.48 * np.maximum.accumulate(medians[:, 1]))

    def __call__(self, distances: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        usual = np.interp(distances, self._distances, self._differences)
        return np.maximum(usual, LEAST_STEP + LEAST_SLOPE * distances)
