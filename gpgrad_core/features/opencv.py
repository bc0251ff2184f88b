"""OpenCV's detectors, such as AKAZE, KAZE, SIFT and ORB, on the gradient image."""

from collections.abc import Callable

import cv2
import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.features.detection import Detection
from gpgrad_core.types import GradientMap

MIN_IMAGE_SIDE = 16
"""Smallest side of an image [pixels]. Smaller images have no keypoints, and OpenCV's pyramids fail
on them."""


def opencv_detector(
    create: str,
    *,
    as_bytes: bool = False,
    least_side: int = MIN_IMAGE_SIDE,
    **options: float,
) -> Callable[[GradientMap, float], Detection]:
    """Adapt the detector that a function of OpenCV makes with some options.

    They should set no threshold on the contrast, so that gentle ground has as many keypoints as
    steep ground. The strongest are selected later. The least side is in pixels.
    """

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


def _as_bytes(image: NDArray[np.float64], white: float) -> NDArray[np.uint8]:
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
