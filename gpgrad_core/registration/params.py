"""How a pair of maps is registered."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds


@dataclass(frozen=True)
class RegistrationParams:
    """How a pair of maps is registered."""

    inlier_radius: Annotated[
        float,
        Bounds(0.01, 10.0, 0.01, "m", slider=(0.05, 1.0)),
        Doc("An association is an inlier if its keypoints meet within this distance."),
    ] = 0.3
    trials: Annotated[
        int,
        Bounds(10, 100_000, 10, "", slider=(100, 10_000)),
        Doc("Random pairs of associations that RANSAC tries."),
    ] = 5000
    hypotheses: Annotated[
        int,
        Bounds(1, 100, 1, "", slider=(1, 30)),
        Doc("Best motions by inliers that are aligned and checked densely."),
    ] = 12
    searched: Annotated[
        int,
        Bounds(0, 100, 1, "", slider=(0, 20)),
        Doc("Motions that an exhaustive search, which needs no keypoints, adds to these."),
    ] = 6
    seed: Annotated[int, Doc("Of the random choices; the same seed gives the same answer.")] = 0

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
