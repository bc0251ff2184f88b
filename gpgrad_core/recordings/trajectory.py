"""Poses over time, and the pose at any time between them."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation, Slerp

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.se2 import Pose

Stack: TypeAlias = Float[Array, "n 3"]


@dataclass(frozen=True, eq=False)
class Poses:
    """Rigid motions ``T_a_b``, one per row; ``T_a_b @ T_b_c`` is ``T_a_c``."""

    translation: Stack  # offsets (n, 3) [m]
    rotation: Rotation  # as many rotations

    def __len__(self) -> int:
        """Number of poses."""
        return len(self.translation)

    def __getitem__(self, chosen: NDArray[np.bool_] | NDArray[np.intp] | slice) -> "Poses":
        """Keep some of the poses."""
        return Poses(self.translation[chosen], self.rotation[chosen])

    def __matmul__(self, other: "Poses") -> "Poses":
        """Compose two stacks of the same length, or one pose with a stack."""
        return Poses(
            self.translation + self.rotation.apply(other.translation),
            self.rotation * other.rotation,
        )

    def inverse(self) -> "Poses":
        """``T_a_b.inverse()`` is ``T_b_a``."""
        back = self.rotation.inv()
        return Poses(-back.apply(self.translation), back)

    def one(self, index: int) -> Pose:
        """Give one pose as a `Pose`."""
        return Pose(self.translation[index], self.rotation[index].as_quat(canonical=True))

    @classmethod
    def of(cls, *poses: Pose) -> "Poses":
        """Make a stack of poses."""
        return cls(
            np.array([pose.translation for pose in poses]),
            Rotation.from_quat([pose.quaternion for pose in poses]),
        )

    @classmethod
    def identity(cls) -> "Poses":
        """Make a stack of one identity."""
        return cls(np.zeros((1, 3)), Rotation.identity(1))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses by time.

    Attributes:
        stamps: Times [s], increasing.
        poses: One pose per time.
        covariance: Covariance of each position [m²], where the source gives it.
        fixed: Whether the single pose holds at all times, as that of a sensor on a robot.
    """

    stamps: Float[Array, "n"]
    poses: Poses
    covariance: Float[Array, "n 3 3"] | None = None
    fixed: bool = False

    @classmethod
    def in_order(
        cls,
        stamps: Float[Array, "n"],
        poses: Poses,
        covariance: Float[Array, "n 3 3"] | None = None,
    ) -> "Trajectory":
        """Make a trajectory sorted by time; of poses with the same time the first is kept."""
        stamps, first = np.unique(stamps, return_index=True)
        kept = None if covariance is None else covariance[first]
        return cls(stamps, poses[first], kept)

    def at(self, wanted: Float[Array, "m"], params: BuildParams) -> "Located":
        """Find the poses at given times.

        Args:
            wanted: Times [s].
            params: Whether to interpolate, and how far from a pose a time may be.
        """
        if self.fixed:
            return Located(self.poses[np.zeros(len(wanted), np.intp)], np.ones(len(wanted), bool))
        last = len(self.stamps) - 1
        after = np.clip(np.searchsorted(self.stamps, wanted), 0, last)
        before = np.maximum(after - 1, 0)
        earlier = np.abs(wanted - self.stamps[before]) <= np.abs(self.stamps[after] - wanted)
        nearest = np.where(earlier, before, after)
        near = np.abs(self.stamps[nearest] - wanted) <= params.max_time_difference
        covariance = None if self.covariance is None else self.covariance[nearest]
        if params.pose_matching == "nearest" or last == 0:
            return Located(self.poses[nearest], near, covariance)
        # Beyond either end, the last known pose is used.
        inside = np.clip(wanted, self.stamps[0], self.stamps[-1])
        step = self.stamps[after] - self.stamps[before]
        share = np.where(step > 0, (inside - self.stamps[before]) / np.where(step > 0, step, 1), 0)
        ends = self.poses.translation
        translation = ends[before] + share[:, None] * (ends[after] - ends[before])
        rotation = Slerp(self.stamps, self.poses.rotation)(inside)
        return Located(Poses(translation, rotation), near, covariance)


@dataclass(frozen=True, eq=False)
class Located:
    """Poses at requested times.

    Attributes:
        poses: One pose per time.
        known: Whether each pose is known (n,); if not, the pose has no meaning.
        covariance: Covariance of each position (n, 3, 3) [m²], if the source gives it.
    """

    poses: Poses
    known: Bool[NDArray[np.bool_], "n"]
    covariance: Float[Array, "n 3 3"] | None = None

    def __matmul__(self, other: "Located") -> "Located":
        """Compose motions; a result is known if both motions are known."""
        return Located(self.poses @ other.poses, self.known & other.known, self.covariance)

    def inverse(self) -> "Located":
        """``T_a_b.inverse()`` is ``T_b_a``."""
        return Located(self.poses.inverse(), self.known)
