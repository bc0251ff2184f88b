"""Bins dense clouds: a weighted mean with less noise replaces the points of a small cell."""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.spacing import group


def bin_points(
    points: Float[Array, "n 3"], cell: float, noise_std: float | Float[Array, "n"] = 1.0
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Replace the points of each square cell by their weighted mean.

    The mean keeps the mean position too, so a slope across the cell does no harm. The error that
    remains is the terrain's curvature over a cell, ``z'' cell² / 24``.

    Args:
        points: Positions (n, 3) [m].
        cell: Side of a cell, seen from above [m].
        noise_std: Standard deviation of the heights [m], one for all or one for each point. The
            weights are its inverse square.

    Returns:
        The means (b, 3) [m], and the standard deviation of each mean's height (b,) [m].
    """
    cells = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / cell).astype(np.int64)
    owner = group(cells[:, ::-1])
    precision = np.broadcast_to(noise_std, len(points)) ** -2.0
    total = np.bincount(owner, precision)
    occupied = total > 0
    total = total[occupied]
    means = [np.bincount(owner, precision * points[:, k])[occupied] / total for k in range(3)]
    return np.column_stack(means), 1 / np.sqrt(total)


def thin_dense(
    points: Float[Array, "n 3"],
    noise_std: Float[Array, "n"],
    length_scale: float,
    signal_std: float,
) -> tuple[Float[Array, "b 3"], Float[Array, "b"]]:
    """Bin a cloud to cells of an eighth of a length-scale or less, if that at least halves it.

    Args:
        points: Positions (n, 3) [m].
        noise_std: Standard deviation of each point's height (n,) [m].
        length_scale: Length-scale of the GP [m].
        signal_std: Standard deviation of the terrain [m].

    Returns:
        The means [m] and their noise [m]; or the points as they are, if binning does not pay.
    """
    # The curvature of the ground within a cell must stay far below the noise.
    flat_enough = float(np.sqrt(np.median(noise_std) / (5 * signal_std)))
    means, noise_of_mean = bin_points(points, length_scale * min(1 / 8, flat_enough), noise_std)
    return (means, noise_of_mean) if len(means) <= len(points) / 2 else (points, noise_std)
