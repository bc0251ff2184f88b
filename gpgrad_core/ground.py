"""Which points of a cloud are ground: outliers, and what stands on the ground, are left out.

Bushes, walls and people are nothing that an elevation map can hold. Where many points are above
others, a progressive morphological filter (Zhang et al. 2003, IEEE TGRS 41(4); slopes as in
Pingel, Clarke & McBride 2013, ISPRS J. 77) keeps the largest piece of ground. Known filters (CSF,
PDAL, Patchwork++) lack wheels for some Pythons, and cut off boulders and cliffs, which are terrain
here.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.outliers import core_of, find_outliers, pieces
from gpgrad_core.se2 import Pose
from gpgrad_core.types import GroundChoice, Submap, check_coordinates, read_only

LEAST_POINTS = 300
"""A smaller cloud shows too little: nothing counts as above its ground."""
CELL, FINEST = 2.0, 0.01
"""Side of the cells in which points are above each other, in usual spacings of the points, and at
least this share of the longer side of the cloud."""
STEEP, TALL, NOISY = 2.0, 0.05, 15.0
"""A point is above others if it is higher than the lowest of its cell by more than a slope of this
[m/m], this share of the longer side of the cloud, and this many times the noise of the lowest
points explain: 1,000 heights of one cell range over so much."""
CALM = 0.1
"""Share of the cloud that is calmer than where its noise is measured: most may not be ground."""
EVIDENCE = 0.03
"""Share of the points that must be above others before anything is left out."""
RISE = 0.6
"""Loose ground rests at slopes up to about this [m/m]: what rises more from all around is none."""
WIDEST = 0.25
"""Largest distance over which a rise is looked for, as a share of the longer side of the cloud."""
JOINED = 3.0
"""Pieces of ground that are no further apart than this hang together [cells]."""
LEAST_GROUND = 0.1
"""A smaller share of the points, such as the crown of a tree, is no ground: none is left out."""
MOST_SIDES = 5.0
"""In a cloud wider than its core by more than this factor nothing counts as above the ground."""


def submap_of_cloud(
    points: Float[NDArray[np.floating], "n 3"],
    id: str = "cloud",
    *,
    pose_true: Pose | None = None,
    pose_odometry: Pose | None = None,
    colors: Float[NDArray[np.floating], "n 3"] | None = None,
    noise_std: Float[NDArray[np.floating], "n"] | None = None,
    ranges: Float[NDArray[np.floating], "n"] | None = None,
    ground: GroundChoice | None = "automatic",
) -> Submap:
    """Make a submap of a cloud; see `Submap.from_points`."""
    rows = np.asarray(points)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{id}: points must be an (n, 3) array, got shape {rows.shape}")
    check_coordinates(rows, id)
    taken = np.asarray(np.isfinite(rows).all(axis=1))
    usable = rows[taken].astype(np.float64, copy=False)
    outlier, non_ground = np.zeros((2, len(usable)), bool)
    if ground is not None:
        outlier = find_outliers(usable)
        non_ground[~outlier] = find_non_ground(usable[~outlier], ground)
    if non_ground.any():  # bare ground tells better what its outliers are
        bare = ~(outlier | non_ground)
        outlier[bare] = find_outliers(usable[bare])
    unwanted, left_out = outlier | non_ground, None
    num_dropped = len(rows) - len(usable)
    if unwanted.any():
        left_out, usable = usable[unwanted], usable[~unwanted]
        read_only(left_out)
        taken[taken] = ~unwanted
    chosen = (
        None if values is None else values[taken].astype(np.float64, copy=False)
        for values in (colors, noise_std, ranges)
    )
    return Submap(
        id,
        np.empty((0, 3)),
        "",
        pose_true,
        pose_odometry,
        num_dropped=num_dropped,
        num_outliers=int(outlier.sum()),
        num_non_ground=int(non_ground.sum()),
        left_out=left_out,
    ).refilled(usable, *chosen)


def find_non_ground(
    points: Float[Array, "n 3"], choice: GroundChoice = "automatic"
) -> Bool[NDArray[np.bool_], "n"]:
    """Find the points (n,) that stand on the ground, of finite ones [m] that are no outliers."""
    non_ground = np.zeros(len(points), bool)
    if choice == "all" or len(points) < LEAST_POINTS:
        return non_ground
    _, sides, spacing = core_of(points[:, :2])
    longest = float(sides.max())
    cell = max(CELL * spacing, FINEST * longest)
    if cell <= 0 or np.ptp(points[:, :2], axis=0).max() > MOST_SIDES * longest:
        return non_ground
    lowest, owner = _lowest(points, cell)
    above = points[:, 2] - lowest.ravel()[owner]
    diagonal = np.sqrt(2) * cell
    is_above = above > max(STEEP * diagonal, TALL * longest, NOISY * _noise_of(lowest))
    if choice == "automatic" and np.mean(is_above) < EVIDENCE:
        return non_ground
    rising = _rising(lowest, cell, WIDEST * longest)
    ground = ~rising.ravel()[owner] & (above <= RISE * diagonal)
    if not ground.any():
        return non_ground
    chosen = np.flatnonzero(ground)
    ground[chosen] = _largest_piece(points[chosen], owner[chosen], cell)
    return non_ground if ground.mean() < LEAST_GROUND else ~ground


def _lowest(
    points: Float[Array, "n 3"], cell: float
) -> tuple[Float[Array, "rows columns"], Int[NDArray[np.int64], "n"]]:
    """Find the lowest height of each square cell, infinite in empty ones, and each point's cell."""
    column, row = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64).T
    shape = int(row.max()) + 1, int(column.max()) + 1
    owner = row * shape[1] + column
    lowest = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(lowest, owner, points[:, 2])
    return lowest.reshape(shape), owner


def _noise_of(lowest: Float[Array, "rows columns"]) -> float:
    """Estimate the noise of the lowest points [m] from how they bend where they are calm."""
    from scipy.special import ndtri  # noqa: PLC0415 - loads slowly

    heights = np.where(np.isinf(lowest), np.nan, lowest)
    bends = np.abs(np.concatenate([np.diff(heights, 2, axis=k).ravel() for k in (0, 1)]))
    bends = bends[np.isfinite(bends)]
    # The second difference of three values of variance 1 has the variance 1 + 4 + 1.
    normal = float(ndtri((1 + CALM) / 2)) * np.sqrt(6)
    return float(np.quantile(bends, CALM)) / normal if len(bends) else np.inf


def _rising(
    lowest: Float[Array, "rows columns"], cell: float, widest: float
) -> Bool[NDArray[np.bool_], "rows columns"]:
    """Find the cells that rise too steeply from all around, over ever larger distances."""
    from scipy.ndimage import maximum_filter, minimum_filter  # noqa: PLC0415 - loads slowly

    rising, left, reach = np.isinf(lowest), lowest, 1
    while reach * cell <= widest:
        lower = minimum_filter(left, 2 * reach + 1, mode="nearest")
        opened = maximum_filter(np.where(np.isinf(lower), -np.inf, lower), 2 * reach + 1)
        rising = rising | (left - opened > RISE * reach * cell)
        left = np.where(rising, np.inf, left)
        reach = max(reach + 1, int(1.5 * reach))
    return rising


def _largest_piece(
    points: Float[Array, "n 3"], owner: Int[NDArray[np.int64], "n"], cell: float
) -> Bool[NDArray[np.bool_], "n"]:
    """Find the points of the cells that hang together with most others by gentle slopes."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - loads slowly

    _, index, counts = np.unique(owner, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(index, points[:, k]) / counts for k in range(3)], axis=1)
    pairs = cKDTree(means[:, :2]).query_pairs(JOINED * cell, output_type="ndarray")
    apart = means[pairs[:, 0]] - means[pairs[:, 1]]
    gentle = np.abs(apart[:, 2]) <= RISE * np.maximum(np.hypot(apart[:, 0], apart[:, 1]), cell)
    first, second = pairs[gentle].T
    piece = pieces(first, second, len(means))
    return (piece == np.bincount(piece, counts).argmax())[index]
