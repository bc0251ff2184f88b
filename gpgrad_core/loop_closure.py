"""Accept or refuse a registration, with the reason."""

from dataclasses import dataclass
from typing import Annotated

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
    if registration.T_database_query is None:
        accepted, reason = False, "no motion found: the maps have too little in common"
    elif num < params.min_inliers:
        accepted, reason = False, f"{num} inliers < {params.min_inliers}"
    elif score < params.min_score:
        accepted, reason = False, f"score {score:.3g} < {params.min_score:g}" + _why(registration)
    else:
        accepted = True
        met = [f"{num} inliers >= {params.min_inliers}"] if params.min_inliers > 0 else []
        met += [f"score {score:.3g} >= {params.min_score:g}"] if params.min_score > 0 else []
        reason = ", ".join(met) or "no threshold is asked for"
    return LoopClosure(query_id, database_id, registration, accepted, reason)


def _why(registration: Registration) -> str:
    """Say what a low score comes from, where the ground was compared."""
    area = registration.overlap_area
    if area == 0:
        return ""
    return (
        f": slopes agree too weakly ({registration.correlation:.2f} over {area:.0f} m²), "
        f"{registration.num_inliers} inliers"
    )
