"""Measures how far submaps truly overlap, by which every pair is judged."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import index_of
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, Dataset, Submap, read_only

Index = NDArray[np.intp]

CELL = 0.1
"""Side of the cells [m]; the overlap of two surfaces is their share of common cells."""

FEWEST_COMMON_CELLS = 20
"""With no more common cells than this, a median height difference is not meaningful."""


@dataclass(frozen=True, eq=False)
class TruePairs:
    """What the true poses say about every unordered pair of submaps."""

    ids: tuple[str, ...]  # names of the n submaps that have a true pose, in the dataset's order
    centres: Float[Array, "n 2"]  # `Submap.centre` of each, seen from above (n, 2) [m]
    world_xy: Float[Array, "n 2"]  # where these are in the world (n, 2) [m]
    query: Int[Index, "p"]  # index into `ids` of the later submap of each pair (p,)
    database: Int[Index, "p"]  # index of the earlier submap (p,)
    # distance of the two on the traverse (p,): the difference of their numbers
    steps: Int[Index, "p"]
    box_iou: Float[Array, "p"]  # intersection over union of their bounding boxes (p,), Eq. (8).
    # share of the cells of the submap with fewer cells that are common (p,)
    surface_overlap: Float[Array, "p"]
    # median difference of the heights on common cells (p,) [m]; NaN if there are too few
    height_difference: Float[Array, "p"]
    T_database_query: tuple[SE2, ...]  # true motion of each pair
    notes: tuple[str, ...] = ()  # what could not be judged, one line each
    # whether the true headings were not measured, so that turns are not judged
    positions_only: bool = False

    def __post_init__(self) -> None:
        read_only(self.centres, self.world_xy, self.query, self.database, self.steps)
        read_only(self.box_iou, self.surface_overlap, self.height_difference)

    def __len__(self) -> int:
        return len(self.query)

    @cached_property
    def rows(self) -> Mapping[frozenset[str], int]:
        """Index of each pair by the ids of its two submaps, in either order."""
        return {
            frozenset((self.ids[query], self.ids[database])): row
            for row, (query, database) in enumerate(zip(self.query, self.database, strict=True))
        }

    @property
    def relative_yaw(self) -> Float[Array, "p"]:
        return np.array([-motion.yaw for motion in self.T_database_query], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Footprint:
    """The ground that a submap covers in the world."""

    low: Float[Array, "2"]  # lowest x and y of its box (2,) [m]
    high: Float[Array, "2"]  # highest x and y of its box (2,) [m]
    cells: Int[NDArray[np.int64], "c"]  # keys of the cells that hold a point (c,), ascending
    heights: Float[Array, "c"]  # mean height of the points in each cell (c,) [m]


def measure_pairs(
    dataset: Dataset,
    progress: Progress = silent,
    *,
    only: Collection[tuple[str, str]] | None = None,
) -> TruePairs:
    """Measure how far the submaps of a dataset truly overlap; ``only`` are pairs of ids or None."""
    placed = [submap for submap in dataset.submaps if submap.pose_true is not None]
    if len(placed) < 2:
        raise InputError(
            f"{dataset.name}: {len(placed)} of {len(dataset.submaps)} submaps have a true pose, "
            "and two are needed to judge a pair: add poses_gt.txt with rows "
            "`index tx ty tz qx qy qz qw`"
        )
    footprints: list[Footprint] = []
    for k, submap in enumerate(placed):
        assert submap.pose_true is not None
        footprints.append(make_footprint(submap.pose_true.apply(submap.points)))
        progress(0.5 * (k + 1) / len(placed))
    poses = [submap.pose_true.planar for submap in placed if submap.pose_true is not None]
    centres = np.array([submap.centre[:2] for submap in placed])
    numbers = _numbers(placed)
    pairs = [(query, database) for database, query in combinations(range(len(placed)), 2)]
    pairs.sort()
    notes = _notes(dataset)
    if only is not None:
        chosen = {frozenset(pair) for pair in only}
        all_of_them = len(pairs)
        pairs = [pair for pair in pairs if frozenset(placed[k].id for k in pair) in chosen]
        if not pairs:
            raise InputError(f"{dataset.name}: none of the pairs has two true poses there")
        notes = (
            *notes,
            f"only the {len(pairs):,} listed of {all_of_them:,} pairs are compared and judged",
        )
    measured = np.zeros((len(pairs), 3))
    for k, (query, database) in enumerate(pairs):
        measured[k] = compare_footprints(footprints[query], footprints[database])
        if database == 0 or only is not None:
            progress(0.5 + 0.5 * k / len(pairs))
    query, database = np.array(pairs, dtype=np.intp).T
    return TruePairs(
        ids=tuple(submap.id for submap in placed),
        centres=centres,
        world_xy=np.concatenate(
            [pose.apply(centre[None]) for pose, centre in zip(poses, centres, strict=True)]
        ),
        query=query,
        database=database,
        steps=np.abs(numbers[query] - numbers[database]),
        box_iou=measured[:, 0].copy(),
        surface_overlap=measured[:, 1].copy(),
        height_difference=measured[:, 2].copy(),
        T_database_query=tuple(poses[d].inverse() @ poses[q] for q, d in pairs),
        notes=notes,
        positions_only=dataset.positions_only,
    )


def box_iou(
    first: tuple[Float[Array, "2"], Float[Array, "2"]],
    second: tuple[Float[Array, "2"], Float[Array, "2"]],
) -> float:
    """Compute the intersection over union of two axis-aligned boxes.

        IoU = |A ∩ B| / |A ∪ B|    Le Gentil 2020, Eq. (8)

    A box is its lowest and its highest corner [m].

    >>> square = np.zeros(2), np.ones(2)
    >>> beside = np.array([0.5, 0.0]), np.array([1.5, 1.0])
    >>> round(box_iou(square, beside), 3)
    0.333
    """
    (low_a, high_a), (low_b, high_b) = first, second
    sides = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    if (sides <= 0).any():
        return 0.0
    common = float(np.prod(sides))
    return common / (float(np.prod(high_a - low_a)) + float(np.prod(high_b - low_b)) - common)


def make_footprint(points: Float[Array, "n 3"]) -> Footprint:
    """Make the footprint of points (n, 3) in the world [m]."""
    column, row = np.floor(points[:, :2] / CELL).astype(np.int64).T
    cells, members = np.unique((row << 32) + column, return_inverse=True)
    heights = np.bincount(members, points[:, 2]) / np.bincount(members)
    xy = points[:, :2]
    return Footprint(xy.min(axis=0), xy.max(axis=0), cells, heights)


def compare_footprints(first: Footprint, second: Footprint) -> tuple[float, float, float]:
    """Box IoU, surface overlap and median height difference [m], NaN of too few common cells."""
    iou = box_iou((first.low, first.high), (second.low, second.high))
    # Cells reach beyond their points, so boxes that are just apart can still share some.
    if (first.low > second.high + CELL).any() or (second.low > first.high + CELL).any():
        return iou, 0.0, np.nan
    common, in_first, in_second = np.intersect1d(
        first.cells, second.cells, assume_unique=True, return_indices=True
    )
    overlap = len(common) / min(len(first.cells), len(second.cells))
    if len(common) <= FEWEST_COMMON_CELLS:
        return iou, overlap, np.nan
    difference = np.abs(first.heights[in_first] - second.heights[in_second])
    return iou, overlap, float(np.median(difference))


def _numbers(submaps: list[Submap]) -> Index:
    """List the places on the traverse: the numbers in the names, or the order if one has none."""
    numbers = [index_of(submap.id) for submap in submaps]
    if None in numbers:
        return np.arange(len(submaps), dtype=np.intp)
    return np.array(numbers, dtype=np.intp)


def _notes(dataset: Dataset) -> tuple[str, ...]:
    notes: list[str] = []
    if dataset.positions_only:
        notes.append(
            "only the positions of the true poses were measured: a motion is right by its offset "
            "alone, and its turn is not judged"
        )
    if unknown := [submap.id for submap in dataset.submaps if submap.pose_true is None]:
        few = ", ".join(unknown[:5]) + (", …" if len(unknown) > 5 else "")
        notes.append(
            f"{len(unknown)} of {len(dataset.submaps)} submaps have no true pose ({few}): "
            "their pairs are not judged"
        )
    return tuple(notes)
