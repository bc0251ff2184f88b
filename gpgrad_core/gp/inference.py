"""Fits the GP with the exact method that is faster for the cloud."""

from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.gp import lattice, tiles
from gpgrad_core.gp.accuracy import EXACT, Accuracy
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.lattice import LatticePosterior, fit_lattice
from gpgrad_core.gp.spacing import check_solvable, information
from gpgrad_core.gp.tiles import TilePosterior, fit_tiles
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Array

Solver = Literal["auto", "lattice", "tiles"]

Posterior: TypeAlias = LatticePosterior | TilePosterior
"""A fitted GP. It has its `kernel`, and samples elevation, variance and slope on any grid."""


def fit_gp(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
    solver: Solver = "auto",
    accuracy: Accuracy = EXACT,
    progress: Progress = silent,
) -> Posterior:
    """Fit the GP of Eq. (1) to points, exactly but for the given accuracy.

    Args:
        points: Positions (n, 3) [m].
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights [m], one for all or one for each point.
        mean: Height that is subtracted before and added after [m]; None takes the points' mean.
        solver: The time of ``lattice`` grows with the area in length-scales, that of ``tiles``
            with the number of points in a length-scale. ``auto`` takes the one that is estimated
            to be faster.
        accuracy: How exact the solution has to be.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The fitted GP, which can be sampled on any grid.

    Raises:
        InputError: If the GP would be too large or cannot be solved.
    """
    if solver == "auto":
        solver = _faster(points, kernel, noise_std, accuracy)
    if solver == "tiles":
        found = fit_tiles(
            points, kernel, noise_std, mean=mean, accuracy=accuracy, progress=progress
        )
        if found is not None:
            return found
    return fit_lattice(points, kernel, noise_std, mean=mean, accuracy=accuracy, progress=progress)


def _faster(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    accuracy: Accuracy,
) -> Literal["lattice", "tiles"]:
    xy, noise_variance = points[:, :2], np.broadcast_to(np.square(noise_std), len(points))
    bits = information(xy, noise_variance, kernel)
    check_solvable(xy, kernel, bits)
    by_lattice = lattice.estimate_seconds(xy, kernel, bits, accuracy)
    return "tiles" if tiles.estimate_seconds(xy, kernel, accuracy) < by_lattice else "lattice"
