"""What a detector is, and what it finds, in pixels of the image."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import GradientMap

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


@dataclass(frozen=True)
class Detector:
    """A way to find keypoints and to describe them."""

    name: str  # what flags, files and the viewer call it
    # finds and describes keypoints on a whole map, trusted or not. Detectors of 8-bit images are
    # told which steepness is white [m/m]; the others ignore it.
    detect: Callable[[GradientMap, float], Detection]
    # what its keypoints are: blobs or corners of the gradient image, or landforms (hills, pits and
    # saddles)
    seeks: Literal["blobs", "corners", "landforms"]
    # memory that it takes for a cell of the map, measured on 1 to 4 million cells
    bytes_a_cell: int
