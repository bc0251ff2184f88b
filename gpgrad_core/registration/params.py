"""Parameters of the registration."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.params import SEEDS, Bounds, check_bounds

RADIUS_IN_SCALES = 1.25
"""Inlier radius [scales of comparison]."""
UNSCALED_RADIUS = 0.3
"""Inlier radius for methods without a scale of comparison [m]."""


@dataclass(frozen=True)
class RegistrationParams:
    """Parameters of the registration of a pair of maps (Algorithm 1 and the steps after it)."""

    inlier_radius: Annotated[
        float | None,
        Bounds(0.01, 10.0, 0.01, "m", slider=(0.05, 1.0)),
        Doc(
            "An association is an inlier if the motion brings its keypoints within this distance "
            "of each other. Automatic: 1.25 times the scale of comparison."
        ),
    ] = None
    trials: Annotated[
        int,
        Bounds(10, 100_000, 10, "", slider=(100, 10_000)),
        Doc("Number of random pairs of associations that RANSAC tries."),
    ] = 5000
    hypotheses: Annotated[
        int,
        Bounds(1, 100, 1, "", slider=(1, 30)),
        Doc("Number of RANSAC's best motions that are aligned and compared densely."),
    ] = 12
    searched: Annotated[
        int,
        Bounds(0, 100, 1, "", slider=(0, 20)),
        Doc(
            "Number of motions that the exhaustive search, which needs no keypoints, adds to them."
        ),
    ] = 6
    seed: Annotated[
        int, SEEDS, Doc("Seed of RANSAC's random choices. The same seed gives the same result.")
    ] = 0

    def __post_init__(self) -> None:
        check_bounds(self)

    def radius(self, scale: float | None) -> float:
        if self.inlier_radius is not None:
            return self.inlier_radius
        return UNSCALED_RADIUS if scale is None else RADIUS_IN_SCALES * scale
