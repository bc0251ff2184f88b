"""How good a trajectory is (`evo`'s errors by true poses), and how well submaps agree."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.overlap import compare_footprints, make_footprint
from gpgrad_core.former import former_parameter
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Array, Submap

FEWEST_SHARE = 0.2
"""Least share of the smaller submap's cells that an overlap has; less is an edge seen from far
away."""


@dataclass(frozen=True)
class TrajectoryError:
    """How far a trajectory is from the true one."""

    count: int  # number of poses that were compared
    # root mean square of the distances [m], after the rigid motion that minimises it
    absolute: float
    absolute_median: float  # median of these distances [m]
    absolute_most: float  # largest of these distances [m]
    absolute_unaligned: float  # root mean square of the distances without that motion [m]
    # root mean square error of the offset from each pose to the next [m]; if the true headings are
    # not known, that of the offset's length
    relative: float
    # root mean square error of the turn from each pose to the next [rad]; None if the true headings
    # are not known
    relative_turn: float | None


@dataclass(frozen=True)
class HeightDifferences:
    """Differences in height where submaps overlap."""

    count: int  # number of pairs of submaps that share more than a fifth of their 10 cm cells
    # median of the pairs' median height differences [m]; None if there is no such pair
    median: float | None
    high: float | None  # 95th percentile of them [m]; None if there is no such pair


def positions(names: Iterable[str], poses: Mapping[str, Pose]) -> Float[Array, "n 3"]:
    """List the positions of named poses (n, 3) [m]."""
    return np.array([poses[name].translation for name in names]).reshape(-1, 3)


@former_parameter("found", "estimated")
def trajectory_error(
    true: Mapping[str, Pose], estimated: Mapping[str, Pose], *, positions_only: bool = False
) -> TrajectoryError:
    """Compare two trajectories, pose by pose.

    Args:
        true: True poses by id, in the order of the traverse.
        estimated: Estimated poses by id; submaps that have only one of the two are left out.
        positions_only: Whether the true poses have positions only, and their headings must not be
            used; see `Dataset.positions_only`.

    Raises:
        InputError: If fewer than two submaps have both.
    """
    names = [name for name in true if name in estimated]
    if len(names) < 2:
        raise InputError(
            f"a trajectory error needs two or more poses with a true pose, found {len(names)}"
        )
    truth, places = positions(names, true), positions(names, estimated)
    distances = np.linalg.norm(align_points(places, truth) - truth, axis=1)
    steps = [
        (true[a].inverse() @ true[b]).inverse() @ (estimated[a].inverse() @ estimated[b])
        for a, b in pairwise(names)
    ]
    turns = [
        2 * np.arctan2(np.linalg.norm(step.quaternion[:3]), step.quaternion[3]) for step in steps
    ]
    offsets = np.array([np.linalg.norm(step.translation) for step in steps])
    if positions_only:
        driven, drawn = (np.linalg.norm(np.diff(way, axis=0), axis=1) for way in (truth, places))
        offsets = drawn - driven
    return TrajectoryError(
        count=len(names),
        absolute=_rms(distances),
        absolute_median=float(np.median(distances)),
        absolute_most=float(distances.max()),
        absolute_unaligned=_rms(np.linalg.norm(places - truth, axis=1)),
        relative=_rms(offsets),
        relative_turn=None if positions_only else _rms(np.array(turns)),
    )


def align_points(points: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Move points [m] onto their targets by the best rigid motion (Umeyama 1991, Eqs. 39 to 41)."""
    middle, aim = points.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((target - aim).T @ (points - middle))
    mirrored = np.linalg.det(left) * np.linalg.det(right) < 0
    rotation = left @ np.diag([1.0, 1.0, -1.0 if mirrored else 1.0]) @ right
    return (points - middle) @ rotation.T + aim


def measure_consistency(submaps: Iterable[Submap], poses: Mapping[str, Pose]) -> HeightDifferences:
    """Compare the heights of overlapping submaps, ``T_world_submap`` by id, by cells of 10 cm."""
    footprints = [
        make_footprint(poses[submap.id].apply(submap.points))
        for submap in submaps
        if submap.id in poses
    ]
    differences: list[float] = []
    low = np.array([footprint.low for footprint in footprints]).reshape(-1, 2)
    high = np.array([footprint.high for footprint in footprints]).reshape(-1, 2)
    for k in range(1, len(footprints)):
        meeting = np.all((low[:k] < high[k]) & (high[:k] > low[k]), axis=1)
        for other in np.flatnonzero(meeting):
            _, overlap, difference = compare_footprints(footprints[k], footprints[other])
            if overlap > FEWEST_SHARE and np.isfinite(difference):
                differences.append(difference)
    if not differences:
        return HeightDifferences(0, None, None)
    median, high_end = np.median(differences), np.quantile(differences, 0.95)
    return HeightDifferences(len(differences), float(median), float(high_end))


def _rms(values: Float[NDArray[np.floating], "n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
