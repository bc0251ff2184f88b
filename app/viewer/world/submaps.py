"""The whole dataset in one frame: the poses and the statistics of its submaps."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, degrees, sqrt
from typing import Literal, TypeAlias, get_args

import numpy as np

from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, Submap

PoseSource: TypeAlias = Literal["corrected", "true", "odometry", "in rows"]
WorldColor: TypeAlias = Literal["submap", "elevation", "deviation", "gradient"]

WORLD_COLORS: tuple[WorldColor, ...] = get_args(WorldColor)
GAP = 1.15
"""Distance of submaps in rows, in widths of the widest."""
FOOTPRINT_CELL = 0.25
"""Ground is seen where a square of this side holds a point [m]."""


@dataclass(frozen=True)
class WorldOptions:
    """How the world is drawn.

    Attributes:
        poses: Which poses the submaps stand at.
        color: What colours them.
        names: Write its id above each submap.
        trajectories: Draw the trajectory of each source of poses.
        loops: Draw the accepted loop closures.
        refused: Draw the pairs that were refused too.
    """

    poses: PoseSource = "odometry"
    color: WorldColor = "submap"
    names: bool = True
    trajectories: bool = True
    loops: bool = True
    refused: bool = False


def pose_sources(
    dataset: Dataset, corrected: Mapping[str, Pose] | None = None
) -> tuple[PoseSource, ...]:
    """List where poses can come from, odometry first; "in rows" where there are none."""
    found: list[PoseSource] = []
    if any(submap.pose_odometry for submap in dataset.submaps):
        found.append("odometry")
    if corrected:
        found.append("corrected")
    if any(submap.pose_true for submap in dataset.submaps):
        found.append("true")
    return tuple(found) or ("in rows",)


def poses_of(
    dataset: Dataset, source: PoseSource, corrected: Mapping[str, Pose] | None = None
) -> dict[str, Pose]:
    """Give ``T_world_submap`` of each submap that the source knows, in the dataset's order."""
    if source == "in rows":
        return _in_rows(dataset)
    known: dict[str, Pose | None] = {
        submap.id: {
            "true": submap.pose_true,
            "odometry": submap.pose_odometry,
            "corrected": (corrected or {}).get(submap.id),
        }[source]
        for submap in dataset.submaps
    }
    return {name: pose for name, pose in known.items() if pose is not None}


def _in_rows(dataset: Dataset) -> dict[str, Pose]:
    """Lay submaps without poses out in rows."""
    middles = [
        (submap.points.min(axis=0) + submap.points.max(axis=0)) / 2 for submap in dataset.submaps
    ]
    widest = max(float(np.ptp(submap.points[:, :2], axis=0).max()) for submap in dataset.submaps)
    columns = ceil(sqrt(len(dataset.submaps)))
    return {
        submap.id: Pose(
            np.array([GAP * widest * (k % columns), -GAP * widest * (k // columns), 0.0]) - middle,
            np.array([0.0, 0.0, 0.0, 1.0]),
        )
        for k, (submap, middle) in enumerate(zip(dataset.submaps, middles, strict=True))
    }


@dataclass(frozen=True)
class Statistics:
    """Statistics of one submap.

    Attributes:
        num_points: Of the cloud.
        size: Sides of its box, x, y and z in its own frame [m].
        area: Ground on which there are points [m²].
        height_std: Standard deviation of the points' heights [m].
        pose_true: Where it truly lies, if known.
        pose_odometry: Where the robot believed it to lie, if known.
        pose_corrected: Where the pose graph puts it, if there is one.
    """

    num_points: int
    size: tuple[float, float, float]
    area: float
    height_std: float
    pose_true: Pose | None = None
    pose_odometry: Pose | None = None
    pose_corrected: Pose | None = None

    @property
    def density(self) -> float:
        """Points on a square metre of ground seen."""
        return self.num_points / self.area


def measure(submap: Submap, corrected: Pose | None = None) -> Statistics:
    """Measure a submap."""
    points = submap.points
    x, y, z = (float(side) for side in np.ptp(points, axis=0))
    return Statistics(
        len(points),
        (x, y, z),
        footprint(submap),
        float(points[:, 2].std()),
        submap.pose_true,
        submap.pose_odometry,
        corrected,
    )


def footprint(submap: Submap) -> float:
    """Measure the ground on which a submap has points [m²]."""
    columns, rows = np.floor(submap.points[:, :2] / FOOTPRINT_CELL).astype(np.int64).T
    # One number a cell: sorting rows of two takes ten times as long.
    cells = np.unique(columns * (np.ptp(rows) + 1) + rows)
    return len(cells) * FOOTPRINT_CELL**2


def statistics_rows(statistics: Statistics) -> tuple[tuple[str, str], ...]:
    """Write the figures as rows of a name and a value with its unit."""
    x, y, z = statistics.size
    rows = [
        ("points", f"{statistics.num_points:,}"),
        ("extent", f"{x:.1f} m x {y:.1f} m, {z:.2f} m high"),
        ("ground seen", f"{statistics.area:.1f} m²"),
        ("density", f"{statistics.density:.0f} points/m²"),
        ("height std", f"{statistics.height_std:.3f} m"),
    ]
    for name, pose in (
        ("true pose", statistics.pose_true),
        ("odometry", statistics.pose_odometry),
        ("corrected", statistics.pose_corrected),
    ):
        if pose is not None:
            rows.append((name, describe_pose(pose)))
    if statistics.pose_true is not None:
        for name, pose in (
            ("odometry off by", statistics.pose_odometry),
            ("corrected off by", statistics.pose_corrected),
        ):
            if pose is not None:
                off = np.linalg.norm(pose.translation - statistics.pose_true.translation)
                rows.append((name, f"{off:.2f} m"))
    return tuple(rows)


def describe_pose(pose: Pose) -> str:
    """Write a pose's position and heading."""
    x, y, z = pose.translation
    return f"{x:z.2f}, {y:z.2f}, {z:z.2f} m; {degrees(pose.planar.yaw):+z.1f}°"
