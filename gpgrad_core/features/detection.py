"""What a detector is and finds, in pixels, and how images are read between their pixels."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, cast

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import Array, Floats, NDArray, Singles
from gpgrad_core.types import GradientMap

Image = Float[Array, "rows columns"]


@dataclass(frozen=True, eq=False)
class Detection:
    """Keypoints in pixels; (0, 0) is the centre of the first pixel."""

    pixels: Float[Array, "k 2"]  # (column, row) of each
    diameters: Float[Array, "k"]  # of the neighbourhood that is described
    responses: Float[Array, "k"]  # in the detector's own unit
    descriptors: Float[Singles, "k d"] | UInt8[NDArray[np.uint8], "k d"]


@dataclass(frozen=True)
class Detector:
    """A way to find keypoints and to describe them."""

    name: str  # what flags, files and the viewer call it
    # finds and describes keypoints on a whole map; those of 8-bit images need a white slope [m/m]
    detect: Callable[[GradientMap, float], Detection]
    seeks: Literal["blobs", "corners", "landforms"]  # landforms are hills, pits and saddles
    bytes_a_cell: int  # memory that it takes for a cell of the map


MOST_ROWS = 16_384
"""Number of rows of positions at a time; OpenCV samples at most 32766."""
MOST_SIDE = 30_000
"""Side of the parts into which a larger image is cut."""


def interpolate(
    image: Float[Singles, "rows columns c"], where: Float[Floats, "k n 2"]
) -> Float[Singles, "k n c"]:
    """Interpolate an image linearly at positions (column, row) [pixels]; 0 beyond the image."""
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
    image: Float[Singles, "rows columns c"],
    where: Float[Floats, "k n 2"],
    values: Float[Singles, "k n c"],
) -> None:
    for start in range(0, len(where), MOST_ROWS):
        block = slice(start, start + MOST_ROWS)
        values[block] = cv2.remap(
            image,
            where[block].astype(np.float32),
            cast("Any", None),  # the map's two halves are one array
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        ).reshape(values[block].shape)
