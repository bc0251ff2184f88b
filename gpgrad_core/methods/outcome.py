"""What rivals return, in the terms of the pipeline; most of them know no dense check."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration


def outcome(
    motion: SE2 | None, inliers: Bool[NDArray[np.bool_], "m"], score: float | None = None
) -> Registration:
    """Make a registration of what has no overlap to compare densely.

    Args:
        motion: Maps the query's frame into the database's; None if there is none.
        inliers: Which associations agree with it.
        score: The rival's own confidence; None: the number of inliers, as the paper's Sec. VII.
    """
    value = float(np.sum(inliers)) if score is None else float(score)
    return Registration(motion, inliers, np.inf, 0.0, 0.0, value)


LEAST_INLIERS = 8
"""Of a rival's loop closure, unless more are asked for."""


def judged_by_inliers(params: PipelineParams) -> PipelineParams:
    """Leave the verdict to the inliers: another score has another scale."""
    num = max(params.closure.min_inliers, LEAST_INLIERS)
    return replace(params, closure=replace(params.closure, min_inliers=num, min_score=0.0))


def seen_from_above(
    T_database_query: Float[Array, "4 4"], query_points: Float[Array, "n 3"]
) -> SE2:
    """Reduce a motion in space to the plane; both frames are gravity-aligned.

    The turn is the yaw closest to the rotation. The shift puts the middle of the query where the
    whole motion puts it: that of the origin would take a tilt about a far point for a shift.

    Args:
        T_database_query: Rigid motion as a matrix.
        query_points: What was moved [m].
    """
    rotation, translation = T_database_query[:3, :3], T_database_query[:3, 3]
    yaw = float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))
    middle = query_points.mean(axis=0)
    there = (rotation @ middle + translation)[:2]
    turned = SE2(0.0, 0.0, yaw).apply(middle[None, :2])[0]
    return SE2(float(there[0] - turned[0]), float(there[1] - turned[1]), yaw)
