"""All detectors of keypoints, and the keypoints in the trusted cells of a gradient map."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import cv2
import numpy as np
from typing_extensions import Doc

from gpgrad_core.arrays import Array, NDArray, Singles
from gpgrad_core.errors import InputError
from gpgrad_core.features.detection import Detection, Detector
from gpgrad_core.features.slope_field import detect_slope_field
from gpgrad_core.features.surf import detect_surf
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.types import MAX_STD_RATIO, Features, GradientMap, Grid

MIN_IMAGE_SIDE = 16
"""Smallest side of an image [pixels]; OpenCV's pyramids fail on smaller ones."""


def opencv_detector(
    create: str, *, as_bytes: bool = False, least_side: int = MIN_IMAGE_SIDE, **options: float
) -> Callable[[GradientMap, float], Detection]:
    """Adapt a detector of OpenCV, made with options that set no threshold on the contrast."""

    def detect(gradient_map: GradientMap, white: float) -> Detection:
        detector = _create(create, **options)
        image = gradient_map.gradient
        shown = _as_bytes(image, white) if as_bytes else image.astype(np.float32)
        # ORB fails on an image without any corner, such as flat ground.
        blank = min(image.shape) < least_side or shown.min() == shown.max()
        keypoints, described = ([], None) if blank else detector.detectAndCompute(shown, None)
        return Detection(
            pixels=np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2),
            diameters=np.array([keypoint.size for keypoint in keypoints], np.float64),
            responses=np.array([keypoint.response for keypoint in keypoints], np.float64),
            descriptors=_as_descriptors(described, detector),
        )

    return detect


def _create(name: str, **options: float) -> cv2.Feature2D:
    homes = [cv2, cv2.xfeatures2d] if hasattr(cv2, "xfeatures2d") else [cv2]
    home = next(home for home in homes if hasattr(home, name))
    return getattr(home, name)(**options)


def _as_bytes(image: Array, white: float) -> NDArray[np.uint8]:
    return np.rint(np.clip(image / white, 0.0, 1.0) * 255).astype(np.uint8)


def _as_descriptors(
    described: cv2.typing.MatLike | None, detector: cv2.Feature2D
) -> Singles | NDArray[np.uint8]:
    """Cast descriptors to their type; without keypoints OpenCV returns no array."""
    if described is None:
        kind = np.float32 if detector.descriptorType() == cv2.CV_32F else np.uint8
        described = np.zeros((0, detector.descriptorSize()), kind)
    if described.dtype == np.float32:
        return np.asarray(described, np.float32)
    return np.asarray(described, np.uint8)


DETECTORS: dict[str, Detector] = {
    detector.name: detector
    for detector in (
        # AKAZE scales its contrast to the image, so gentle and steep ground give the same.
        Detector("akaze", opencv_detector("AKAZE_create", threshold=1e-6), "blobs", 95),
        Detector("kaze", opencv_detector("KAZE_create", threshold=1e-6), "blobs", 530),
        Detector(
            "sift",
            opencv_detector(
                "SIFT_create", as_bytes=True, nfeatures=0, contrastThreshold=0.0, edgeThreshold=10.0
            ),
            "blobs",
            235,
        ),
        # ORB needs a limit, and leaves a margin of 31 pixels on every side.
        Detector(
            "orb",
            opencv_detector(
                "ORB_create", as_bytes=True, least_side=64, nfeatures=5000, fastThreshold=1
            ),
            "corners",
            20,
        ),
        Detector("surf", lambda made, _: detect_surf(made.gradient), "blobs", 150),
        Detector("slope", lambda made, _: detect_slope_field(made), "landforms", 40),
    )
}


if TYPE_CHECKING:
    DetectorName: TypeAlias = str
else:
    DetectorName = Literal[tuple(DETECTORS)]  # the choices of flags, files and the viewer

MOST_BYTES = 9e8
"""Largest memory that a detector may take."""


@dataclass(frozen=True)
class DetectorParams:
    """Which detector finds the keypoints, and its parameters."""

    name: Annotated[
        DetectorName,
        Doc(
            "Detector and descriptor of the keypoints. 'slope' uses the slope vectors, which only "
            "terrain has. The others use the gradient image; the paper uses 'surf'."
        ),
    ] = "slope"
    gradient_range: Annotated[
        float,
        Bounds(0.05, 20.0, 0.05, "m/m", slider=(0.2, 3.0)),
        Doc(
            "Steepness that is white in the 8-bit image for SIFT and ORB. It is the same for all "
            "maps of a dataset."
        ),
    ] = 1.5

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True)
class FeatureParams:
    """Which keypoints are used: variance mask, number and detector."""

    max_std_ratio: Annotated[
        float,
        Bounds(0.01, 1.0, 0.01, "", slider=(0.02, 1.0)),
        Doc(
            "Variance mask: a cell is trusted if its standard deviation is at most this share of "
            "the typical change of height over the scale of comparison. Keypoints, comparison and "
            "overlap use trusted cells only. 1 trusts every cell."
        ),
    ] = MAX_STD_RATIO
    max_keypoints: Annotated[
        int,
        Bounds(10, 20_000, 10, "", slider=(50, 3000)),
        Doc("Largest number of keypoints of a map; the strongest are kept."),
    ] = 1000
    detector: DetectorParams = field(default_factory=DetectorParams)

    def __post_init__(self) -> None:
        check_bounds(self)


def extract_features(gradient_map: GradientMap, params: FeatureParams | None = None) -> Features:
    """Extract keypoints where the map is trusted (the paper's Sec. V).

    Args:
        gradient_map: The map: the paper's I_g and I_v.
        params: Detector, variance mask and number of keypoints.

    Returns:
        The keypoints, with positions and scales in metres.

    Raises:
        InputError: If the detector would take too much memory.
    """
    params = params or FeatureParams()
    return select_trusted(detect_features(gradient_map, params.detector), params)


def detect_features(gradient_map: GradientMap, params: DetectorParams) -> Features:
    """Detect and describe keypoints on the whole map; a changed mask needs no new detection."""
    check_detector(gradient_map.grid, params)
    detection = DETECTORS[params.name].detect(gradient_map, params.gradient_range)
    grid = gradient_map.grid
    last = np.array(grid.shape[::-1]) - 1
    column, row = np.clip(np.rint(detection.pixels), 0, last).astype(np.intp).T
    return Features(
        positions=grid.to_position(detection.pixels),
        scales=grid.resolution * detection.diameters,
        responses=detection.responses,
        std_ratios=np.minimum(gradient_map.std[row, column] / gradient_map.detail_std, 1.0),
        descriptors=detection.descriptors,
    )


def check_detector(grid: Grid, params: DetectorParams) -> None:
    """Refuse a detector that would take too much memory on a map of this size."""
    needed = grid.num_cells * DETECTORS[params.name].bytes_a_cell
    if needed > MOST_BYTES:
        coarser = np.ceil(1000 * grid.resolution * np.sqrt(needed / MOST_BYTES)) / 1000
        raise InputError(
            f"the detector {params.name} would need {needed / 1e9:.1f} GB for a map of "
            f"{grid.shape[0]:,} x {grid.shape[1]:,} cells, more than the {MOST_BYTES / 1e9:g} GB "
            f"allowed; raise the resolution to {coarser:g} m or more, or use the detector slope"
        )


def select_trusted(features: Features, params: FeatureParams) -> Features:
    """Keep the strongest keypoints in trusted cells: the paper's mask."""
    trusted = np.flatnonzero(features.std_ratios <= params.max_std_ratio)
    strongest = np.argsort(-features.responses[trusted], kind="stable")[: params.max_keypoints]
    return features.select(trusted[np.sort(strongest)])
