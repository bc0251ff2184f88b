"""Sums of separable Gaussians between scattered points and a regular lattice of nodes."""

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray

Real: TypeAlias = NDArray[np.floating]
Digits: TypeAlias = type[np.float32] | type[np.float64]

POINTS_PER_CHUNK = 512
"""Fewer are too quickly done for two threads to get anywhere (measured from 256 to 2048)."""
LEAST_EXPONENTS: dict[Digits, float] = {np.float32: -36.0, np.float64: -200.0}
"""Gaussians below exp of this, 2e-16 and 1e-87, are zero: products of such numbers would be not
quite zero, which costs a processor tenfold."""


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

    def within(self, low: float, high: float) -> slice:
        """Nodes from the last before a stretch to the first behind it [m], as far as there are."""
        first = math.floor((low - self.start) / self.spacing)
        last = math.ceil((high - self.start) / self.spacing)
        first = min(max(first, 0), self.count - 1)
        return slice(first, max(min(last, self.count - 1), first) + 1)

    def part(self, nodes: slice) -> "Axis":
        """Some of the nodes."""
        return Axis(self.start + nodes.start * self.spacing, self.spacing, nodes.stop - nodes.start)

    @property
    def halved(self) -> "Axis":
        """The same stretch at half the spacing: all midpoints of two nodes."""
        return Axis(self.start, self.spacing / 2, 2 * self.count - 1)


def gaussian(
    at: Float[Array, "a"], axis: Axis, width: float, digits: Digits = np.float64
) -> Float[Real, "a count"]:
    """``exp(-(d / width)²)`` between positions and nodes."""
    # From the first node on, the digits are fine, few as they may be.
    positions = ((at - axis.start) / width).astype(digits, copy=False)
    nodes = (axis.spacing / width * np.arange(axis.count)).astype(digits, copy=False)
    least = LEAST_EXPONENTS[digits]
    values = np.subtract.outer(positions, nodes)
    np.square(values, out=values)
    np.negative(values, out=values)
    np.maximum(values, least, out=values)
    np.exp(values, out=values)
    values -= np.exp(digits(least))
    return values


def gaussian_slope(at: Float[Array, "a"], axis: Axis, width: float) -> Float[Array, "a count"]:
    """Derivative of `gaussian` with respect to the position [1/m]."""
    return (-2 / width**2) * (at[:, None] - axis.nodes) * gaussian(at, axis, width)


class Splat:
    """The matrix ``exp(-|p - m|² / width²)`` of points p and nodes m, kept as its factors.

    Any run of consecutive points should lie close together: each chunk of them then meets a
    small box of the lattice, and both products are dense matrix products of that box.
    """

    def __init__(
        self,
        points_xy: Float[Array, "n 2"],
        x: Axis,
        y: Axis,
        width: float,
        reach: float,
        digits: Digits = np.float64,
    ) -> None:
        """Prepare the factors.

        Args:
            points_xy: Positions [m].
            x: Columns of the lattice.
            y: Rows of the lattice.
            width: Of the Gaussian [m].
            reach: Widths beyond which a Gaussian may be left out.
            digits: Of the factors and the products.
        """
        self._shape = (y.count, x.count)
        self._num_points = len(points_xy)
        self._digits = digits
        self._chunks: list[tuple[slice, tuple[slice, slice], Real, Real]] = []
        starts = range(0, len(points_xy), POINTS_PER_CHUNK)
        # Of all chunks at once: one by one it takes as long as the Gaussians.
        low = np.minimum.reduceat(points_xy, starts, axis=0) - reach * width
        high = np.maximum.reduceat(points_xy, starts, axis=0) + reach * width
        for start, (left, lowest), (right, highest) in zip(
            starts, low.tolist(), high.tolist(), strict=True
        ):
            points = slice(start, start + POINTS_PER_CHUNK)
            at_x, at_y = points_xy[points].T
            rows, columns = y.within(lowest, highest), x.within(left, right)
            along_y = gaussian(at_y, y.part(rows), width, digits)
            along_x = gaussian(at_x, x.part(columns), width, digits)
            self._chunks.append((points, (rows, columns), along_y, along_x))

    def to_nodes(self, values: Float[Array, "n"]) -> Float[Array, "rows columns"]:
        """Sum the points' values, spread by the Gaussian, at every node."""
        sums = np.zeros(self._shape)
        narrow = values.astype(self._digits, copy=False)
        for points, box, along_y, along_x in self._chunks:
            sums[box] += along_y.T @ (along_x * narrow[points, None])
        return sums

    def to_points(self, weights: Float[Array, "rows columns"]) -> Float[Array, "n"]:
        """Sum the nodes' weights, spread by the Gaussian, at every point."""
        sums = np.empty(self._num_points)
        narrow = weights.astype(self._digits, copy=False)
        for points, box, along_y, along_x in self._chunks:
            sums[points] = np.einsum("pc,pc->p", along_y @ narrow[box], along_x)
        return sums
