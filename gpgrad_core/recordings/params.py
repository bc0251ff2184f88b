"""How a recording becomes submaps."""

from dataclasses import dataclass
from typing import Annotated, Literal

from typing_extensions import Doc

from gpgrad_core.errors import InputError
from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds

UpAxis = Literal["auto", "x", "-x", "y", "-y", "z", "-z"]


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
        Literal["sensor", "world"],
        Doc("Frame of a scan's points: the sensor's, or already the poses' (world)."),
    ] = "sensor"
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
        """Check the bounds, and that something ends a submap.

        Raises:
            InputError: If not.
        """
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
