"""Which pairs of submaps are likely loop closures, before they are compared."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.pairs import PairOfIds
from gpgrad_core.detection.shortlist import Shortlist
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, Features, Submap

Cells: TypeAlias = Int[NDArray[np.int64], "_count"]
NEAREST = 400
"""Of so many pairs, those that are closest for their size, the overlap is measured."""
FEW_POINTS = 3000
"""So many points of a submap, spread evenly, tell its ground."""
CELLS_ACROSS = 24
"""The ground is told by cells of this share of a submap's width."""
AROUND = 2.0
"""A pair is a revisit if the way between its submaps is longer than so many times the distance at
which their surfaces part. Else they overlap because they follow each other."""
MOST_EXTRACTED = 60
"""Without poses, so many submaps at most are searched: each costs a map."""


def odometry_or_true_pose(submap: Submap) -> Pose | None:
    """Give a submap's pose by odometry, or else the true one; None if neither is known."""
    return submap.pose_odometry or submap.pose_true


def closest_pair(dataset: Dataset, of: str | None = None) -> PairOfIds | None:
    """Find the two submaps, no neighbours on the way, that odometry or the truth has closest.

    With the id of a submap, it is one of the two. None where too few poses are known.
    """
    submaps = dataset.submaps
    positions = np.full((len(submaps), 2), np.nan)
    for row, submap in enumerate(submaps):
        pose = odometry_or_true_pose(submap)
        if pose is not None:
            positions[row] = pose.apply(submap.centre[None])[0, :2]
    best, closest = np.inf, None
    for query in range(2, len(submaps)):
        # As far as infinity from what has no pose.
        distances = np.linalg.norm(positions[: query - 1] - positions[query], axis=1)
        distances = np.where(np.isnan(distances), np.inf, distances)
        if of is not None and submaps[query].id != of:
            distances[[submap.id != of for submap in submaps[: query - 1]]] = np.inf
        nearest = int(distances.argmin())
        if distances[nearest] < best:
            best, closest = distances[nearest], (submaps[query].id, submaps[nearest].id)
    return closest


def overlapping_pairs(dataset: Dataset, count: int) -> tuple[PairOfIds, ...]:
    """List up to so many pairs whose surfaces overlap most by odometry, or else by the truth.

    Revisits come first, before submaps that merely follow each other on the way. The likeliest is
    the first; there is none where no poses are known.
    """
    poses = [odometry_or_true_pose(submap) for submap in dataset.submaps]
    rows = [row for row, pose in enumerate(poses) if pose is not None]
    if len(rows) < 2:
        return ()
    grounds: list[Float[Array, "p 2"]] = []
    for row in rows:
        pose, submap = poses[row], dataset.submaps[row]
        assert pose is not None
        some = submap.points[:: max(1, submap.num_points // FEW_POINTS)]
        grounds.append(pose.apply(some)[:, :2])
    lows = np.array([ground.min(axis=0) for ground in grounds])
    highs = np.array([ground.max(axis=0) for ground in grounds])
    middles, reach = (lows + highs) / 2, np.linalg.norm(highs - lows, axis=1) / 2
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middles, axis=0), axis=1))])
    cell = float(np.median(2 * reach)) / CELLS_ACROSS
    cells: dict[int, Cells] = {}

    def ground_cells(k: int) -> Cells:
        if k not in cells:
            column, row = np.floor(grounds[k] / cell).astype(np.int64).T
            cells[k] = np.unique((row << 32) + column)
        return cells[k]

    likely: list[tuple[bool, float, int, int]] = []
    for query, database in _nearest(middles, reach):
        first, second = ground_cells(query), ground_cells(database)
        common = len(np.intersect1d(first, second, assume_unique=True))
        if common:
            around = way[query] - way[database] > AROUND * (reach[query] + reach[database])
            overlap = common / min(len(first), len(second))
            likely.append((bool(around), overlap, query, database))
    likely.sort(key=lambda pair: (not pair[0], -pair[1], pair[2], pair[3]))
    names = [dataset.submaps[row].id for row in rows]
    return tuple((names[query], names[database]) for _, _, query, database in likely[:count])


def _nearest(middles: Float[Array, "n 2"], reach: Float[Array, "n"]) -> list[tuple[int, int]]:
    """List the pairs (query, earlier database) that are closest for their size; no neighbours."""
    nearest: list[tuple[float, int, int]] = []
    for query in range(2, len(middles)):
        apart = np.linalg.norm(middles[: query - 1] - middles[query], axis=1)
        relative = apart / np.maximum(reach[: query - 1] + reach[query], 1e-9)
        near = np.flatnonzero(relative < 1.0)
        nearest += [(float(relative[k]), query, int(k)) for k in near]
    return [(query, database) for _, query, database in sorted(nearest)[:NEAREST]]


def voted_pairs(
    dataset: Dataset,
    count: int,
    extract: Callable[[Submap], Features],
    progress: Progress = silent,
) -> tuple[PairOfIds, ...]:
    """List up to so many pairs whose keypoints agree most: for each submap its best earlier one.

    Poses are not used. The pair with the most votes comes first. Neighbours in the dataset's order
    are left out, because they overlap anyway.
    """
    every = max(1, -(-len(dataset.submaps) // MOST_EXTRACTED))
    submaps = dataset.submaps[::every]
    apart = 2 if every == 1 else 1
    shortlist = Shortlist()
    voted: list[tuple[int, int, PairOfIds]] = []
    for k, submap in enumerate(submaps):
        features = extract(submap)
        earlier = [before.id for before in submaps[: max(0, k + 1 - apart)]]
        if earlier:
            best = shortlist.candidates(features, 1, among=earlier)[0]
            voted.append((-best.votes, k, (submap.id, best.id)))
        shortlist.add(submap.id, features)
        progress((k + 1) / len(submaps))
    return tuple(pair for _, _, pair in sorted(voted)[:count])
