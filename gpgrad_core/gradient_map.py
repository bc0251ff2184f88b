"""Submap -> gradient map: the paper's Sec. IV."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds


@dataclass(frozen=True)
class MapParams:
    """How a submap becomes a gradient map.

    The paper prints Eq. (6) with an unsquared length-scale; its 0.1 would be sqrt(0.1) = 0.316 m
    in the kernel used here, ``signal_std² exp(-d² / (2 length_scale²))``.
    """

    length_scale: Annotated[
        float,
        Bounds(0.01, 100.0, 0.01, "m", slider=(0.05, 1.0)),
        Doc("Distance over which the terrain's height stays alike; larger is smoother."),
    ] = 0.3
    noise_std: Annotated[
        float,
        Bounds(0.0005, 10.0, 0.005, "m", slider=(0.005, 0.3)),
        Doc("Standard deviation of one point's height; larger trusts single points less."),
    ] = 0.05
    signal_std: Annotated[
        float | None,
        Bounds(0.001, 1000.0, 0.01, "m", slider=(0.05, 2.0)),
        Doc("Standard deviation of the terrain's height; None: that of the submap's points."),
    ] = None
    resolution: Annotated[
        float,
        Bounds(0.005, 10.0, 0.005, "m", slider=(0.02, 0.2)),
        Doc("Side of a map cell."),
    ] = 0.03
    max_points: Annotated[
        int | None,
        Bounds(3, 10_000_000, 1, "points", slider=(500, 30_000)),
        Doc("Thin the cloud at random to this many points; None: use all (the paper: 5000)."),
    ] = None

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
