"""The kernel as a sum of bumps on a fine lattice, which makes products with it cheap."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

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
FIELD_CUT = 1e-8
"""The same for the bumps of the field, whose cut would show as steps: far below that again."""
BLOCK = 8.0
"""Side of a block of cells, in reaches of a bump; smaller blocks would see mostly the same bumps,
and a narrow cloud is one block."""
MARGIN = 3.5
"""How far the lattice reaches beyond the points [length-scales]."""


@dataclass(frozen=True, eq=False)
class MeanField:
    """``K(x, X) weights`` for any x: the posterior mean of Eq. (2), and its slopes."""

    length_scale: float  # length-scale of the kernel [m]
    x: Axis  # columns of the lattice
    y: Axis  # rows of the lattice
    weights: Float[Array, "rows columns"]  # weight of each node (rows, columns)
    reach: float  # distance beyond which a node's bump is left out [length-scales]

    def add_to(
        self,
        x: Float[Array, "columns"],
        y: Float[Array, "rows"],
        height: Float[Array, "rows columns"],
        slope: Float[Array, "rows columns 2"],
    ) -> None:
        """Add height and slopes [m, m/m] at pairs of ascending coordinates, Eqs. (2), (4), (5).

        The bumps are separable, so each field is a product of three matrices. A wide grid is
        divided into blocks, and each block is reached by the nodes near it alone.
        """
        bands = [
            (
                rows,
                nodes,
                gaussian(y[rows], self.y.part(nodes), self.length_scale),
                gaussian_slope(y[rows], self.y.part(nodes), self.length_scale),
            )
            for rows, nodes in self._blocks(y, self.y)
        ]
        for columns, nodes_x in self._blocks(x, self.x):
            along_x = gaussian(x[columns], self.x.part(nodes_x), self.length_scale)
            by_x = gaussian_slope(x[columns], self.x.part(nodes_x), self.length_scale)
            for rows, nodes_y, along_y, by_y in bands:
                weights = self.weights[nodes_y, nodes_x]
                if not weights.any():  # no point is near
                    continue
                half = weights @ along_x.T
                height[rows, columns] += along_y @ half
                slope[rows, columns, 0] += (along_y @ weights) @ by_x.T
                slope[rows, columns, 1] += by_y @ half

    def _blocks(self, at: Float[Array, "cells"], axis: Axis) -> Iterator[tuple[slice, slice]]:
        """Divide coordinates into blocks; yield each with the nodes that reach it."""
        reach = self.reach * self.length_scale
        span = float(at[-1] - at[0]) if len(at) else 0.0
        count = max(1, int(span / (BLOCK * reach)))
        edges = np.searchsorted(at, at[0] + span / count * np.arange(1, count)) if len(at) else []
        for first, last in pairwise([0, *(int(edge) for edge in edges), len(at)]):
            if first < last:
                low, high = float(at[first]) - reach, float(at[last - 1]) + reach
                yield slice(first, last), axis.within(low, high)


class FineKernel:
    """``K(X, X)`` of scattered points X, as the product of a factor and its transpose."""

    def __init__(self, cloud: Cloud, kernel: SquaredExponential, information: float) -> None:
        length = kernel.length_scale
        spacing = lattice_spacing(length, information, RIPPLE)
        low, high = cloud.xy.min(axis=0), cloud.xy.max(axis=0)
        self._x, self._y = (
            Axis.covering(low[k], high[k], spacing, MARGIN * length) for k in (0, 1)
        )
        self._length_scale = length
        self._scale = kernel.signal_std**2 * 2 * (spacing / length) ** 2 / np.pi
        reach = gaussian_reach(information, CUT)
        self._field_reach = gaussian_reach(information, FIELD_CUT)
        self._splat = Splat(cloud.xy, self._x, self._y, length, reach)

    def times(self, values: Float[Array, "n"]) -> Float[Array, "n"]:
        return self._scale * self._splat.to_points(self._splat.to_nodes(values))

    def field(self, weights: Float[Array, "n"]) -> MeanField:
        nodes = self._scale * self._splat.to_nodes(weights)
        return MeanField(self._length_scale, self._x, self._y, nodes, self._field_reach)
