"""The kernel as a sum of bumps on a fine lattice, which makes products with it cheap."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.spacing import gaussian_reach, lattice_spacing
from gpgrad_core.gp.splat import Axis, Splat, gaussian, gaussian_slope

RIPPLE = 1e-3
"""Limit on the ripple of the lattice kernel times the information of the data; the mean is then
exact to this, in units of the noise."""
CUT = 1e-4
"""Height at which bumps are cut off, times the information: far below the ripple."""
MARGIN = 3.5
"""How far the lattice reaches beyond the points [length-scales]."""


@dataclass(frozen=True, eq=False)
class MeanField:
    """``K(x, X) weights`` for any x: the posterior mean of Eq. (2), and its slopes.

    Attributes:
        length_scale: Length-scale of the kernel [m].
        x: Columns of the lattice.
        y: Rows of the lattice.
        weights: Weight of each node (rows, columns).
    """

    length_scale: float
    x: Axis
    y: Axis
    weights: Float[Array, "rows columns"]

    def sample(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> tuple[
        Float[Array, "rows columns"], Float[Array, "rows columns"], Float[Array, "rows columns"]
    ]:
        """Compute height and slopes at every pair of coordinates, Eqs. (2), (4) and (5).

        The bumps are separable, so each field is a product of three matrices.

        Args:
            x: Coordinates of the columns [m].
            y: Coordinates of the rows [m].

        Returns:
            The height [m], and the slopes along x and along y [m/m], each (rows, columns).
        """
        along_x = gaussian(x, self.x, self.length_scale)
        along_y = gaussian(y, self.y, self.length_scale)
        half = self.weights @ along_x.T
        height = along_y @ half
        slope_x = (along_y @ self.weights) @ gaussian_slope(x, self.x, self.length_scale).T
        slope_y = gaussian_slope(y, self.y, self.length_scale) @ half
        return height, slope_x, slope_y


class FineKernel:
    """``K(X, X)`` of scattered points X, as the product of a factor and its transpose."""

    def __init__(self, cloud: Cloud, kernel: SquaredExponential, information: float) -> None:
        """Prepare the factor for the points of a cloud.

        Args:
            cloud: The points X.
            kernel: Covariance of the terrain.
            information: Largest precision that data bring to one bump; see `spacing`.
        """
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
        """Compute ``K(X, X) values``."""
        return self._scale * self._splat.to_points(self._splat.to_nodes(values))

    def field(self, weights: Float[Array, "n"]) -> MeanField:
        """Make ``K(x, X) weights`` as a function of x."""
        nodes = self._scale * self._splat.to_nodes(weights)
        return MeanField(self._length_scale, self._x, self._y, nodes)
