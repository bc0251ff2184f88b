"""What a fitted GP knows at every cell of a grid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.types import Grid


class TerrainFields(NamedTuple):
    """Posterior of the terrain on a grid, Eqs. (2)-(5)."""

    elevation: Float[Array, "rows columns"]  # [m]
    variance: Float[Array, "rows columns"]  # of it [m²]
    slope: Float[Array, "rows columns 2"]  # along x, along y [m/m]

    @classmethod
    def prior(cls, grid: Grid, kernel: SquaredExponential, mean: float) -> "TerrainFields":
        """Give what holds before any point is seen, in arrays to be filled."""
        return cls(
            np.full(grid.shape, mean),
            np.full(grid.shape, kernel.signal_std**2),
            np.zeros((*grid.shape, 2)),
        )


def clip_variance(variance: Float[Array, "*shape"], prior: float) -> Float[Array, "*shape"]:
    """Clip a variance in place: rounding may leave it a hair below zero, or above the prior."""
    return np.clip(variance, 1e-12 * prior, prior, out=variance)
