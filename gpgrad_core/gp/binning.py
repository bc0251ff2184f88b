"""Dense clouds, whole: the points of a small cell as their mean, which knows how many they are."""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array


def bin_points(
    points: Float[Array, "n 3"], cell: float, noise_std: float | Float[Array, "n"] = 1.0
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Replace the points of each square cell by their mean.

    The mean keeps the mean position too, so a slope across the cell does no harm; what is left
    is the terrain's curvature over a cell, ``z'' cell² / 24``.

    Args:
        points: Positions [m].
        cell: Side of a cell, seen from above [m].
        noise_std: One for all or one a point [m]; they weigh by the inverse square of it.

    Returns:
        Means [m], and the noise of each [m]: that of a weighted mean.
    """
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64)
    flat = cells[:, 1] * (cells[:, 0].max() + 1) + cells[:, 0]
    _, owner = np.unique(flat, return_inverse=True)
    precision = np.broadcast_to(noise_std, len(points)) ** -2.0
    total = np.bincount(owner, precision)
    means = [np.bincount(owner, precision * points[:, k]) / total for k in range(3)]
    return np.column_stack(means), 1 / np.sqrt(total)


def thin_dense(
    points: Float[Array, "n 3"],
    noise_std: Float[Array, "n"],
    length_scale: float,
    signal_std: float,
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Bin a cloud to an eighth of a length-scale or less, where that at least halves it.

    Args:
        points: Positions [m].
        noise_std: Of each point [m].
        length_scale: Of the GP [m].
        signal_std: Of the terrain [m].

    Returns:
        Means [m] and their noise [m]; or the points as they are.
    """
    # What the ground bends within a cell must stay far below the noise.
    flat_enough = float(np.sqrt(np.median(noise_std) / (5 * signal_std)))
    means, noise_of_mean = bin_points(points, length_scale * min(1 / 8, flat_enough), noise_std)
    return (means, noise_of_mean) if len(means) <= len(points) / 2 else (points, noise_std)
