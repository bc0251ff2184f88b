"""The GP in weight space: bumps on a lattice make its matrices small, banded, and images.

The squared exponential is, but for a ripple, a sum of Gaussian bumps on a regular lattice with
independent weights:

    k(x, x') ≈ Σ_a φ_a(x) φ_a(x'),   φ_a(x) = s_h exp(-|x - a|² / l²),
    s_h² = signal_std² 2h² / (π l²)

with a relative ripple of 2 exp(-π² l² / (2 h²)) for spacing h. In weight space the posterior
precision is

    Q = I + Φᵀ D⁻¹ Φ,   Q[a, a'] = δ + s_h² exp(-|a - a'|² / (2 l²)) G((a + a') / 2)
    G(m) = Σ_p exp(-2 |p - m|² / l²) / noise_p²

because the product of two bumps is a narrower bump at their midpoint. So the whole matrix comes
out of one image G on the lattice of half the spacing, however many points there are; and the
same identity turns the inverse back into an image:

    var(x) = Σ_aa' Q⁻¹[a, a'] φ_a(x) φ_a'(x) = Σ_m V(m) exp(-2 |x - m|² / l²)
    V(m) = s_h² Σ_{a + a' = 2m} Q⁻¹[a, a'] exp(-|a - a'|² / (2 l²))

Q is banded; its factor, and the part of its inverse that V needs, come from a block-tridiagonal
recursion in matrix products.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from gpgrad_core.gp.block_tridiagonal import Factor, invert_pivot
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.spacing import information
from gpgrad_core.gp.splat import Axis, Splat, gaussian
from gpgrad_core.progress import Progress

Array = NDArray[np.float64]

RIPPLE = 0.05
"""Ripple of the lattice kernel times information of the data that is let pass: the standard
deviation is then within 2 % (measured: 0.3 x this), and the mean takes two or three steps."""
DROPPED = 0.05
"""Largest entry left out of Q beside its band, relative to the prior precision."""
MARGIN = 2.5
"""Length-scales by which the lattice reaches beyond the points: exp(-2 x 2.5²) is 4e-6."""


@dataclass(frozen=True, eq=False)
class VarianceReduction:
    """How far the data bring the variance below the prior, for any x."""

    length_scale: float  # [m]
    x: Axis
    y: Axis
    weights: Float[Array, "half_rows half_cols"]  # [m²]

    def sample(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> Float[Array, "rows columns"]:
        """Reduction [m²] at every pair of coordinates [m]."""
        width = self.length_scale / np.sqrt(2)
        return gaussian(y, self.y, width) @ self.weights @ gaussian(x, self.x, width).T


class WeightSpace:
    """The factorised posterior precision Q of the bumps' weights.

    Nodes are taken in blocks of `_band` rows, so that a block meets only the next. Each block
    keeps the columns from the first to the last that data can reach; the others keep their prior.
    """

    def __init__(
        self,
        cloud: Cloud,
        kernel: SquaredExponential,
        spacing: float,
        advance: Progress,
    ) -> None:
        """Factorise the precision.

        Args:
            cloud: Points sorted by y.
            kernel: Covariance of the terrain.
            spacing: Of the lattice [m].
            advance: Called with the further fraction done, once a block.

        Raises:
            NotPositiveDefiniteError: If rounding gets the better of it.
        """
        self._length_scale = length = kernel.length_scale
        xy, precision = cloud.xy, 1 / cloud.noise_variance
        bits = information(cloud, kernel)
        # Beyond this many nodes apart, two bumps share too little to matter.
        self._band = max(
            2,
            int(np.ceil(length / spacing * np.sqrt(2 * np.log(max(bits, 1) / DROPPED)))) - 1,
        )
        low, high = xy.min(axis=0), xy.max(axis=0)
        self._x = Axis.covering(low[0], high[0], spacing, MARGIN * length)
        y = Axis.covering(low[1], high[1], spacing, MARGIN * length)
        self._num_blocks = -(-y.count // self._band)
        self._y = Axis(y.start, spacing, self._num_blocks * self._band)
        self._spacing_ratio = spacing / length
        self._scale2 = kernel.signal_std**2 * 2 * self._spacing_ratio**2 / np.pi  # s_h²
        self._splat = Splat(xy, self._x, self._y, length)
        self._precision = precision
        overlap = Splat(xy, self._x.halved, self._y.halved, length / np.sqrt(2))
        self._overlap = overlap.to_nodes(self._scale2 * precision)  # s_h² G
        reached = self._overlap[::2, ::2] > self._scale2 * precision.min() * np.exp(-2 * MARGIN**2)
        self._windows = [
            _span(reached[rows].any(axis=0)) for rows in map(self._rows, range(self._num_blocks))
        ]
        self._factor = self._factorise(advance)

    def _rows(self, block: int) -> slice:
        return slice(block * self._band, (block + 1) * self._band)

    def _decay(self, nodes_apart: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """``exp(-d² / (2 l²))`` along one axis."""
        return np.exp(-0.5 * (nodes_apart * self._spacing_ratio) ** 2)

    def _row_decay(self, blocks_apart: int) -> Float[Array, "r r"]:
        """Decay between the rows of a block and those of the same or the previous block."""
        rows = np.arange(self._band, dtype=np.float64)
        apart = rows[:, None] - rows + blocks_apart * self._band
        return np.where(np.abs(apart) <= self._band, self._decay(apart), 0.0)

    def _couple(self, i: int, j: int) -> Float[Array, "m_i m_j"]:
        """Entries of ``Q - I`` between the nodes of block i and those of block j."""
        a, b = self._windows[i], self._windows[j]
        shape = (self._band, a.stop - a.start, self._band, b.stop - b.start)
        # G at the midpoints of all pairs of nodes, as a view.
        midpoints = as_strided(
            self._overlap[(i + j) * self._band :, a.start + b.start :],
            shape,
            self._overlap.strides * 2,
            writeable=False,
        )
        columns = np.arange(self._x.count, dtype=np.float64)
        along_x = self._decay(columns[a, None] - columns[b])
        pairs = midpoints * along_x[None, :, None, :]
        pairs *= self._row_decay(i - j)[:, None, :, None]
        return pairs.reshape(shape[0] * shape[1], shape[2] * shape[3])

    def _factorise(self, advance: Progress) -> Factor:
        factor = Factor([], [])
        pivot = self._couple(0, 0)
        for i in range(self._num_blocks):
            np.einsum("ii->i", pivot)[:] += 1
            factor.inverses.append(invert_pivot(pivot))
            if i + 1 < self._num_blocks:
                coupling = self._couple(i + 1, i)
                factor.gains.append(coupling @ factor.inverses[i])
                pivot = self._couple(i + 1, i + 1)
                pivot -= factor.gains[i] @ coupling.T
            advance(1 / self._num_blocks)
        return factor

    def variance_reduction(self) -> VarianceReduction:
        """Sum ``I - Q⁻¹`` by midpoints: V of the module's text, less the prior's.

        The prior itself is left out, so that it holds exactly, also beyond the lattice.
        """
        summed = np.zeros_like(self._overlap)
        for i, diagonal, below in self._factor.inverse_blocks():
            reduced = diagonal.copy()  # the recursion goes on with its own
            np.einsum("ii->i", reduced)[:] -= 1
            self._add_pairs(summed, i, i, reduced)
            if below is not None:
                self._add_pairs(summed, i + 1, i, 2 * below)  # twice: for its mirror image too
        return VarianceReduction(
            self._length_scale, self._x.halved, self._y.halved, -self._scale2 * summed
        )

    def _add_pairs(
        self,
        summed: Float[Array, "half_rows half_cols"],
        i: int,
        j: int,
        block: Float[Array, "m_i m_j"],
    ) -> None:
        """Add a block of pairs of nodes, each times its decay, at their midpoints."""
        a, b = self._windows[i], self._windows[j]
        band = self._band
        pairs = block.reshape(band, a.stop - a.start, band, b.stop - b.start)
        step = pairs.strides
        rows = self._row_decay(i - j)
        apart_decay = self._decay(np.arange(-band, band + 1, dtype=np.float64))
        for apart in range(-band, band + 1):
            first = max(a.start, b.start - apart)
            length = min(a.stop, b.stop - apart) - first
            if length <= 0:
                continue
            # All pairs (column c, column c + apart), as a view (row, row', c).
            diagonal = as_strided(
                pairs[:, first - a.start :, :, first + apart - b.start :],
                (band, band, length),
                (step[0], step[2], step[1] + step[3]),
                writeable=False,
            )
            weighted = diagonal * (rows * apart_decay[apart + band])[:, :, None]
            into = slice(2 * first + apart, 2 * (first + length) + apart - 1, 2)
            top = (i + j) * band
            for row in range(band):
                summed[top + row : top + row + band, into] += weighted[:, row]

    def precondition(self, residual: Float[Array, "n"]) -> Float[Array, "n"]:
        """Apply ``(Φ Φᵀ + D)⁻¹``, near the inverse of ``K + D``, by Woodbury's identity."""
        whitened = residual * self._precision
        right = self._splat.to_nodes(whitened)
        blocks = [(self._rows(i), window) for i, window in enumerate(self._windows)]
        solution = self._factor.solve([right[block].ravel() for block in blocks])
        smooth = np.zeros_like(right)
        for block, values in zip(blocks, solution, strict=True):
            smooth[block] = values.reshape(self._band, -1)
        return whitened - self._scale2 * self._precision * self._splat.to_points(smooth)


def _span(reached: Bool[NDArray[np.bool_], "columns"]) -> slice:
    """Columns from the first to the last that is reached; one of them if none is."""
    columns = np.flatnonzero(reached)
    return slice(int(columns[0]), int(columns[-1]) + 1) if len(columns) else slice(0, 1)
