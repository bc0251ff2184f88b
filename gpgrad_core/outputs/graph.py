"""A pose graph in g2o's text format: odometry and the accepted loop closures."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds
from gpgrad_core.errors import InputError
from gpgrad_core.outputs.files import replacing
from gpgrad_core.types import Array, Dataset, LoopClosure, Pose


@dataclass(frozen=True)
class GraphParams:
    """How sure the edges of a pose graph are of themselves."""

    odometry_std: Annotated[
        float,
        Bounds(0.0001, 100.0, 0.01, "m"),
        Doc("Standard deviation of the odometry's offset between two submaps."),
    ] = 0.1
    odometry_yaw_std: Annotated[
        float,
        Bounds(0.0001, 3.2, 0.001, "rad"),
        Doc("Standard deviation of the odometry's turn between two submaps."),
    ] = 0.02
    tilt_std: Annotated[
        float,
        Bounds(0.0001, 3.2, 0.001, "rad"),
        Doc("Standard deviation of roll and pitch, which gravity gives."),
    ] = 0.01
    association_std: Annotated[
        float,
        Bounds(0.0001, 10.0, 0.01, "m"),
        Doc("Standard deviation of one inlier's position; n of them give a closure's."),
    ] = 0.15
    unseen_std: Annotated[
        float,
        Bounds(0.0001, 1000.0, 0.1, "m"),
        Doc("Standard deviation of a closure's height, which the plane does not see."),
    ] = 10.0

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


def check_graph(dataset: Dataset) -> None:
    """Check that a dataset has what a pose graph needs, before the long work.

    Raises:
        InputError: If a submap has no odometry pose.
    """
    _odometry(dataset)


def write_graph(
    path: Path | str,
    dataset: Dataset,
    closures: Iterable[LoopClosure],
    params: GraphParams | None = None,
) -> None:
    """Write the pose graph of a traverse, for any optimiser that reads g2o.

    Vertices are the odometry's poses; edges join neighbours, and the two submaps of each accepted
    closure. A vertex has the number that the submap is named by, or its place in the dataset where
    names are not numbers.

    Args:
        path: The ``.g2o`` file, of ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT`` lines.
        dataset: Its odometry is needed.
        closures: Those refused are left out.
        params: How sure the edges are; None means the defaults.

    Raises:
        InputError: If a submap has no odometry pose, or the file cannot be written there.
        OSError: If writing fails.
    """
    params = params or GraphParams()
    poses = _odometry(dataset)
    numbers = _numbers(dataset)
    lines = [f"VERTEX_SE3:QUAT {numbers[name]} {_text(pose)}" for name, pose in poses.items()]

    names = list(poses)
    information = _information(
        params.odometry_std, params.odometry_std, params.tilt_std, params.odometry_yaw_std
    )
    for earlier, later in pairwise(names):
        T_earlier_later = _between(poses[earlier], poses[later])
        lines.append(_edge(numbers[earlier], numbers[later], T_earlier_later, information))

    for closure in closures:
        motion = closure.registration.T_database_query
        if not closure.accepted or motion is None:
            continue
        database, query = closure.database_id, closure.query_id
        # Both frames are gravity-aligned, so that the turn is all yaw. The height is not estimated:
        # the odometry's stands in, with next to no weight.
        height = _between(poses[database], poses[query]).translation[2]
        T_database_query = Pose(
            np.array([motion.x, motion.y, height]),
            np.array([0.0, 0.0, np.sin(motion.yaw / 2), np.cos(motion.yaw / 2)]),
        )
        n, area = closure.registration.num_inliers, closure.registration.overlap_area
        offset_std = params.association_std / np.sqrt(max(n, 1))
        # Points spread over a disc lie sqrt(area / 2 pi) rms from its centre: the lever of the yaw.
        yaw_std = offset_std / max(np.sqrt(area / (2 * np.pi)), 0.1)
        information = _information(offset_std, params.unseen_std, params.tilt_std, yaw_std)
        lines.append(_edge(numbers[database], numbers[query], T_database_query, information))

    with replacing(path) as unfinished:
        unfinished.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _odometry(dataset: Dataset) -> dict[str, Pose]:
    poses = {submap.id: submap.pose_odometry for submap in dataset.submaps}
    missing = [name for name, pose in poses.items() if pose is None]
    if missing:
        raise InputError(
            f"{dataset.name}: a pose graph needs odometry, and submap {missing[0]} has none "
            f"({len(missing)} of {len(poses)} lack it); add it to poses_odom.txt"
        )
    return {name: pose for name, pose in poses.items() if pose is not None}


def _numbers(dataset: Dataset) -> dict[str, int]:
    names = [submap.id for submap in dataset.submaps]
    if all(name.isdecimal() for name in names) and len({int(name) for name in names}) == len(names):
        return {name: int(name) for name in names}
    return {name: place for place, name in enumerate(names)}


def _between(a: Pose, b: Pose) -> Pose:
    """``T_a_b`` of two poses ``T_world_a``, ``T_world_b``."""
    turn_a, turn_b = Rotation.from_quat(a.quaternion), Rotation.from_quat(b.quaternion)
    return Pose(
        np.asarray(turn_a.inv().apply(b.translation - a.translation)),
        np.asarray((turn_a.inv() * turn_b).as_quat(canonical=True)),
    )


def _information(
    offset_std: float, height_std: float, tilt_std: float, yaw_std: float
) -> Float[Array, "6"]:
    """Diagonal of an edge's information matrix: x, y, z, then the quaternion's qx, qy, qz.

    A small turn by an angle has half of it as its quaternion's vector part: hence half the
    standard deviation.
    """
    std = np.array([offset_std, offset_std, height_std, tilt_std / 2, tilt_std / 2, yaw_std / 2])
    return 1.0 / std**2


def _edge(start: int, end: int, T_start_end: Pose, information: Float[Array, "6"]) -> str:
    upper = np.diag(information)[np.triu_indices(6)]
    weights = " ".join(f"{weight:.9g}" for weight in upper)
    return f"EDGE_SE3:QUAT {start} {end} {_text(T_start_end)} {weights}"


def _text(pose: Pose) -> str:
    return " ".join(f"{number:.9g}" for number in (*pose.translation, *pose.quaternion))
