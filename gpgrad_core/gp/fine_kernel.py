"""The kernel itself, as bumps on a lattice fine enough: products with it cost little."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.spacing import gaussian_reach, lattice_spacing
from gpgrad_core.gp.splat import Axis, Splat, gaussian, gaussian_slope

RIPPLE = 1e-3
"""Ripple of the lattice kernel times information of the data: the mean is then as near to exact,
in units of the noise."""
CUT = 1e-4
"""Height at which bumps are cut off, times information: far below the ripple."""
MARGIN = 3.5
"""Length-scales by which the lattice reaches beyond the points."""


@dataclass(frozen=True, eq=False)
class MeanField:
    """``K(x, X) weights`` for any x: the posterior mean of Eq. (2), and its slopes."""

    length_scale: float  # [m]
    x: Axis
    y: Axis
    weights: Float[Array, "rows columns"]

    def sample(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> tuple[
        Float[Array, "rows columns"], Float[Array, "rows columns"], Float[Array, "rows columns"]
    ]:
        """Height [m] and slopes along x and y [m/m] at every pair of coordinates [m].

        Separability makes each a product of three matrices: Eqs. (2), (4) and (5).
        """
        along_x = gaussian(x, self.x, self.length_scale)
        along_y = gaussian(y, self.y, self.length_scale)
        half = self.weights @ along_x.T
        height = along_y @ half
        slope_x = (along_y @ self.weights) @ gaussian_slope(x, self.x, self.length_scale).T
        slope_y = gaussian_slope(y, self.y, self.length_scale) @ half
        return height, slope_x, slope_y


class FineKernel:
    """``K(X, X)`` of scattered points X, as a factor and its transpose."""

    def __init__(self, cloud: Cloud, kernel: SquaredExponential, information: float) -> None:
        """Prepare for a cloud's points."""
        length = kernel.length_scale
        spacing = lattice_spacing(length, information, RIPPLE)
        low, high = cloud.xy.min(axis=0), cloud.xy.max(axis=0)
        self._x, self._y = (
            Axis.covering(low[k], high[k], spacing, MARGIN * length) for k in (0, 1)
        )
        self._length_scale = length
        self._scale = kernel.signal_std**2 * 2 * (spacing / length) ** 2 / np.pi
        reach = gaussian_reach(information, CUT)
        self._splat = Splat(cloud.xy, self._x, self._y, length, reach)

    def times(self, values: Float[Array, "n"]) -> Float[Array, "n"]:
        """``K(X, X) values``."""
        return self._scale * self._splat.to_points(self._splat.to_nodes(values))

    def field(self, weights: Float[Array, "n"]) -> MeanField:
        """``K(x, X) weights`` as a function of x."""
        nodes = self._scale * self._splat.to_nodes(weights)
        return MeanField(self._length_scale, self._x, self._y, nodes)
