"""What a detector is and finds, in pixels, and how images are read between their pixels."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast

import cv2
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


MOST_ROWS = 16_384
"""Number of rows of positions at a time; OpenCV samples at most 32766."""
MOST_SIDE = 30_000
"""Side of the parts into which a larger image is cut; OpenCV samples images of at most 32766."""


def interpolate(
    image: Float[NDArray[np.float32], "rows columns c"],
    where: Float[NDArray[np.floating], "k n 2"],
) -> Float[NDArray[np.float32], "k n c"]:
    """Interpolate an image linearly at positions (column, row) [pixels]; 0 beyond the image.

    The centre of its first pixel is (0, 0).
    """
    values = np.zeros((*where.shape[:2], image.shape[2]), np.float32)
    if max(image.shape[:2]) <= MOST_SIDE:
        _sample(image, where, values)
        return values
    last = [(side - 1) // MOST_SIDE for side in (image.shape[1], image.shape[0])]
    parts = np.clip(where // MOST_SIDE, 0, last).astype(np.intp)
    for column, row in np.unique(parts.reshape(-1, 2), axis=0).tolist():
        left, top = column * MOST_SIDE, row * MOST_SIDE
        # With the next part's first pixels, between which and its own last ones it interpolates.
        part = image[top : top + MOST_SIDE + 1, left : left + MOST_SIDE + 1]
        there = (parts == (column, row)).all(axis=-1)
        sampled = np.zeros((int(there.sum()), 1, image.shape[2]), np.float32)
        _sample(np.ascontiguousarray(part), where[there][:, None] - (left, top), sampled)
        values[there] = sampled[:, 0]
    return values


def _sample(
    image: Float[NDArray[np.float32], "rows columns c"],
    where: Float[NDArray[np.floating], "k n 2"],
    values: Float[NDArray[np.float32], "k n c"],
) -> None:
    """Interpolate an image that OpenCV can sample, in place."""
    for start in range(0, len(where), MOST_ROWS):
        block = slice(start, start + MOST_ROWS)
        values[block] = cv2.remap(
            image,
            where[block].astype(np.float32),
            cast("Any", None),  # the map's two halves are one array
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        ).reshape(values[block].shape)
