"""The elevation image: the pipeline, with keypoints drawn from heights rather than steepness."""

from dataclasses import replace

import numpy as np

from gpgrad_core.features import DetectorParams
from gpgrad_core.pipeline import MapDetector, PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import GradientMap


def elevation_params(params: PipelineParams) -> PipelineParams:
    """Look at the image with AKAZE, where the detector asked for looks at slope vectors.

    Of the detectors for images it ranks pairs best.
    """
    if params.features.detector.name != "slope":
        return params
    return replace(params, features=replace(params.features, detector=DetectorParams("akaze")))


def elevation_detector(params: PipelineParams, memo: Memo) -> MapDetector:
    """Make the pipeline with keypoints on the elevation image; see `elevation_params`."""
    return MapDetector(params, memo, drawn_from=elevation_as_image)


def elevation_as_image(gradient_map: GradientMap) -> GradientMap:
    """Put the height above the lowest cell where keypoints look for the steepness.

    The image is the length of the slope vector: with (height, 0) for it, it is the height. What
    comes after the keypoints is given the map itself.
    """
    height = gradient_map.elevation - gradient_map.elevation.min()
    return replace(gradient_map, slope=np.stack([height, np.zeros_like(height)], axis=-1))
