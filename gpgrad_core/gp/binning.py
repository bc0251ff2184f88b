"""Dense clouds, whole: the points of a small cell as their mean, which knows how many they are."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bin_points(
    points: Float[Array, "n 3"], cell: float
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Replace the points of each square cell by their mean.

    The mean keeps the mean position too, so a slope across the cell does no harm; what is left
    is the terrain's curvature over a cell, ``z'' cell² / 24``.

    Args:
        points: Positions [m].
        cell: Side of a cell, seen from above [m].

    Returns:
        Means [m], and the number of points in each.
    """
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64)
    flat = cells[:, 1] * (cells[:, 0].max() + 1) + cells[:, 0]
    _, owner = np.unique(flat, return_inverse=True)
    counts = np.bincount(owner).astype(np.float64)
    means = np.column_stack([np.bincount(owner, points[:, k]) / counts for k in range(3)])
    return means, counts
