"""Accept or refuse a registration, with the reason."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds
from gpgrad_core.types import LoopClosure, Registration


@dataclass(frozen=True)
class ClosureParams:
    """What a registration needs to count as a loop closure."""

    min_inliers: Annotated[
        int,
        Bounds(2, 1000, 1, "", slider=(2, 40)),
        Doc("Fewest inliers of a loop closure: the paper's threshold on n."),
    ] = 8
    min_score: Annotated[
        float,
        Bounds(0.0, 1_000_000.0, 0.1, "", slider=(0.0, 50.0)),
        Doc("Lowest score of a loop closure; unrelated ground stayed below 6 on every set tried."),
    ] = 7.0

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
        accepted, reason = False, "no motion is supported by two associations"
    elif num < params.min_inliers:
        accepted, reason = False, f"{num} inliers < {params.min_inliers}"
    elif score < params.min_score:
        accepted, reason = False, f"score {score:.3g} < {params.min_score:g}"
    else:
        accepted = True
        reason = f"{num} inliers >= {params.min_inliers}"
        if params.min_score > 0:
            reason += f", score {score:.3g} >= {params.min_score:g}"
    return LoopClosure(query_id, database_id, registration, accepted, reason)
