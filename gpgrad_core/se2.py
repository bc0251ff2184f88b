"""Rigid motions of the plane, and the one that fits two sets of points best."""

from dataclasses import dataclass
from math import atan2, cos, sin

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array


@dataclass(frozen=True)
class SE2:
    """A motion of the plane; ``T_a_b`` maps b-coordinates to a, so ``T_a_b @ T_b_c`` is ``T_a_c``.

    Attributes:
        x: Offset along x [m].
        y: Offset along y [m].
        yaw: Turn, anticlockwise [rad].
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    @property
    def rotation(self) -> Float[Array, "2 2"]:
        """Matrix of the turn."""
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
        """Turn vectors of frame b, such as slopes, into frame a."""
        return vectors @ self.rotation.T

    def inverse(self) -> "SE2":
        """``T_a_b.inverse()`` is ``T_b_a``."""
        x, y = -self.rotation.T @ self.translation
        return SE2(float(x), float(y), -self.yaw)

    def __matmul__(self, other: "SE2") -> "SE2":
        """Compose: ``T_a_b @ T_b_c`` is ``T_a_c``; the yaw comes out in (-pi, pi]."""
        x, y = self.rotation @ other.translation + self.translation
        yaw = self.yaw + other.yaw
        return SE2(float(x), float(y), atan2(sin(yaw), cos(yaw)))


def fit_se2(source: Float[Array, "n 2"], target: Float[Array, "n 2"]) -> SE2:
    """Fit ``T_target_source``, the least-squares motion that takes each source point to its target.

    In the plane the turn has a closed form, ``yaw = atan2(Σ a x b, Σ a · b)`` on centred points.
    The SVD of the paper's GetSE2Transform leaves the sign of a null vector arbitrary for two
    pairs, so that half of the minimal samples come out mirrored.

    Args:
        source: Points in the source frame [m].
        target: The same points in the target frame [m], in the same order.

    Raises:
        ValueError: If there are fewer than two pairs, or not as many of one as of the other.
    """
    if source.shape != target.shape or len(source) < 2:
        raise ValueError(
            f"fit_se2 needs two or more pairs of points, got {len(source)} and {len(target)}"
        )
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_mean, target - target_mean
    yaw = atan2(
        float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])),
        float(np.sum(a * b)),
    )
    x, y = target_mean - SE2(yaw=yaw).rotation @ source_mean
    return SE2(float(x), float(y), yaw)


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid motion in space, as a TUM row has it: ``p_world = R p_submap + t``."""

    translation: Float[Array, "3"]  # [m]
    quaternion: Float[Array, "4"]  # (x, y, z, w), of unit length

    @property
    def rotation(self) -> Float[Array, "3 3"]:
        """Matrix of the turn."""
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
        """Make the motion between two gravity-aligned frames, whose turn is all yaw.

        Args:
            motion: What is seen from above.
            z: Offset upwards [m].
        """
        half = 0.5 * motion.yaw
        return cls(
            np.array([motion.x, motion.y, z], dtype=np.float64),
            np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
        )

    def inverse(self) -> "Pose":
        """``T_a_b.inverse()`` is ``T_b_a``."""
        return Pose(
            -(self.translation @ self.rotation), self.quaternion * np.array([-1.0, -1.0, -1.0, 1.0])
        )

    def __matmul__(self, other: "Pose") -> "Pose":
        """Compose: ``T_a_b @ T_b_c`` is ``T_a_c``; the quaternion's w comes out at 0 or above."""
        u, w = self.quaternion[:3], self.quaternion[3]
        v, r = other.quaternion[:3], other.quaternion[3]
        turn = np.array([*(w * v + r * u + np.cross(u, v)), w * r - u @ v])
        turn *= np.copysign(1.0, turn[3]) / np.linalg.norm(turn)
        return Pose(self.rotation @ other.translation + self.translation, turn)
