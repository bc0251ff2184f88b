"""Which way is up."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.voxels import Voxels

GROUND_VOXEL = 0.2
"""Points are thinned to voxels of this side [m] first. Otherwise the dense ground close to the
robot would decide."""
TRIM = 2.5
"""Points further from the plane than this many standard deviations do not count as ground."""
ROUNDS = 10
LEAST_POINTS = 20


def up_axis(name: str) -> Float[Array, "3"]:
    """Give the direction of an axis by its name, such as ``-y``."""
    up = np.zeros(3)
    up["xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    return up


def turned_upright(up: Float[Array, "3"]) -> Rotation:
    """Give the smallest rotation that turns a direction to z."""
    cosine = float(np.clip(up[2] / np.linalg.norm(up), -1.0, 1.0))
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:  # along z already; a direction that points down is turned about x
        axis, length = np.array([1.0, 0.0, 0.0]), 1.0
    return Rotation.from_rotvec(np.arccos(cosine) * axis / length)


def ground_normal(points: Float[Array, "n 3"]) -> Array | None:
    """Fit a plane to the ground; each round leaves out the points that lie off the last plane.

    Args:
        points: Positions relative to the sensor [m], which is above the ground.

    Returns:
        The plane's normal (3,), pointing up; None if there are too few points.
    """
    thinned = Voxels.of(points, np.zeros(len(points)), GROUND_VOXEL).points
    if len(thinned) < LEAST_POINTS:
        return None
    kept = thinned
    normal = np.array([0.0, 0.0, 1.0])
    for _ in range(ROUNDS):
        centre = kept.mean(axis=0)
        normal = np.linalg.eigh(np.cov((kept - centre).T))[1][:, 0]
        height = (thinned - centre) @ normal
        spread = 1.4826 * float(np.median(np.abs(height)))
        chosen = np.abs(height) <= TRIM * max(spread, 1e-6)
        if chosen.sum() < LEAST_POINTS:
            break
        kept = thinned[chosen]
    return normal if kept.mean(axis=0) @ normal < 0 else -normal


@dataclass(frozen=True, eq=False)
class UpEstimate:
    """The direction up, estimated from ground planes."""

    up: Float[Array, "3"]  # unit vector that points up (3,)
    spread: float  # median angle between it and the planes' normals [rad]


def estimate_up(normals: list[Array], where: str) -> UpEstimate:
    """Estimate the direction up from the ground planes of a recording; slopes average out.

    Args:
        normals: Normals (3,) of the planes, in the frame of the poses.
        where: Name of the recording, for the error message.

    Raises:
        InputError: If there are no planes, or they disagree.
    """
    if not normals:
        raise InputError(
            f"{where}: no scan shows enough ground to find the direction up; "
            "take gravity from the poses"
        )
    stacked = np.array(normals)
    middle = np.median(stacked, axis=0)
    length = float(np.linalg.norm(middle))
    if length < 0.5:
        raise InputError(
            f"{where}: the scans disagree on the direction up; take gravity from the poses"
        )
    up = middle / length
    angles = np.arccos(np.clip(stacked @ up, -1.0, 1.0))
    return UpEstimate(up, float(np.median(angles)))
