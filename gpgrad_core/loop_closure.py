"""Accept or refuse a registration, with the reason."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from typing_extensions import Doc

from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds
from gpgrad_core.types import LoopClosure, Registration


@dataclass(frozen=True)
class ClosureParams:
    """What a registration needs to count as a loop closure."""

    min_inliers: Annotated[
        int,
        Bounds(0, 1000, 1, "", slider=(0, 40)),
        Doc("Fewest inliers of a loop closure, the paper's threshold on n; the score counts them."),
    ] = 0
    min_score: Annotated[
        float,
        Bounds(0.0, 1_000_000.0, 0.1, "", slider=(0.0, 12.0)),
        Doc("Lowest score of a loop closure; 3: one in a thousand unrelated pairs reaches it."),
    ] = 3.0
    max_std: Annotated[
        float,
        Bounds(0.01, 1000.0, 0.01, "m", slider=(0.05, 2.0)),
        Doc("Largest standard deviation of the place of a loop closure, in any direction."),
    ] = 0.5

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


def classify(
    registration: Registration,
    params: ClosureParams | None = None,
    *,
    query_id: str = "query",
    database_id: str = "database",
) -> LoopClosure:
    """Decide whether a registration is a loop closure: the paper's AcceptTransformation.

    Args:
        registration: Of the query to the database.
        params: Thresholds.
        query_id: Name of the query submap.
        database_id: Name of the database submap.
    """
    params = params or ClosureParams()
    num, score = registration.num_inliers, registration.score
    std = _worst_std(registration)
    accepted, reason = False, ""
    if registration.T_database_query is None:
        reason = "no motion was found: the maps have too little in common"
        if registration.nothing_trusted:
            reason = "cannot judge: the variance mask trusts no cell of a map"
    elif num < params.min_inliers:
        reason = f"{num} inliers < {params.min_inliers}"
    elif score < params.min_score:
        reason = f"score {score:.3g} < {params.min_score:g}" + _why(registration)
    elif std is not None and std > params.max_std:
        reason = (
            f"the ground lets the submap slide: its place is known to {std:.2g} m only, and "
            f"{params.max_std:g} m is allowed"
        )
    else:
        accepted = True
        met = [f"{num} inliers >= {params.min_inliers}"] if params.min_inliers > 0 else []
        met += [f"score {score:.3g} >= {params.min_score:g}"] if params.min_score > 0 else []
        reason = ", ".join(met) or "no threshold is asked for"
    return LoopClosure(query_id, database_id, registration, accepted, reason)


LITTLE_AREA = 8.0
"""Common ground of less than so many patches of 2π scale² holds few features [patches]."""
IMPOSSIBLE = 1.5
"""Heights that differ by more than so many times what is possible speak against the motion."""
SMOOTH = 4.0
"""Relief of less than so many times what the maps leave unknown tells no places apart."""


def _worst_std(registration: Registration) -> float | None:
    """Tell the standard deviation of the place along its least certain direction [m]."""
    if registration.covariance is None or not np.isfinite(registration.covariance).all():
        return None
    return float(np.sqrt(max(np.linalg.eigvalsh(registration.covariance[:2, :2])[-1], 0.0)))


def _why(registration: Registration) -> str:
    """Say what speaks against a motion, where the ground was compared."""
    told, area, scale = registration.agreement, registration.overlap_area, registration.scale
    if told is None or scale is None:
        return f": only {area:.2g} m² of the ground are common" if area > 0 else ""
    if told.difference > IMPOSSIBLE * told.possible:
        return (
            f": over {area:.0f} m² in common the heights differ by {_length(told.difference)}, "
            f"where {_length(told.possible)} are possible"
        )
    if area < LITTLE_AREA * 2 * np.pi * scale**2:
        return f": only {area:.2g} m² of the ground are common, too little to tell"
    if told.relief < SMOOTH * told.possible:
        return (
            f": the ground is too smooth to tell: its relief is {_length(told.relief)}, and the "
            f"maps leave {_length(told.possible)} unknown"
        )
    return (
        f": over {area:.0f} m² in common the heights agree to {_length(told.difference)}, but so "
        f"might other ground, with {registration.num_inliers} inliers"
    )


def _length(metres: float) -> str:
    return f"{1e3 * metres:.2g} mm" if metres < 0.01 else f"{100 * metres:.2g} cm"
