"""Sums of separable Gaussians between points and a lattice, and the kernel made of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, Floats
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential, gaussian_reach, lattice_spacing

Digits: TypeAlias = type[np.float32] | type[np.float64]

_Chunks: TypeAlias = tuple[int, Float[Array, "chunks 2"], Float[Array, "chunks 2"]]
"""Number of points in a chunk; the lowest and highest x and y that each chunk reaches [m]."""

POINTS_PER_CHUNK = 512
"""Number of points in a chunk."""
SMALLER_CHUNKS = (128, 32, 8, 2)
"""Numbers of points in a chunk that are considered for sparse clouds."""
SECONDS_A_PRODUCT, SECONDS_A_CHUNK = 1e-10, 3e-5
"""Seconds of a product of a node and a point, and of a chunk."""
LEAST_EXPONENTS: dict[Digits, float] = {np.float32: -36.0, np.float64: -200.0}
"""Gaussians below exp of this are set to zero: denormal products are ten times slower."""


@dataclass(frozen=True)
class LatticeAxis:
    """Equally spaced lattice nodes along one axis."""

    start: float  # position of the first node [m]
    spacing: float  # distance between nodes [m]
    count: int  # number of nodes

    @classmethod
    def covering(cls, low: float, high: float, spacing: float, margin: float) -> "LatticeAxis":
        """Make nodes from ``low - margin`` to ``high + margin`` or just beyond [m]."""
        count = int(np.ceil((high - low + 2 * margin) / spacing)) + 1
        return cls(low - margin, spacing, count)

    @property
    def nodes(self) -> Float[Array, "count"]:
        """Positions of the nodes (count,) [m]."""
        return self.start + self.spacing * np.arange(self.count, dtype=np.float64)

    def within(self, low: float, high: float) -> slice:
        """Find the nodes of a range [m], with one node on either side if there is one."""
        first = math.floor((low - self.start) / self.spacing)
        last = math.ceil((high - self.start) / self.spacing)
        first = min(max(first, 0), self.count - 1)
        return slice(first, max(min(last, self.count - 1), first) + 1)

    def part(self, nodes: slice) -> "LatticeAxis":
        return LatticeAxis(
            self.start + nodes.start * self.spacing, self.spacing, nodes.stop - nodes.start
        )

    @property
    def halved(self) -> "LatticeAxis":
        """The same range at half the spacing; its nodes are the midpoints of all pairs of nodes."""
        return LatticeAxis(self.start, self.spacing / 2, 2 * self.count - 1)


def gaussian(
    at: Float[Array, "a"], axis: LatticeAxis, width: float, digits: Digits = np.float64
) -> Float[Floats, "a count"]:
    """Compute ``exp(-(d / width)²)`` between positions and nodes [m]."""
    # Relative to the first node, float32 is precise enough too.
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


def gaussian_slope(
    at: Float[Array, "a"], axis: LatticeAxis, width: float
) -> Float[Array, "a count"]:
    """Compute the derivative of `gaussian` with respect to the position [1/m]."""
    return (-2 / width**2) * (at[:, None] - axis.nodes) * gaussian(at, axis, width)


class Splat:
    """The matrix ``exp(-|p - m|² / width²)`` of points p and nodes m, stored as its factors."""

    def __init__(
        self,
        points_xy: Float[Array, "n 2"],
        x: LatticeAxis,
        y: LatticeAxis,
        width: float,
        reach: float,
        digits: Digits = np.float64,
    ) -> None:
        """Prepare the factors for positions [m] and a width [m]; the reach is in widths."""
        self._shape = (y.count, x.count)
        self._num_points = len(points_xy)
        self._digits = digits
        self._chunks: list[tuple[slice, tuple[slice, slice], Floats, Floats]] = []
        size, low, high = _chunks(points_xy, (x.spacing, y.spacing), reach * width)
        for k, ((left, lowest), (right, highest)) in enumerate(
            zip(low.tolist(), high.tolist(), strict=True)
        ):
            points = slice(k * size, (k + 1) * size)
            at_x, at_y = points_xy[points].T
            rows, columns = y.within(lowest, highest), x.within(left, right)
            along_y = gaussian(at_y, y.part(rows), width, digits)
            along_x = gaussian(at_x, x.part(columns), width, digits)
            self._chunks.append((points, (rows, columns), along_y, along_x))

    def to_nodes(self, values: Float[Array, "n"]) -> Float[Array, "rows columns"]:
        """Multiply the values of the points by the matrix, to a sum at every node."""
        sums = np.zeros(self._shape)
        narrow = values.astype(self._digits, copy=False)
        for points, box, along_y, along_x in self._chunks:
            sums[box] += along_y.T @ (along_x * narrow[points, None])
        return sums

    def to_points(self, weights: Float[Array, "rows columns"]) -> Float[Array, "n"]:
        """Multiply the weights of the nodes by the matrix, to a sum at every point."""
        sums = np.empty(self._num_points)
        narrow = weights.astype(self._digits, copy=False)
        for points, box, along_y, along_x in self._chunks:
            sums[points] = np.einsum("pc,pc->p", along_y @ narrow[box], along_x)
        return sums


def _chunks(points_xy: Float[Array, "n 2"], spacings: tuple[float, float], reach: float) -> _Chunks:
    """Choose the number of points in a chunk: fewer where sparse points make it faster."""
    alone = float(np.prod([2 * reach / spacing + 1 for spacing in spacings]))
    floor = 2 * alone * len(points_xy) * SECONDS_A_PRODUCT

    def cost(chunk: _Chunks) -> float:
        size, low, high = chunk
        nodes = float(np.prod((high - low) / spacings + 1, axis=1).sum())
        return 2 * nodes * size * SECONDS_A_PRODUCT + len(low) * SECONDS_A_CHUNK

    chosen = _boxes(points_xy, POINTS_PER_CHUNK, reach)
    for size in SMALLER_CHUNKS:
        if cost(chosen) < 3 * floor:  # smaller ones hardly reach half of it
            break
        smaller = _boxes(points_xy, size, reach)
        if cost(smaller) < cost(chosen) / 2:  # a little less is not worth more chunks
            chosen = smaller
    return chosen


def _boxes(points_xy: Float[Array, "n 2"], size: int, reach: float) -> _Chunks:
    starts = np.arange(0, len(points_xy), size)
    # For all chunks at once, because one by one it takes as long as the Gaussians.
    low = np.minimum.reduceat(points_xy, starts, axis=0) - reach
    return size, low, np.maximum.reduceat(points_xy, starts, axis=0) + reach


RIPPLE = 1e-3
"""Limit on the ripple of the lattice kernel times the information; the mean is exact to this
[noises]."""
CUT = 1e-4
"""Height at which bumps are cut off, times the information."""
FIELD_CUT = 1e-8
"""The same for the bumps of the field, whose cut would show as steps."""
BLOCK = 8.0
"""Side of a block of cells, in reaches of a bump."""
MARGIN = 3.5
"""How far the lattice reaches beyond the points [length-scales]."""


@dataclass(frozen=True, eq=False)
class MeanField:
    """``K(x, X) weights`` for any x: the posterior mean of Eq. (2), and its slopes."""

    length_scale: float  # length-scale of the kernel [m]
    x: LatticeAxis  # columns of the lattice
    y: LatticeAxis  # rows of the lattice
    weights: Float[Array, "rows columns"]  # weight of each node (rows, columns)
    reach: float  # distance beyond which a node's bump is left out [length-scales]

    def add_to(
        self,
        x: Float[Array, "columns"],
        y: Float[Array, "rows"],
        height: Float[Array, "rows columns"],
        slope: Float[Array, "rows columns 2"],
    ) -> None:
        """Add height and slopes [m, m/m] at pairs of ascending coordinates, Eqs. (2), (4), (5)."""
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

    def _blocks(
        self, at: Float[Array, "cells"], axis: LatticeAxis
    ) -> Iterator[tuple[slice, slice]]:
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
            LatticeAxis.covering(low[k], high[k], spacing, MARGIN * length) for k in (0, 1)
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
