"""What a fitted GP knows at every cell of a grid."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.types import Grid

Array = NDArray[np.float64]


class TerrainFields(NamedTuple):
    """Posterior of the terrain on a grid, Eqs. (2)-(5), and the variance of Eqs. (4), (5)."""

    elevation: Float[Array, "rows columns"]  # [m]
    variance: Float[Array, "rows columns"]  # of it [m²]
    slope: Float[Array, "rows columns 2"]  # along x, along y [m/m]
    slope_variance: Float[Array, "rows columns 2"]  # of it [m²/m²]

    @classmethod
    def prior(cls, grid: Grid, kernel: SquaredExponential, mean: float) -> "TerrainFields":
        """Give what holds before any point is seen, in arrays to be filled."""
        return cls(
            np.full(grid.shape, mean),
            np.full(grid.shape, kernel.signal_std**2),
            np.zeros((*grid.shape, 2)),
            np.full((*grid.shape, 2), kernel.slope_std**2),
        )

    def within_prior(self, kernel: SquaredExponential) -> "TerrainFields":
        """Clip the variances in place: rounding may leave a hair below zero, above the prior."""
        for values, prior in (
            (self.variance, kernel.signal_std**2),
            (self.slope_variance, kernel.slope_std**2),
        ):
            np.clip(values, 1e-12 * prior, prior, out=values)
        return self
