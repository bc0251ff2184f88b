"""True positions without headings, as a GNSS antenna gives them -> true poses.

The headings are those of odometry, turned so that the odometry's positions nearby lie on the true
ones. The toolkit of the S3LI dataset (DLR-RM/s3li-toolkit) does the same to give its D-GNSS
positions a heading, with three pieces for a traverse; here every submap has its own piece.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2, Pose, fit_se2

AROUND = 3
"""Submaps on either side by whose positions a heading is found."""
LONGEST = 2.0
"""Least extent of these positions [m]; from shorter pieces a heading is too uncertain."""


def poses_at(
    positions: Mapping[int, Float[Array, "3"]], odometry: Mapping[int, Pose]
) -> dict[int, Pose]:
    """Give true positions the headings of odometry, turned onto the positions around them.

    Args:
        positions: True position of each submap's origin [m], by its index; z points up.
        odometry: Level poses by odometry, by index.

    Returns:
        A level pose for each position that odometry knows; none at all if the traverse is shorter
        than `LONGEST`.
    """
    both = sorted(set(positions) & set(odometry))
    true = np.array([positions[k][:2] for k in both]).reshape(-1, 2)
    driven = np.array([odometry[k].translation[:2] for k in both]).reshape(-1, 2)
    poses: dict[int, Pose] = {}
    for place, index in enumerate(both):
        piece = _piece(true, driven, place)
        if piece is None:
            return {}
        turn = fit_se2(driven[piece], true[piece]).yaw
        x, y, z = positions[index].tolist()
        yaw = odometry[index].planar.yaw + turn
        poses[index] = Pose.from_planar(SE2(x, y, yaw), z)
    return poses


def _piece(true: Float[Array, "n 2"], driven: Float[Array, "n 2"], place: int) -> slice | None:
    """Choose the stretch around a place that is long enough to give a heading."""
    for reach in range(AROUND, max(len(true), AROUND + 1)):
        piece = slice(max(place - reach, 0), place + reach + 1)
        extents = [np.ptp(points[piece], axis=0).max(initial=0.0) for points in (true, driven)]
        if min(extents) >= LONGEST:
            return piece
    return None
