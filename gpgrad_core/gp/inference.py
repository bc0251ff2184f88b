"""Fit the GP by whichever exact method is faster for the cloud at hand."""

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
"""A fitted GP: holds its `kernel`, and samples elevation, variance and slope on any grid."""


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
    """Fit the GP of Eq. (1) to points, exactly to the tolerances of either method.

    Args:
        points: Positions [m].
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights, one for all or one a point [m].
        mean: Height that is taken off before and added after [m]; None: the points' mean.
        solver: ``lattice`` costs by the area in length-scales, ``tiles`` by the points in one;
            ``auto`` takes the one that is estimated to be faster.
        accuracy: How exact it is to be.
        progress: Called now and then; may raise Cancelled.

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
