"""The same ground in other frames."""

from dataclasses import replace
from math import radians

from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, Submap

UTM = SE2(500_000.0, 5_200_000.0)
SHIFTS = (SE2(60.0, 0.0), SE2(-300.0, 200.0), UTM)
TURNED = tuple(SE2(shift.x, shift.y, radians(77.0)) for shift in (SE2(), *SHIFTS))


def in_frame(dataset: Dataset, T_frame_submap: SE2) -> Dataset:
    """Give all submaps another frame; the ground stays where it is in the world."""
    motion = Pose.from_planar(T_frame_submap)
    back = motion.inverse()
    submaps = tuple(
        Submap.from_points(
            motion.apply(submap.points),
            submap.id,
            pose_true=submap.pose_true and submap.pose_true @ back,
            pose_odometry=submap.pose_odometry and submap.pose_odometry @ back,
            ground=None,
        )
        for submap in dataset.submaps
    )
    return replace(dataset, submaps=submaps)
