"""Interpolates images between their pixels."""

from typing import Any, cast

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray

MOST_ROWS = 16_384
"""Number of rows of positions at a time; OpenCV samples at most 32766."""


def interpolate(
    image: Float[NDArray[np.float32], "rows columns c"],
    where: Float[NDArray[np.floating], "k n 2"],
) -> Float[NDArray[np.float32], "k n c"]:
    """Interpolate an image linearly, all channels at once.

    Args:
        image: The image (rows, columns, channels); the centre of its first pixel is (0, 0).
        where: Positions (column, row) (k, n, 2) [pixels].

    Returns:
        The values (k, n, channels); 0 beyond the image.
    """
    values = np.zeros((*where.shape[:2], image.shape[2]), np.float32)
    for start in range(0, len(where), MOST_ROWS):
        block = slice(start, start + MOST_ROWS)
        values[block] = cv2.remap(
            image,
            where[block].astype(np.float32),
            cast("Any", None),  # the map's two halves are one array
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        ).reshape(values[block].shape)
    return values
