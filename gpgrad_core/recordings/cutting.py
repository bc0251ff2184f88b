"""Where one submap ends and the next begins."""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.trajectory import Poses

SHORTEST_STEP = 0.05
"""Length is counted in steps of this [m] or more. Otherwise the noise in the pose of a robot that
stands still would add up to a long drive."""


def cut(
    stamps: Float[Array, "n"],
    poses: Poses,
    params: BuildParams,
    covariance: Float[Array, "n 3 3"] | None = None,
) -> list[range]:
    """Divide scans into submaps; a scan that reaches a limit begins the next submap.

    Args:
        stamps: Time of each scan [s].
        poses: Pose of the robot at each scan, in a frame whose z points up.
        params: The limits.
        covariance: Covariance of each position [m²].

    Returns:
        The scans of each submap; each has one or more, and every scan is in one.

    Raises:
        InputError: If the uncertainty is limited but the covariances are not known.
    """
    if params.max_uncertainty is not None and covariance is None:
        raise InputError(
            "max_uncertainty needs poses with covariances: Odometry or "
            "PoseWithCovarianceStamped of a bag, or TUM rows with 36 further columns"
        )
    x_axis = poses.rotation.apply([1.0, 0.0, 0.0])
    heading = np.arctan2(x_axis[:, 1], x_axis[:, 0])
    positions = poses.translation
    starts: list[int] = []
    travelled, anchor, begun = 0.0, np.zeros(3), 0
    for k in range(len(stamps)):
        step = float(np.linalg.norm(positions[k] - anchor))
        if step >= SHORTEST_STEP:
            travelled, anchor = travelled + step, positions[k]
        if not starts or (
            _reached(travelled, params.max_length)
            or _reached(stamps[k] - stamps[begun], params.max_time)
            or _reached(_turn(heading[k] - heading[begun]), params.max_turn)
            or (
                covariance is not None
                and _reached(_growth(covariance[begun], covariance[k]), params.max_uncertainty)
            )
        ):
            starts.append(k)
            travelled, anchor, begun = 0.0, positions[k], k
    return [range(a, b) for a, b in zip(starts, [*starts[1:], len(stamps)], strict=True)]


def _reached(value: float, limit: float | None) -> bool:
    # Allow for rounding: 50 steps of 0.1 m add up to 4.999999999 m.
    return limit is not None and bool(value >= limit * (1.0 - 1e-6))


def _turn(angle: float) -> float:
    return abs((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _growth(before: Float[Array, "3 3"], after: Float[Array, "3 3"]) -> float:
    """Compute how much a position's standard deviation has grown, in its worst direction [m].

    Odometry adds up independent steps, so the covariance of the motion between two poses is the
    difference of their covariances.
    """
    return float(np.sqrt(max(0.0, float(np.linalg.eigvalsh(after - before)[-1]))))
