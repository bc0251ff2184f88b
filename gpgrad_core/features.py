"""Keypoints in trusted cells of a gradient map, and their descriptors."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds
from gpgrad_core.types import Features, GradientMap

MIN_IMAGE_SIDE = 16
"""Pixels; smaller images hold no keypoint, and make OpenCV's pyramids fail."""


@dataclass(frozen=True)
class DetectorParams:
    """Which detector draws keypoints from the gradient image, and how."""

    name: Annotated[Literal["akaze", "sift"], Doc("Detector and descriptor of keypoints.")] = (
        "akaze"
    )
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
        Doc(
            "Variance mask: keep cells whose standard deviation is up to this share of signal_std."
        ),
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
    if params.name == "akaze":
        # AKAZE scales its contrast to the image, and thus finds the same keypoints on gentle
        # and on steep ground; a threshold would not. The strongest are chosen later.
        detector = _create("AKAZE_create", threshold=1e-6)
        image = gradient_map.gradient.astype(np.float32)
    else:
        detector = _create("SIFT_create", nfeatures=0, contrastThreshold=0.0, edgeThreshold=10.0)
        image = _as_bytes(gradient_map.gradient, params.gradient_range)
    small = min(image.shape) < MIN_IMAGE_SIDE
    keypoints, described = ([], None) if small else detector.detectAndCompute(image, None)
    descriptors = _as_descriptors(described, detector)
    pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float64).reshape(-1, 2)
    last = np.array(gradient_map.grid.shape[::-1]) - 1
    column, row = np.clip(np.rint(pixels), 0, last).astype(np.intp).T
    ratios = gradient_map.std[row, column] / gradient_map.signal_std
    grid = gradient_map.grid
    return Features(
        positions=grid.to_position(pixels),
        scales=grid.resolution * np.array([k.size for k in keypoints], dtype=np.float64),
        responses=np.array([k.response for k in keypoints], dtype=np.float64),
        std_ratios=ratios,
        descriptors=descriptors,
    )


def select_trusted(features: Features, params: FeatureParams) -> Features:
    """Keep the strongest keypoints in cells close enough to points: the paper's mask."""
    trusted = np.flatnonzero(features.std_ratios <= params.max_std_ratio)
    strongest = np.argsort(-features.responses[trusted], kind="stable")[: params.max_keypoints]
    return features.select(trusted[np.sort(strongest)])


def _create(name: str, **options: float) -> cv2.Feature2D:
    """Make a detector, in whichever of its modules this release of OpenCV keeps it."""
    homes = [cv2, cv2.xfeatures2d] if hasattr(cv2, "xfeatures2d") else [cv2]
    home = next(home for home in homes if hasattr(home, name))
    return getattr(home, name)(**options)


def _as_bytes(
    image: Float[NDArray[np.float64], "rows columns"], white: float
) -> UInt8[NDArray[np.uint8], "rows columns"]:
    return np.rint(np.clip(image / white, 0.0, 1.0) * 255).astype(np.uint8)


def _as_descriptors(
    described: cv2.typing.MatLike | None, detector: cv2.Feature2D
) -> NDArray[np.float32] | NDArray[np.uint8]:
    """Give descriptors their type; an image without keypoints has none of any."""
    if described is None:
        kind = np.float32 if detector.descriptorType() == cv2.CV_32F else np.uint8
        described = np.zeros((0, detector.descriptorSize()), kind)
    if described.dtype == np.float32:
        return np.asarray(described, np.float32)
    return np.asarray(described, np.uint8)
