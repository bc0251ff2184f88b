"""What every detector gives back, in pixels of the image it was shown."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import NDArray

Image = Float[NDArray[np.float64], "rows columns"]


@dataclass(frozen=True, eq=False)
class Detection:
    """Keypoints in pixels: (0, 0) is the centre of the first."""

    pixels: Float[NDArray[np.float64], "k 2"]  # (column, row)
    diameters: Float[NDArray[np.float64], "k"]  # of the neighbourhood [pixels]
    responses: Float[NDArray[np.float64], "k"]  # strength, as the detector has it
    descriptors: Float[NDArray[np.float32], "k d"] | UInt8[NDArray[np.uint8], "k d"]
