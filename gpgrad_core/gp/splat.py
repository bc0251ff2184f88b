"""Sums of separable Gaussians between scattered points and a regular lattice of nodes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH = 5.5
"""Widths beyond which a Gaussian exp(-d²) is left out: 7e-14 of its height."""
POINTS_PER_CHUNK = 256


@dataclass(frozen=True)
class Axis:
    """Equally spaced lattice nodes along one axis."""

    start: float  # [m]
    spacing: float  # [m]
    count: int

    @classmethod
    def covering(cls, low: float, high: float, spacing: float, margin: float) -> "Axis":
        """Make the nodes from ``low - margin`` to ``high + margin`` or just beyond [m]."""
        count = int(np.ceil((high - low + 2 * margin) / spacing)) + 1
        return cls(low - margin, spacing, count)

    @property
    def nodes(self) -> Float[Array, "count"]:
        """Positions [m]."""
        return self.start + self.spacing * np.arange(self.count, dtype=np.float64)

    @property
    def halved(self) -> "Axis":
        """The same stretch at half the spacing: all midpoints of two nodes."""
        return Axis(self.start, self.spacing / 2, 2 * self.count - 1)


def gaussian(at: Float[Array, "a"], axis: Axis, width: float) -> Float[Array, "a count"]:
    """``exp(-(d / width)²)`` between positions and nodes."""
    return np.exp(-(((at[:, None] - axis.nodes) / width) ** 2))


def gaussian_slope(at: Float[Array, "a"], axis: Axis, width: float) -> Float[Array, "a count"]:
    """Derivative of `gaussian` with respect to the position [1/m]."""
    offsets = at[:, None] - axis.nodes
    return (-2 / width**2) * offsets * np.exp(-((offsets / width) ** 2))


class Splat:
    """The matrix ``exp(-|p - m|² / width²)`` of points p and nodes m, kept as its factors.

    Points must be sorted by y: each chunk of them then meets a narrow band of lattice rows, and
    both products are dense matrix products of that band.
    """

    def __init__(self, points_xy: Float[Array, "n 2"], x: Axis, y: Axis, width: float) -> None:
        """Prepare the factors.

        Args:
            points_xy: Positions [m], sorted by y.
            x: Columns of the lattice.
            y: Rows of the lattice.
            width: Of the Gaussian [m].
        """
        self._shape = (y.count, x.count)
        self._num_points = len(points_xy)
        self._chunks: list[tuple[slice, slice, Array, Array]] = []
        reach = REACH * width
        for start in range(0, len(points_xy), POINTS_PER_CHUNK):
            points = slice(start, start + POINTS_PER_CHUNK)
            at_x, at_y = points_xy[points, 0], points_xy[points, 1]
            first = max(0, int(np.floor((at_y[0] - reach - y.start) / y.spacing)))
            last = min(y.count, int(np.ceil((at_y[-1] + reach - y.start) / y.spacing)) + 1)
            band = Axis(y.start + first * y.spacing, y.spacing, last - first)
            self._chunks.append(
                (points, slice(first, last), gaussian(at_y, band, width), gaussian(at_x, x, width))
            )

    def to_nodes(self, values: Float[Array, "n"]) -> Float[Array, "rows columns"]:
        """Sum the points' values, spread by the Gaussian, at every node."""
        sums = np.zeros(self._shape)
        for points, rows, along_y, along_x in self._chunks:
            sums[rows] += along_y.T @ (along_x * values[points, None])
        return sums

    def to_points(self, weights: Float[Array, "rows columns"]) -> Float[Array, "n"]:
        """Sum the nodes' weights, spread by the Gaussian, at every point."""
        sums = np.empty(self._num_points)
        for points, rows, along_y, along_x in self._chunks:
            sums[points] = np.einsum("pc,pc->p", along_y @ weights[rows], along_x)
        return sums
