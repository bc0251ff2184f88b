"""The elevation image: the pipeline with keypoints on the heights instead of the steepness."""

from dataclasses import replace

import numpy as np

from gpgrad_core.detection import MapDetector, PipelineParams
from gpgrad_core.features import DetectorParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import GradientMap


def elevation_params(params: PipelineParams) -> PipelineParams:
    """Replace the detector for slope vectors by AKAZE.

    Of the detectors for images, AKAZE ranks the pairs best.
    """
    if params.features.detector.name != "slope":
        return params
    return replace(params, features=replace(params.features, detector=DetectorParams("akaze")))


def elevation_detector(params: PipelineParams, memo: Memo) -> MapDetector:
    """Make the pipeline with keypoints on the elevation image; see `elevation_params`."""
    return MapDetector(params, memo, drawn_from=elevation_as_image)


def elevation_as_image(gradient_map: GradientMap) -> GradientMap:
    """Make a map whose gradient image is the height above the lowest cell.

    The gradient image is the length of the slope vector, so a slope of (height, 0) makes it the
    height. The stages after the keypoints use the original map.
    """
    height = gradient_map.elevation - gradient_map.elevation.min()
    return replace(gradient_map, slope=np.stack([height, np.zeros_like(height)], axis=-1))
