"""Fit the GP by whichever exact method is faster for the cloud at hand."""

from typing import Literal, TypeAlias

from jaxtyping import Float

from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.lattice import LatticePosterior, fit_lattice
from gpgrad_core.gp.tiles import TilePosterior, fit_tiles, largest_tile
from gpgrad_core.progress import Progress, silent
from gpgrad_core.types import Array

Solver = Literal["auto", "lattice", "tiles"]

MOST_POINTS_A_TILE = 150
"""Above this many points in its fullest tile, neighbours included, the lattice is faster
(measured at 5,000 points in 10 m x 10 m: the tiles win up to a length-scale of 0.11 m)."""


Posterior: TypeAlias = LatticePosterior | TilePosterior
"""A fitted GP: holds its `kernel`, and samples elevation, variance and slope on any grid."""


def fit_gp(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
    solver: Solver = "auto",
    progress: Progress = silent,
) -> Posterior:
    """Fit the GP of Eq. (1) to points, exactly to the tolerances of either method.

    Args:
        points: Positions [m].
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights, one for all or one a point [m].
        mean: Height that is taken off before and added after [m]; None: the points' mean.
        solver: ``lattice`` costs by the area in length-scales, ``tiles`` by the points in one;
            ``auto`` takes the tiles where they are few.
        progress: Called now and then; may raise Cancelled.

    Raises:
        InputError: If the GP would be too large or cannot be solved.
    """
    if solver == "auto":
        solver = "tiles" if largest_tile(points, kernel) <= MOST_POINTS_A_TILE else "lattice"
    if solver == "tiles":
        posterior = fit_tiles(points, kernel, noise_std, mean=mean, progress=progress)
        if posterior is not None:
            return posterior
    return fit_lattice(points, kernel, noise_std, mean=mean, progress=progress)
