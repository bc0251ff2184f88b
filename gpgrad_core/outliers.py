"""Finds outliers: points that no ground around them could explain; see the guide (datasets.md)."""

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray

LEAST_POINTS = 50
"""In a smaller cloud nothing is called an outlier: it says too little of its ground."""
EXPLAINED_BY = 3
"""Number of neighbours that must agree with a point: two outliers do not explain each other."""
NUM_NEIGHBOURS = 12
"""Number of nearest neighbours that may explain a point."""
OUTLYING, OUTLYING_ALONE = 12.0, 5.0
"""Heights over a distance may differ by this many times what is usual over it: less where points
are few, so that one alone is judged by what is far."""
ROUGH = 3.0
"""… and by this many times what is usual where the cloud is roughest, in bushes for instance."""
ROUGHEST = 0.98
"""The share of a cloud's points that differ less from their neighbours than the roughest."""
LONELY = 30.0
"""A point further than this many usual spacings from its neighbours is an outlier."""
LONELY_SHARE = 0.75
"""… but in a sparse cloud it is one already if further than this share of the longer side."""
LEAST_WIDTH = 1e-6
"""In a cloud that is not wider than this [m] nothing is called an outlier."""
CORE = 0.02
"""Share of the points left out at each side where the width of a cloud is measured."""
LEAST_STEP, LEAST_SLOPE = 0.002, 0.03
"""Least usual difference of heights [m], and per distance [m/m]: a pebble is no outlier."""
AROUND, UNLIKE_AROUND = 24, 16.0
"""… or if it is further from the plane of so many neighbours than so many times their scatter."""
AMID = 5.0
"""… if they are no further away than so many usual spacings: a plane tells nothing far outside."""
SMOOTH = 0.5
"""This share of what is usual is taken for their scatter at least."""
SWARM, UNLIKE_GROUND = 0.015, 8.0
"""A larger share of the points is no swarm, but a part of the ground; and so is one whose heights
differ from the nearest ground's by less than this many times what is usual, without the slope of
the whole cloud."""
JOINED = 3.0
"""Cells of points that are no further apart than this are joined if their heights are."""
NEAREST = 12
"""Number of the nearest cells of ground that may explain a swarm."""
FITTED, ROUNDS = 2000, 8
"""Number of points to which the slope of a cloud is fitted, and of the rounds of the fit."""
ORDINARY = 3.0
"""It is fitted to points no further from the middle height than this times half of the range."""
COMPARED = 200
"""Number of points whose heights are compared over larger distances."""
SAMPLED = 500
"""Number of points that tell how rough a cloud is."""
POINTS_A_BIN = 300
"""Smallest number of differences of heights of which a median is taken."""


def find_outliers(points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
    """Find the outliers (n,) among finite points (n, 3) [m]; z points up."""
    outlier = np.zeros(len(points), bool)
    if len(points) >= LEAST_POINTS:
        # Swarms first: where one is dense, the ground beneath it seems to consist of outliers.
        for find in (_swarms, _lonely):
            remaining = np.flatnonzero(~outlier)
            outlier[remaining] = find(points[remaining])
    return outlier


def _level(points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Subtract a robust surface of second order from heights, beyond the core as a plane."""
    low, high = np.quantile(points, (CORE, 1 - CORE), axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    ordinary = (np.abs(points - middle) <= half * (1.0, 1.0, ORDINARY)).all(axis=1)
    some = _evenly(np.flatnonzero(ordinary), FITTED)
    across = (points[:, :2] - middle[:2]) / half[:2]
    bent = np.clip(across, -1, 1)
    terms = np.column_stack([np.ones(len(points)), across, bent**2, bent.prod(axis=1)])
    design, heights = terms[some], points[some, 2] - middle[2]
    weight, surface = np.ones(len(some)), np.zeros(terms.shape[1])
    for _ in range(ROUNDS):
        normal = (design.T * weight) @ design + 1e-6 * len(some) * np.eye(len(surface))
        surface = np.linalg.solve(normal, design.T @ (weight * heights))
        residual = heights - design @ surface
        weight = _cauchy(residual, 1.48 * float(np.median(np.abs(residual))))
    return np.column_stack([points[:, :2], points[:, 2] - terms @ surface])


def _cauchy(
    residual: Float[Array, "*shape"], scatter: float | Float[Array, "k 1"]
) -> Float[Array, "*shape"]:
    """Weigh residuals so that a few outliers do not turn a surface that is fitted to the rest."""
    limit = 1.5 * np.maximum(scatter, LEAST_STEP)
    return 1 / np.maximum(1.0, np.abs(residual) / limit) ** 2


def _lonely(points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
    """Find the points that their neighbours do not explain."""
    # Imported here because it loads slowly, and only clouds need it.
    from scipy.spatial import cKDTree  # noqa: PLC0415

    outlier = np.zeros(len(points), bool)
    xy, heights = points[:, :2], points[:, 2]
    low, sides, spacing = core_of(xy)
    if sides.min() <= LEAST_WIDTH:  # a line, which is refused elsewhere
        return outlier
    order, starts = _by_cells(xy, low, np.sqrt(9.0) * spacing)
    usual = _UsualDifference.of(points, order)
    doubtful = _doubtful(heights, order, starts, OUTLYING * usual(np.zeros(1))[0])
    if not len(doubtful):
        return outlier
    tree = cKDTree(xy, balanced_tree=False)

    def unlikeness(rows: Int[NDArray[np.intp], "k"]) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
        """By how many times what is usual points differ from others, and how far these are [m]."""
        distances, neighbours = map(np.asarray, tree.query(xy[rows], NUM_NEIGHBOURS + 1))
        times = np.abs(heights[neighbours] - heights[rows, None]) / usual(distances)
        # The first in order is the point itself, which differs by nothing.
        return np.sort(times, axis=1)[:, EXPLAINED_BY], distances[:, EXPLAINED_BY]

    times, reach = unlikeness(doubtful)
    too_far = min(LONELY * spacing, LONELY_SHARE * float(sides.max()))
    outlier[doubtful[reach > too_far]] = True
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
        outlier[doubtful[unexplained | (apart > too_far)]] = True
    return outlier | _unlike_around(points, outlier, order, starts, spacing, usual)


def core_of(
    xy: Float[Array, "n 2"],
) -> tuple[Float[Array, "2"], Float[Array, "2"], float]:
    """Measure where the core of a cloud begins, its sides, and the usual spacing of points [m]."""
    low, high = np.quantile(xy, (CORE, 1 - CORE), axis=0)
    sides = high - low
    # Along a narrow strip points follow each other.
    spacing = max(float(np.sqrt(sides.prod() / len(xy))), float(sides.max() / len(xy)))
    return low, sides, spacing


def _unlike_around(
    points: Float[Array, "n 3"],
    outlier: Bool[NDArray[np.bool_], "n"],
    order: Int[NDArray[np.intp], "n"],
    starts: Int[NDArray[np.intp], "cells"],
    spacing: float,
    usual: "_UsualDifference",
) -> Bool[NDArray[np.bool_], "n"]:
    """Find points that are far from the plane of their neighbours, in units of their scatter."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - loads slowly

    unlike = np.zeros(len(points), bool)
    least = UNLIKE_AROUND * SMOOTH * usual(np.zeros(1))[0]
    rows = _doubtful(points[:, 2], order, starts, float(least))
    rows = rows[~outlier[rows]]
    inliers = points[~outlier]
    if not len(rows) or len(inliers) <= AROUND:
        return unlike
    distances, near = map(np.asarray, cKDTree(inliers[:, :2]).query(points[rows, :2], AROUND + 1))
    # The first is the point itself.
    offsets = inliers[near[:, 1:]] - points[rows, None]
    middle = np.median(offsets[..., 2], axis=1)
    possible = np.abs(middle) > SMOOTH * UNLIKE_AROUND * usual(distances[:, EXPLAINED_BY])
    possible &= distances[:, EXPLAINED_BY] <= AMID * spacing
    rows, offsets = rows[possible], offsets[possible]
    middle, reach = middle[possible], distances[possible, EXPLAINED_BY]
    width = np.maximum(distances[possible, -1], 1e-9)[:, None]
    design = np.stack([np.ones_like(offsets[..., 0]), *(offsets[..., k] / width for k in (0, 1))])
    above = offsets[..., 2] - middle[:, None]
    weight, plane, scatter = np.ones_like(above), np.zeros((len(rows), 3)), np.zeros(len(rows))
    for _ in range(4):
        normal = np.einsum("ink,nk,jnk->nij", design, weight, design) + np.diag([1e-9, 0.5, 0.5])
        right = np.einsum("ink,nk,nk->ni", design, weight, above)
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        residual = above - np.einsum("ink,ni->nk", design, plane)
        scatter = 1.48 * np.median(np.abs(residual), axis=1)
        weight = _cauchy(residual, scatter[:, None])
    off = np.abs(middle + plane[:, 0])
    unlike[rows[off > UNLIKE_AROUND * np.maximum(scatter, SMOOTH * usual(reach))]] = True
    return unlike


def _swarms(points: Float[Array, "n 3"]) -> Bool[NDArray[np.bool_], "n"]:
    """Find swarms of few points that are above, below or far beside all others."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - loads slowly

    low, sides, spacing = core_of(points[:, :2])
    if sides.min() <= LEAST_WIDTH:
        return np.zeros(len(points), bool)
    points = _level(points)
    side = np.sqrt(9.0) * spacing
    usual = _UsualDifference.of(points, _by_cells(points[:, :2], low, side)[0])
    apart = UNLIKE_GROUND * float(usual(np.full(1, side))[0])
    column, row = np.floor((points[:, :2] - low) / side).astype(np.int64).T
    order = np.lexsort((points[:, 2], column, row))
    column, row, heights = column[order], row[order], points[order, 2]
    new = (np.diff(column) != 0) | (np.diff(row) != 0) | (np.diff(heights) > apart)
    starts = np.concatenate([[0], np.flatnonzero(new) + 1])
    counts = np.diff(starts, append=len(order))
    bottom, top = heights[starts], heights[starts + counts - 1]
    places = np.column_stack([column[starts], row[starts]]).astype(float)
    first, second = cKDTree(places).query_pairs(JOINED, output_type="ndarray").T
    gap = np.maximum(bottom[first], bottom[second]) - np.minimum(top[first], top[second])
    joined = gap <= apart
    piece = pieces(first[joined], second[joined], len(starts))
    sizes = np.bincount(piece, counts)
    swarm = (sizes <= SWARM * len(points))[piece]
    while swarm.any() and not swarm.all():  # until the ground explains no further piece
        ground = np.flatnonzero(~swarm)
        numbers = np.arange(1, min(NEAREST, len(ground)) + 1)
        away, near = map(np.asarray, cKDTree(places[ground]).query(places[swarm], numbers))
        near, nearest = ground[near], away[:, :1]
        gap = np.maximum(bottom[swarm, None], bottom[near])
        gap -= np.minimum(top[swarm, None], top[near])
        # The nearest ground decides: further away almost any height would be explained.
        allowed = UNLIKE_GROUND * usual(side * np.maximum(nearest, 1.0))
        likely = (gap <= allowed) & (away <= nearest + 1.0) & (nearest * side <= LONELY * spacing)
        explained = np.isin(piece, piece[swarm][likely.any(axis=1)])
        if not explained.any():
            break
        swarm &= ~explained
    in_swarm = np.zeros(len(points), bool)
    in_swarm[order] = np.repeat(swarm, counts)
    return in_swarm


def pieces(
    first: Int[NDArray[np.int64], "k"], second: Int[NDArray[np.int64], "k"], count: int
) -> Int[NDArray[np.int32], "count"]:
    """Number the pieces that links between so many cells join, for each cell."""
    from scipy.sparse import coo_matrix  # noqa: PLC0415 - loads slowly
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    links = coo_matrix((np.ones(len(first)), (first, second)), shape=(count, count))
    return np.asarray(connected_components(links, directed=False)[1])


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
        x, y, heights = points.T
        rows = _evenly(np.arange(len(order) - 1), 10 * COMPARED)
        near, after = order[rows], order[rows + 1]
        some = _evenly(order, COMPARED)
        far = np.tri(len(some), k=-1, dtype=bool)

        def differences_of(values: Float[Array, "n"]) -> Float[Array, "k"]:
            between = values[some, None] - values[some]
            return np.concatenate([values[near] - values[after], between[far]])

        distances = np.hypot(differences_of(x), differences_of(y))
        differences = np.abs(differences_of(heights))
        num_bins = int(np.log2(len(distances) / POINTS_A_BIN)) + 1
        ends = np.geomspace(min(POINTS_A_BIN, len(distances)), len(distances), num_bins + 1)
        inner = np.unique(ends.astype(int))[:-1]
        nearest_first = np.argpartition(distances, inner)
        bins = np.split(nearest_first, inner)
        medians = np.array([(np.median(distances[b]), np.median(differences[b])) for b in bins])
        # 1.48 times the median is the standard deviation of a normal variable.
        return cls(medians[:, 0], 1.48 * np.maximum.accumulate(medians[:, 1]))

    def __call__(self, distances: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        usual = np.interp(distances, self._distances, self._differences)
        return np.maximum(usual, LEAST_STEP + LEAST_SLOPE * distances)
