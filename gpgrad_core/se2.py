"""Rigid motions of the plane and of space, and the motion that fits two sets of points best."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, sin
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array

FAR = 1000.0
"""Distance from a frame's origin [m] beyond which numbers need more digits than near it: in files,
pages, and the information of an error at the origin."""
PoseRow: TypeAlias = tuple[float, float, float, float, float, float, float]
"""The numbers of a TUM row: x, y, z [m], qx, qy, qz, qw."""
UPRIGHT = 0.95
"""If the vertical part of a body's x axis is longer than this, its y axis gives the heading."""


@dataclass(frozen=True)
class SE2:
    """A motion of the plane; ``T_a_b`` maps b-coordinates to a, so ``T_a_b @ T_b_c`` is ``T_a_c``.

    Attributes:
        x: Offset along x [m].
        y: Offset along y [m].
        yaw: Rotation, anticlockwise [rad].
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def rotation(self) -> Float[Array, "2 2"]:
        """Rotation matrix (2, 2)."""
        c, s = cos(self.yaw), sin(self.yaw)
        return np.array([[c, -s], [s, c]])

    @property
    def translation(self) -> Float[Array, "2"]:
        """The offset (x, y) [m]."""
        return np.array([self.x, self.y], dtype=np.float64)

    def apply(self, points: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Map points of frame b [m] into frame a [m]."""
        return points @ self.rotation.T + self.translation

    def rotate(self, vectors: Float[Array, "n 2"]) -> Float[Array, "n 2"]:
        """Rotate vectors of frame b (n, 2), such as slopes, into frame a."""
        return vectors @ self.rotation.T

    def inverse(self) -> "SE2":
        """Invert: ``T_a_b.inverse()`` is ``T_b_a``."""
        x, y = -self.rotation.T @ self.translation
        return SE2(float(x), float(y), -self.yaw)

    def __matmul__(self, other: "SE2") -> "SE2":
        """Compose: ``T_a_b @ T_b_c`` is ``T_a_c``, with its yaw in (-pi, pi]."""
        x, y = self.rotation @ other.translation + self.translation
        yaw = self.yaw + other.yaw
        return SE2(float(x), float(y), atan2(sin(yaw), cos(yaw)))


def turned_by(vectors: Float[Array, "*n 2"], yaw: Float[Array, "n"]) -> Float[Array, "n 2"]:
    """Turn each vector, or the same one, by angles [rad]."""
    x, y, c, s = vectors[..., 0], vectors[..., 1], np.cos(yaw), np.sin(yaw)
    return np.column_stack([c * x - s * y, s * x + c * y])


def move_covariance(
    covariance: Float[Array, "*n 3 3"], arm: Float[Array, "*n 2"]
) -> Float[Array, "*n 3 3"]:
    """A covariance (..., 3, 3) of x, y [m] and yaw [rad] at another point of the moved body.

    An error of the yaw swings a point by its arm (..., 2) [m], along the same axes. So a motion has
    as many covariances as points, and the one at a far origin says little.
    """
    lever = np.broadcast_to(np.eye(3), covariance.shape).copy()
    lever[..., 0, 2], lever[..., 1, 2] = -arm[..., 1], arm[..., 0]
    return lever @ covariance @ np.swapaxes(lever, -1, -2)


def fit_se2(source: Float[Array, "n 2"], target: Float[Array, "n 2"]) -> SE2:
    """Fit ``T_target_source``, the least-squares motion of source points to their targets [m].

    This is the paper's GetSE2Transform (Algorithm 1). In the plane the rotation has a closed
    form on centred points a and b:

        yaw = atan2(Σ a x b, Σ a · b)

    The paper uses an SVD. For two pairs of points it leaves the sign of a null vector open, so
    that half of the minimal samples come out mirrored.

    Raises:
        ValueError: If there are fewer than two pairs, or if the numbers of points differ.
    """
    if source.shape != target.shape or len(source) < 2:
        raise ValueError(
            f"fit_se2 needs two or more pairs of points, got {len(source)} and {len(target)}"
        )
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    yaw = atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    x, y = target_mean - SE2(yaw=yaw).rotation @ source_mean
    return SE2(float(x), float(y), yaw)


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion in space, as in a TUM row: ``p_world = R p_submap + t``.

    Attributes:
        translation: The offset t (3,) [m].
        quaternion: The rotation R as a quaternion (x, y, z, w) of unit length.
    """

    translation: Float[Array, "3"]
    quaternion: Float[Array, "4"]

    @property
    def row(self) -> PoseRow:
        """The pose as numbers."""
        x, y, z, qx, qy, qz, qw = (*self.translation.tolist(), *self.quaternion.tolist())
        return x, y, z, qx, qy, qz, qw

    @classmethod
    def of_row(cls, row: Sequence[float] | Float[Array, "7"]) -> "Pose":
        """Make a pose of the numbers of its `row`; the quaternion has unit length there."""
        return cls(np.array(row[:3]), np.array(row[3:]))

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """Rotation matrix (3, 3)."""
        x, y, z, w = self.quaternion
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    def apply(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Map points of the submap's frame [m] into the world [m]."""
        return points @ self.rotation.T + self.translation

    @property
    def planar(self) -> SE2:
        """The pose seen from above: ``T_world_submap`` of a gravity-aligned frame."""
        rotation = self.rotation
        yaw = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
        return SE2(float(self.translation[0]), float(self.translation[1]), yaw)

    @classmethod
    def from_planar(cls, motion: SE2, z: float = 0.0) -> "Pose":
        """Make the motion between two gravity-aligned frames, which differ by a yaw only.

        Args:
            motion: The motion as seen from above.
            z: Offset upwards [m].
        """
        half = 0.5 * motion.yaw
        return cls(
            np.array([motion.x, motion.y, z], dtype=np.float64),
            np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
        )

    def inverse(self) -> "Pose":
        """Invert: ``T_a_b.inverse()`` is ``T_b_a``."""
        return Pose(
            -(self.translation @ self.rotation), self.quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
        )

    def __matmul__(self, other: "Pose") -> "Pose":
        """Compose: ``T_a_b @ T_b_c`` is ``T_a_c``, with a quaternion whose w is not negative."""
        u, w = self.quaternion[:3], self.quaternion[3]
        v, r = other.quaternion[:3], other.quaternion[3]
        turn = np.array([*(w * v + r * u + np.cross(u, v)), w * r - u @ v])
        turn *= np.copysign(1.0, turn[3]) / np.linalg.norm(turn)
        return Pose(self.rotation @ other.translation + self.translation, turn)


def level_pose(pose: Pose) -> Pose:
    """The level frame at a pose: z up, x along the body's x axis as seen from above."""
    forward = pose.rotation[:, 0]
    if abs(forward[2]) > UPRIGHT:  # x points up or down and gives no heading
        forward = pose.rotation[:, 1]
    x, y, z = pose.translation.tolist()
    return Pose.from_planar(SE2(x, y, float(np.arctan2(forward[1], forward[0]))), z)
