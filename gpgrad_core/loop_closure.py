"""Accept or refuse a registration, with the reason."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds


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
        Doc("Lowest score of a loop closure."),
    ] = 0.0

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
