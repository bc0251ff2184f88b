"""OpenCV's detectors: AKAZE, KAZE, SIFT and ORB."""

from typing import Literal

import cv2
import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.features.detection import Detection, Image

OpenCVName = Literal["akaze", "kaze", "sift", "orb"]

MIN_IMAGE_SIDE = 16
"""Smallest side of an image [pixels]. Smaller images have no keypoints, and OpenCV's pyramids fail
on them."""
MIN_ORB_SIDE = 64
"""Smallest side of an image for ORB [pixels]. ORB leaves a margin of 31 pixels on every side, and
fails on images that are nothing else."""
MAX_ORB_KEYPOINTS = 5000
"""ORB needs a limit; the strongest are selected later."""


def detect_with_opencv(image: Image, name: OpenCVName, white: float) -> Detection:
    """Detect and describe keypoints with one of OpenCV's detectors.

    No threshold depends on the contrast, so that gentle ground has as many keypoints as steep
    ground. The strongest are selected later.

    Args:
        image: The gradient image (rows, columns) [m/m].
        name: Name of the detector.
        white: Value that is white in the 8-bit image for SIFT and ORB, which accept no other
            [m/m].
    """
    detector = _detector(name)
    shown = _as_bytes(image, white) if name in ("sift", "orb") else image.astype(np.float32)
    smallest = MIN_ORB_SIDE if name == "orb" else MIN_IMAGE_SIDE
    # ORB also fails on an image without any corner, such as flat ground.
    blank = min(image.shape) < smallest or shown.min() == shown.max()
    keypoints, described = ([], None) if blank else detector.detectAndCompute(shown, None)
    return Detection(
        pixels=np.array([keypoint.pt for keypoint in keypoints], np.float64).reshape(-1, 2),
        diameters=np.array([keypoint.size for keypoint in keypoints], np.float64),
        responses=np.array([keypoint.response for keypoint in keypoints], np.float64),
        descriptors=_as_descriptors(described, detector),
    )


def _detector(name: OpenCVName) -> cv2.Feature2D:
    match name:
        case "akaze":
            # AKAZE scales its contrast to the image, so gentle and steep ground give the same.
            return _create("AKAZE_create", threshold=1e-6)
        case "kaze":
            return _create("KAZE_create", threshold=1e-6)
        case "sift":
            return _create("SIFT_create", nfeatures=0, contrastThreshold=0.0, edgeThreshold=10.0)
        case "orb":
            return _create("ORB_create", nfeatures=MAX_ORB_KEYPOINTS, fastThreshold=1)


def _create(name: str, **options: float) -> cv2.Feature2D:
    """Make a detector; releases of OpenCV differ in the module that holds it."""
    homes = [cv2, cv2.xfeatures2d] if hasattr(cv2, "xfeatures2d") else [cv2]
    home = next(home for home in homes if hasattr(home, name))
    return getattr(home, name)(**options)


def _as_bytes(image: Image, white: float) -> NDArray[np.uint8]:
    return np.rint(np.clip(image / white, 0.0, 1.0) * 255).astype(np.uint8)


def _as_descriptors(
    described: cv2.typing.MatLike | None, detector: cv2.Feature2D
) -> NDArray[np.float32] | NDArray[np.uint8]:
    """Give descriptors their type; without keypoints OpenCV returns no array."""
    if described is None:
        kind = np.float32 if detector.descriptorType() == cv2.CV_32F else np.uint8
        described = np.zeros((0, detector.descriptorSize()), kind)
    if described.dtype == np.float32:
        return np.asarray(described, np.float32)
    return np.asarray(described, np.uint8)
