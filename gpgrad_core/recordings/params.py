"""How a recording becomes submaps, and which points of a scan are kept."""

import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from typing_extensions import Doc

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.reading.text import parse_number

Kind = TypeVar("Kind", bound=np.generic)
UpAxis = Literal["auto", "x", "-x", "y", "-y", "z", "-z"]
RELATIONS: dict[str, Callable[[Any, float], Any]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}


@dataclass(frozen=True)
class BuildParams:
    """Parameters of building submaps: where they end, which axis is up, how points are combined.

    A submap ends where the first of the limits is reached, as in the paper's Sec. VI-A: there
    the length of the trajectory since its origin, or the uncertainty of the pose.
    """

    max_length: Annotated[
        float | None,
        Bounds(0.1, 1000.0, 0.5, "m"),
        Doc("End a submap after this length of trajectory. None sets no limit."),
    ] = 5.0
    max_uncertainty: Annotated[
        float | None,
        Bounds(0.001, 100.0, 0.01, "m"),
        Doc(
            "End a submap once the position's standard deviation has grown by this since its "
            "origin. This needs poses with covariances. None sets no limit."
        ),
    ] = None
    max_turn: Annotated[
        float | None,
        Bounds(0.05, 3.14159, 0.05, "rad"),
        Doc(
            "End a submap once the heading differs this much from the heading at its origin. None "
            "sets no limit."
        ),
    ] = None
    max_time: Annotated[
        float | None,
        Bounds(0.1, 86_400.0, 1.0, "s"),
        Doc("End a submap after this time. None sets no limit."),
    ] = None
    gravity: Annotated[
        Literal["poses", "cloud"],
        Doc(
            "What says where up is: the frame of the poses, or the plane of the ground (cloud), "
            "over the whole recording."
        ),
    ] = "poses"
    up: Annotated[
        UpAxis,
        Doc("Axis of the poses' frame that points up. auto is z, or -y for KITTI's camera poses."),
    ] = "auto"
    points_frame: Annotated[
        Literal["auto", "sensor", "world"],
        Doc(
            "Frame of a scan's points: the sensor's, or already the poses' (world). auto is the "
            "sensor's, unless a bag gives its clouds in the frame of its poses."
        ),
    ] = "auto"
    pose_matching: Annotated[
        Literal["interpolate", "nearest"],
        Doc(
            "Pose of a scan: interpolated between the poses before and after it, or the nearest in"
            " time."
        ),
    ] = "interpolate"
    max_time_difference: Annotated[
        float,
        Bounds(0.0, 100.0, 0.01, "s"),
        Doc("A scan is left out if the nearest pose is further away in time than this."),
    ] = 0.1
    min_range: Annotated[
        float,
        Bounds(0.0, 100.0, 0.1, "m"),
        Doc("Points closer to the sensor than this, such as the robot itself, are left out."),
    ] = 0.0
    max_range: Annotated[
        float | None,
        Bounds(0.5, 1000.0, 0.5, "m"),
        Doc("Points further from the sensor than this are left out. None keeps all."),
    ] = None
    voxel_size: Annotated[
        float,
        Bounds(0.005, 5.0, 0.005, "m"),
        Doc("All points within one cube of this side are replaced by their mean."),
    ] = 0.04
    min_points: Annotated[
        int,
        Bounds(3, 1_000_000, 10, "points"),
        Doc("A submap with fewer points than this is left out."),
    ] = 100

    def __post_init__(self) -> None:
        check_bounds(self)
        if not any((self.max_length, self.max_uncertainty, self.max_turn, self.max_time)):
            raise InputError(
                "max_length, max_uncertainty, max_turn or max_time must be set: "
                "something has to end a submap"
            )
        if self.max_range is not None and self.max_range <= self.min_range:
            raise InputError(
                f"max_range must be above min_range, {self.min_range:g} m, got {self.max_range:g}"
            )


@dataclass(frozen=True)
class Condition:
    """A condition on a number of each point, such as ``intensity>3``."""

    field: str  # the number's name, as the file or the message calls it
    relation: str  # one of `RELATIONS`
    limit: float  # what it is compared with

    def __str__(self) -> str:
        return f"{self.field}{self.relation}{self.limit:g}"


def parse_condition(text: str) -> Condition:
    """Read a condition.

    >>> parse_condition("intensity > 3")
    Condition(field='intensity', relation='>', limit=3.0)
    """
    parts = re.fullmatch(r"\s*([A-Za-z_]\w*)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*", text)
    limit = None if parts is None else parse_number(parts[3])
    if parts is None or limit is None or not np.isfinite(limit):
        raise InputError(
            f"--keep {text}: a condition is a field, one of {' '.join(RELATIONS)} and a number, "
            "such as intensity>3"
        )
    return Condition(parts[1], parts[2], limit)


@dataclass
class PointFilter:
    """Keeps the points that meet all conditions, and counts them."""

    conditions: Sequence[Condition] = ()
    num_read: int = 0
    num_passed: int = 0

    def select(
        self,
        points: NDArray[Kind],
        values_of: Callable[[str], NDArray[np.generic] | None],
        where: str,
    ) -> NDArray[Kind]:
        """Select points (n, …) by their numbers (n,), which `values_of` gives by name, or None."""
        if not self.conditions:
            return points
        mask = np.ones(len(points), bool)
        for condition in self.conditions:
            values = values_of(condition.field)
            if values is None:
                raise InputError(
                    f"{where}: its points have no field {condition.field} for --keep {condition}"
                )
            values = np.asarray(values, np.float64)
            mask &= RELATIONS[condition.relation](values, condition.limit)
        self.num_read += len(mask)
        self.num_passed += int(mask.sum())
        return points[mask]
