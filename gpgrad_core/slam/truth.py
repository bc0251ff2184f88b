"""True poses, and the absolute and relative trajectory error by them, as `evo` defines them."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Array, Dataset

LEAST_SPREAD = 1.0
"""Root mean square distance from the middle [m] from which positions tell a direction."""


@dataclass(frozen=True)
class TrajectoryError:
    """How far a trajectory is from the true one.

    Attributes:
        count: Number of poses that were compared.
        absolute: Root mean square of the distances [m], after the rigid motion that minimises it.
        absolute_median: Median of these distances [m].
        absolute_most: Largest of these distances [m].
        absolute_unaligned: Root mean square of the distances without that motion [m].
        relative: Root mean square error of the offset from each pose to the next [m]; if the true
            headings are not known, that of the offset's length.
        relative_turn: Root mean square error of the turn from each pose to the next [rad]; None if
            the true headings are not known.
    """

    count: int
    absolute: float
    absolute_median: float
    absolute_most: float
    absolute_unaligned: float
    relative: float
    relative_turn: float | None


def true_poses(dataset: Dataset) -> dict[str, Pose]:
    """Give the true pose of every submap that has one, by id, in the dataset's order."""
    poses = {submap.id: submap.pose_true for submap in dataset.submaps}
    return {name: pose for name, pose in poses.items() if pose is not None}


def trajectory_error(
    true: Mapping[str, Pose], found: Mapping[str, Pose], *, positions_only: bool = False
) -> TrajectoryError:
    """Compare two trajectories, pose by pose.

    Args:
        true: True poses by id, in the order of the traverse.
        found: Estimated poses by id; submaps that have only one of the two poses are left out.
        positions_only: Whether the true poses have positions only, and their headings must not be
            used; see `Dataset.positions_only`.

    Returns:
        The absolute and relative errors.

    Raises:
        InputError: If fewer than two submaps have both.
    """
    names = [name for name in true if name in found]
    if len(names) < 2:
        raise InputError(
            f"a trajectory error needs two or more poses with a true pose, found {len(names)}"
        )
    truth = np.array([true[name].translation for name in names])
    places = np.array([found[name].translation for name in names])
    distances = np.linalg.norm(align_points(places, truth) - truth, axis=1)
    unaligned = np.linalg.norm(places - truth, axis=1)
    steps = [
        (true[a].inverse() @ true[b]).inverse() @ (found[a].inverse() @ found[b])
        for a, b in pairwise(names)
    ]
    turns = [
        2 * np.arctan2(np.linalg.norm(step.quaternion[:3]), step.quaternion[3]) for step in steps
    ]
    offsets = [np.linalg.norm(step.translation) for step in steps]
    if positions_only:
        lengths = [np.linalg.norm(np.diff(one, axis=0), axis=1) for one in (truth, places)]
        offsets = list(lengths[1] - lengths[0])
    return TrajectoryError(
        count=len(names),
        absolute=_rms(distances),
        absolute_median=float(np.median(distances)),
        absolute_most=float(distances.max()),
        absolute_unaligned=_rms(unaligned),
        relative=_rms(np.array(offsets)),
        relative_turn=None if positions_only else _rms(np.array(turns)),
    )


def align_points(points: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
    """Move points [m] onto their targets by the best rigid motion, without a change of scale.

    Umeyama 1991, Eqs. (39) to (41). If the points lie on one line, the turn about it is arbitrary,
    but the remaining distances do not depend on it.
    """
    middle, aim = points.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((target - aim).T @ (points - middle))
    mirrored = np.linalg.det(left) * np.linalg.det(right) < 0
    rotation = left @ np.diag([1.0, 1.0, -1.0 if mirrored else 1.0]) @ right
    return (points - middle) @ rotation.T + aim


def level_motion(places: Float[Array, "n 3"], target: Float[Array, "n 3"]) -> Pose:
    """Find the motion about the vertical that brings points onto their targets best.

    Args:
        places: Positions [m].
        target: Where they belong [m].

    Returns:
        ``T_target_places``; without a turn if all places are nearly one.
    """
    middle, aim = places.mean(axis=0), target.mean(axis=0)
    x, y, _ = (places - middle).T
    along, across, _ = (target - aim).T
    spread = float(np.sqrt(np.mean(x * x + y * y)))
    yaw = float(np.arctan2(x @ across - y @ along, x @ along + y @ across))
    turn = SE2(0.0, 0.0, yaw if spread > LEAST_SPREAD else 0.0)
    offset = aim[:2] - turn.apply(middle[None, :2])[0]
    motion = SE2(float(offset[0]), float(offset[1]), turn.yaw)
    return Pose.from_planar(motion, float(aim[2] - middle[2]))


def _rms(values: Float[NDArray[np.floating], "n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
