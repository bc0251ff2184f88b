"""Keypoints in trusted cells of a gradient map, and their descriptors."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds


@dataclass(frozen=True)
class DetectorParams:
    """Which detector draws keypoints from the gradient image, and how."""

    name: Annotated[
        Literal["akaze", "sift"], Doc("Detector and descriptor of keypoints.")
    ] = "akaze"
    gradient_range: Annotated[
        float,
        Bounds(0.05, 20.0, 0.05, "m/m", slider=(0.2, 3.0)),
        Doc("Steepness that an 8-bit image shows as white; the same for every map of a dataset."),
    ] = 1.5

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


@dataclass(frozen=True)
class FeatureParams:
    """Which keypoints are used."""

    max_std_ratio: Annotated[
        float,
        Bounds(0.01, 1.0, 0.01, "", slider=(0.02, 1.0)),
        Doc("Variance mask: keep cells whose standard deviation is at most this share of signal_std."),
    ] = 0.3
    max_keypoints: Annotated[
        int,
        Bounds(10, 20_000, 10, "", slider=(50, 3000)),
        Doc("Keep at most this many keypoints of a map, the strongest."),
    ] = 1000
    detector: DetectorParams = field(default_factory=DetectorParams)

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
