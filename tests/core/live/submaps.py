"""A few small submaps in a row, and somewhere to bring them."""

from dataclasses import replace

import numpy as np

from gpgrad_core.live.frames import Corrected
from gpgrad_core.run import Progress
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Submap
from tests.support.ground import submap


def row(count: int) -> list[Submap]:
    """Make submaps 000, 001 … a metre apart."""
    made: list[Submap] = []
    for k in range(count):
        pose = Pose.from_planar(SE2(float(k), 0.5 * k, 0.1 * k))
        made.append(replace(submap(k, num=60), id=f"{k:03d}", pose_odometry=pose))
    return made


class Track:
    """Takes each submap for what odometry says; 003 closes a loop with 000."""

    def __init__(self) -> None:
        self.submaps: list[Submap] = []

    @property
    def ids(self) -> list[str]:
        return [submap.id for submap in self.submaps]

    def compare(self, submap: Submap, progress: Progress) -> Corrected:
        progress(0.5)
        self.submaps.append(submap)
        poses = {s.id: s.pose_odometry.row for s in self.submaps if s.pose_odometry}
        return Corrected(submap.id, poses, [("003", "000")] if submap.id == "003" else [])


def assert_same_submap(made: Submap, given: Submap) -> None:
    assert (made.id, made.fingerprint) == (given.id, given.fingerprint)
    np.testing.assert_array_equal(made.points, given.points)
    for name in ("noise_std", "ranges", "colors", "left_out"):
        first, second = getattr(made, name), getattr(given, name)
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second)
    # A quaternion that travels is made of unit length again, which may change its last digit.
    for name in ("translation", "quaternion"):
        there, here = getattr(made.pose_odometry, name), getattr(given.pose_odometry, name)
        np.testing.assert_allclose(there, here, rtol=0, atol=1e-15)
