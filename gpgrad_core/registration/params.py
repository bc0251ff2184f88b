"""How a pair of maps is registered."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.params.bounds import SEEDS, Bounds
from gpgrad_core.params.fields import check_bounds

RADIUS_IN_SCALES = 1.25
"""Inlier radius [scales of comparison]. Measured on four sets, whole, thinned and noisy: at 1 dense
clouds lose inliers, and at 1.5 sparse ones take chance for inliers."""
UNSCALED_RADIUS = 0.3
"""Inlier radius of what knows no scale of comparison [m]."""


@dataclass(frozen=True)
class RegistrationParams:
    """How a pair of maps is registered."""

    inlier_radius: Annotated[
        float | None,
        Bounds(0.01, 10.0, 0.01, "m", slider=(0.05, 1.0)),
        Doc(
            "An association is an inlier if its keypoints meet within this distance. "
            "None: 1.25 times the scale of comparison, for keypoints are about as sharp as that."
        ),
    ] = None
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
    seed: Annotated[
        int, SEEDS, Doc("Of the random choices; the same seed gives the same answer.")
    ] = 0

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)

    def radius(self, scale: float | None) -> float:
        """Give the inlier radius [m] of maps that are compared at a scale [m], if any is known."""
        if self.inlier_radius is not None:
            return self.inlier_radius
        return UNSCALED_RADIUS if scale is None else RADIUS_IN_SCALES * scale
