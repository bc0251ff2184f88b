"""The posterior of a fitted GP at every cell of a grid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.types import Grid


class TerrainFields(NamedTuple):
    """Posterior of the terrain on a grid, Eqs. (2)-(5).

    Attributes:
        elevation: Mean of the height (rows, columns) [m].
        variance: Variance of the height (rows, columns) [m²].
        slope: Slope along x and along y (rows, columns, 2) [m/m].
    """

    elevation: Float[Array, "rows columns"]
    variance: Float[Array, "rows columns"]
    slope: Float[Array, "rows columns 2"]

    @classmethod
    def prior(cls, grid: Grid, kernel: SquaredExponential, mean: float) -> "TerrainFields":
        """Make the fields of the prior, in arrays that can be changed."""
        return cls(
            np.full(grid.shape, mean),
            np.full(grid.shape, kernel.signal_std**2),
            np.zeros((*grid.shape, 2)),
        )


def clip_variance(variance: Float[Array, "*shape"], prior: float) -> Float[Array, "*shape"]:
    """Clip a variance in place; rounding may leave it slightly below zero or above the prior."""
    return np.clip(variance, 1e-12 * prior, prior, out=variance)
