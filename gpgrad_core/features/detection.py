"""The result of a detector, in pixels of the image."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import NDArray

Image = Float[NDArray[np.float64], "rows columns"]


@dataclass(frozen=True, eq=False)
class Detection:
    """Keypoints in pixels; (0, 0) is the centre of the first pixel.

    Attributes:
        pixels: Position (column, row) of each keypoint (k, 2) [pixels].
        diameters: Diameter of the described neighbourhood (k,) [pixels].
        responses: Strength of each keypoint (k,), in the detector's own unit.
        descriptors: Vectors of float32 or strings of bits (k, d).
    """

    pixels: Float[NDArray[np.float64], "k 2"]
    diameters: Float[NDArray[np.float64], "k"]
    responses: Float[NDArray[np.float64], "k"]
    descriptors: Float[NDArray[np.float32], "k d"] | UInt8[NDArray[np.uint8], "k d"]
