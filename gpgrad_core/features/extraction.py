"""Keypoints in trusted cells of a gradient map, and their descriptors."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from typing_extensions import Doc

from gpgrad_core.features.detection import Detection
from gpgrad_core.features.opencv import detect_with_opencv
from gpgrad_core.features.slope_field import detect_slope_field
from gpgrad_core.features.surf import detect_surf
from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds
from gpgrad_core.types import MAX_STD_RATIO, Features, GradientMap

DetectorName = Literal["akaze", "kaze", "sift", "orb", "surf", "slope"]


@dataclass(frozen=True)
class DetectorParams:
    """Which detector draws keypoints from the map, and how."""

    name: Annotated[
        DetectorName,
        Doc(
            "Detector and descriptor of keypoints: 'slope', of the slope vectors, which only "
            "terrain has; the others, of the gradient image. The paper's is 'surf'."
        ),
    ] = "slope"
    gradient_range: Annotated[
        float,
        Bounds(0.05, 20.0, 0.05, "m/m", slider=(0.2, 3.0)),
        Doc(
            "Steepness that an 8-bit image, for SIFT and ORB, shows as white; the same for every "
            "map of a dataset."
        ),
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
        Doc(
            "Variance mask: trust cells whose standard deviation is up to this share of what "
            "heights change by over the scale of comparison. It holds for keypoints, comparison "
            "and overlap; 1 trusts every cell."
        ),
    ] = MAX_STD_RATIO
    max_keypoints: Annotated[
        int,
        Bounds(10, 20_000, 10, "", slider=(50, 3000)),
        Doc("Keep at most this many keypoints of a map, the strongest."),
    ] = 1000
    detector: DetectorParams = field(default_factory=DetectorParams)

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


def extract_features(gradient_map: GradientMap, params: FeatureParams | None = None) -> Features:
    """Draw keypoints from the gradient image where the map can be trusted, Sec. V.

    Args:
        gradient_map: The map; the paper's I_g and I_v.
        params: Detector and variance mask.
    """
    params = params or FeatureParams()
    return select_trusted(detect_features(gradient_map, params.detector), params)


def detect_features(gradient_map: GradientMap, params: DetectorParams) -> Features:
    """Detect and describe keypoints over the whole image, trusted or not.

    The mask comes after (`select_trusted`), so that moving it needs no new detection.
    """
    found = _detect(gradient_map, params)
    grid = gradient_map.grid
    last = np.array(grid.shape[::-1]) - 1
    column, row = np.clip(np.rint(found.pixels), 0, last).astype(np.intp).T
    return Features(
        positions=grid.to_position(found.pixels),
        scales=grid.resolution * found.diameters,
        responses=found.responses,
        std_ratios=np.minimum(gradient_map.std[row, column] / gradient_map.detail_std, 1.0),
        descriptors=found.descriptors,
    )


def select_trusted(features: Features, params: FeatureParams) -> Features:
    """Keep the strongest keypoints in cells close enough to points: the paper's mask."""
    trusted = np.flatnonzero(features.std_ratios <= params.max_std_ratio)
    strongest = np.argsort(-features.responses[trusted], kind="stable")[: params.max_keypoints]
    return features.select(trusted[np.sort(strongest)])


def _detect(gradient_map: GradientMap, params: DetectorParams) -> Detection:
    match params.name:
        case "slope":
            return detect_slope_field(gradient_map)
        case "surf":
            return detect_surf(gradient_map.gradient)
        case "akaze" | "kaze" | "sift" | "orb":
            return detect_with_opencv(gradient_map.gradient, params.name, params.gradient_range)
