"""The GP in weight space: bumps on a lattice make its matrices small and banded.

Apart from a ripple, the squared exponential is a sum of Gaussian bumps on a regular lattice with
independent weights:

    k(x, x') ≈ Σ_a φ_a(x) φ_a(x'),   φ_a(x) = s_h exp(-|x - a|² / l²),
    s_h² = signal_std² 2h² / (π l²)

with a relative ripple of 2 exp(-π² l² / (2 h²)) for spacing h. In weight space the posterior
precision is

    Q = I + Φᵀ D⁻¹ Φ,   Q[a, a'] = δ + s_h² exp(-|a - a'|² / (2 l²)) G((a + a') / 2)
    G(m) = Σ_p exp(-2 |p - m|² / l²) / noise_p²

because the product of two bumps is a narrower bump at their midpoint. So one image G on the lattice
of half the spacing gives the whole matrix, for any number of points. The same identity turns the
inverse into an image:

    var(x) = Σ_aa' Q⁻¹[a, a'] φ_a(x) φ_a'(x) = Σ_m V(m) exp(-2 |x - m|² / l²)
    V(m) = s_h² Σ_{a + a' = 2m} Q⁻¹[a, a'] exp(-|a - a'|² / (2 l²))

The variance of the slopes comes from the same pairs. With δ = (a - a') / 2,

    ∂φ_a/∂x ∂φ_a'/∂x = 4/l⁴ ((x - m)_x² - δ_x²) φ_a φ_a'

so it needs one more image for each direction, in which every pair is weighted by δ².

Q is banded. A block-tridiagonal recursion of matrix products gives its factor, and the part of its
inverse that V needs.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import as_strided

from gpgrad_core.arrays import Array, Floats, Mask
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential, gaussian_reach
from gpgrad_core.gp.splat import LatticeAxis, Splat, gaussian
from gpgrad_core.run import Progress

LARGEST_LEAF = 48
"""Largest number of rows that LAPACK inverts directly; the best of those measured, 24 to 128."""


class NotPositiveDefiniteError(ArithmeticError):
    """A block cannot be factorised: with rounding errors the matrix is not positive definite."""


@dataclass(frozen=True, eq=False)
class Factor:
    """Block Gaussian elimination from the first block to the last.

    With diagonal blocks D_i and blocks E_i below them, the pivots are
    ``P_0 = D_0`` and ``P_(i+1) = D_(i+1) - E_i P_i⁻¹ E_iᵀ``.
    """

    inverses: list[Float[Floats, "_ _"]]  # the inverse pivots P_i⁻¹
    gains: list[Float[Floats, "_ _"]]  # the products E_i P_i⁻¹

    def solve(self, right: list[Float[Floats, "_"]]) -> list[Float[Floats, "_"]]:
        """Solve for one right-hand side, divided into blocks; the solution is in blocks too."""
        forward: list[Floats] = [right[0]]
        for gain, block in zip(self.gains, right[1:], strict=True):
            forward.append(block - gain @ forward[-1])
        solution: list[Floats] = [self.inverses[-1] @ forward[-1]]  # last block first
        for i in reversed(range(len(self.gains))):
            solution.append(self.inverses[i] @ forward[i] - self.gains[i].T @ solution[-1])
        return solution[::-1]

    def inverse_blocks(
        self,
    ) -> Iterator[tuple[int, Float[Floats, "_ _"], Float[Floats, "_ _"] | None]]:
        """Yield (i, block i of the inverse, block (i + 1, i) or None), last first (Takahashi)."""
        last = len(self.inverses) - 1
        diagonal = self.inverses[last]
        yield last, diagonal, None
        for i in reversed(range(last)):
            below = diagonal @ self.gains[i]
            np.negative(below, out=below)
            diagonal = self.inverses[i] - self.gains[i].T @ below
            yield i, diagonal, below


def invert_pivot(pivot: Float[Floats, "m m"]) -> Float[Floats, "m m"]:
    """Invert a positive definite block by halves: products run at ten times LAPACK's speed."""
    size = len(pivot)
    if size <= LARGEST_LEAF:
        return _invert_leaf(pivot)
    half = size // 2
    first = invert_pivot(pivot[:half, :half])
    coupling = pivot[:half, half:]
    gain = coupling.T @ first
    second = invert_pivot(pivot[half:, half:] - gain @ coupling)
    inverse = np.empty_like(pivot)
    below = second @ gain
    inverse[half:, half:] = second
    inverse[:half, :half] = first
    inverse[:half, :half] += gain.T @ below
    np.negative(below, out=below)
    inverse[half:, :half] = below
    inverse[:half, half:] = below.T
    return inverse


def _invert_leaf(pivot: Float[Floats, "m m"]) -> Float[Floats, "m m"]:
    from scipy.linalg.lapack import dpotrf, dtrtri, spotrf, strtri  # noqa: PLC0415 - loads slowly

    single = pivot.dtype == np.float32
    factorise, invert = (spotrf, strtri) if single else (dpotrf, dtrtri)
    # LAPACK needs an F-ordered array, which is the transpose of a C-ordered one.
    factor, failed = factorise(pivot.T, lower=1)
    if failed:
        raise NotPositiveDefiniteError(f"pivot {failed} is not positive")
    inverse, _ = invert(factor, lower=1, overwrite_c=1)
    return inverse.T @ inverse


DROPPED = 0.15
"""Largest entry of Q that may be left out beside its band, relative to the prior precision."""
CUT = 1e-3
"""Height at which bumps are cut off, times the information."""
LEAST_MARGIN = 2.0
"""How far the lattice reaches beyond the points at least [length-scales]."""
BEYOND = 0.01
"""Variance of the bumps beyond the lattice, which are left out, times the information."""
NEGLIGIBLE = 1e-12
"""Values below this share of the height of a bump are set to zero."""
MOST_INFORMATION_IN_SINGLE = 1e4
"""Up to this information the factor is float32, which takes half the time."""

MOST_INFORMATION_UNREFINED = 1e3
"""Above this information float32 solutions are refined once."""


@dataclass(frozen=True, eq=False)
class VarianceReduction:
    """How much the data reduce the prior variances, at any x."""

    length_scale: float  # length-scale of the kernel [m]
    x: LatticeAxis  # columns of the lattice of half the spacing
    y: LatticeAxis  # rows of the lattice of half the spacing
    # v at each node (half_rows, half_cols) [m²]
    pairs: Float[Array, "half_rows half_cols"]
    # v weighted by δ² along x, and along y (2, half_rows, half_cols) [m⁴]
    apart: Float[Array, "2 half_rows half_cols"]

    def of_height(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> Float[Array, "rows columns"]:
        along_x, along_y = self._along(x, y)
        return along_y @ (self.pairs @ along_x.T)

    def of_slope(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> Float[Array, "rows columns 2"]:
        along_x, along_y = self._along(x, y)
        spread_x = along_x * (x[:, None] - self.x.nodes) ** 2
        spread_y = along_y * (y[:, None] - self.y.nodes) ** 2
        slope = np.empty((len(y), len(x), 2))
        slope[..., 0] = along_y @ (self.pairs @ spread_x.T - self.apart[0] @ along_x.T)
        slope[..., 1] = spread_y @ (self.pairs @ along_x.T) - along_y @ (self.apart[1] @ along_x.T)
        slope *= 4 / self.length_scale**4
        return slope

    def _along(
        self, x: Float[Array, "columns"], y: Float[Array, "rows"]
    ) -> tuple[Float[Floats, "columns half_cols"], Float[Floats, "rows half_rows"]]:
        width = self.length_scale / np.sqrt(2)
        return gaussian(x, self.x, width), gaussian(y, self.y, width)


class WeightSpace:
    """The factorised posterior precision Q of the bumps' weights.

    The nodes are divided into blocks of `_band` rows, so that each block meets only the next one.
    A block keeps the columns that data can reach; the other columns keep their prior.
    """

    def __init__(
        self,
        cloud: Cloud,
        kernel: SquaredExponential,
        information: float,
        spacing: float,
        advance: Progress,
    ) -> None:
        """Factorise over nodes at a spacing [m]; NotPositiveDefiniteError if rounding prevents."""
        self._length_scale = length = kernel.length_scale
        self._dtype = np.float32 if information <= MOST_INFORMATION_IN_SINGLE else np.float64
        self._refined = self._dtype is np.float32 and information > MOST_INFORMATION_UNREFINED
        xy, precision = cloud.xy, 1 / cloud.noise_variance
        self._band = band_of(information, spacing / length)
        low, high = xy.min(axis=0), xy.max(axis=0)
        margin = margin_of(information)
        self._x = LatticeAxis.covering(low[0], high[0], spacing, margin * length)
        y = LatticeAxis.covering(low[1], high[1], spacing, margin * length)
        self._num_blocks = -(-y.count // self._band)
        self._y = LatticeAxis(y.start, spacing, self._num_blocks * self._band)
        self._spacing_ratio = spacing / length
        self._scale2 = kernel.signal_std**2 * 2 * self._spacing_ratio**2 / np.pi  # s_h²
        reach = gaussian_reach(information, CUT)
        # A refinement needs a residual in float64.
        digits = np.float64 if self._refined else self._dtype
        self._splat = Splat(xy, self._x, self._y, length, reach, digits)
        self._precision = precision
        overlap = Splat(xy, self._x.halved, self._y.halved, length / np.sqrt(2), reach, digits)
        summed = overlap.to_nodes(self._scale2 * precision)  # s_h² G
        reached = summed[::2, ::2] > self._scale2 * precision.min() * np.exp(-2 * margin**2)
        self._overlap = np.where(summed < NEGLIGIBLE, 0.0, summed).astype(self._dtype)
        self._windows = [
            _span(reached[rows].any(axis=0)) for rows in map(self._rows, range(self._num_blocks))
        ]
        self._decays = (self._pair_decay(0), self._pair_decay(1))
        self._factor = self._factorise(advance)

    @property
    def num_bytes(self) -> int:
        return sum(block.nbytes for block in [*self._factor.inverses, *self._factor.gains])

    def _rows(self, block: int) -> slice:
        return slice(block * self._band, (block + 1) * self._band)

    def _decay(self, nodes_apart: Float[Floats, "*shape"]) -> Float[Floats, "*shape"]:
        """Compute ``exp(-d² / (2 l²))`` along one axis, with zeros in place of denormal numbers."""
        decay = np.exp(-0.5 * (nodes_apart * self._spacing_ratio) ** 2)
        return np.where(decay < NEGLIGIBLE, 0.0, decay).astype(self._dtype)

    def _row_decay(self, blocks_apart: int) -> Float[Floats, "r r"]:
        apart = self._rows_apart(blocks_apart)
        return np.where(np.abs(apart) <= self._band, self._decay(apart), self._dtype(0))

    def _rows_apart(self, blocks_apart: int) -> Float[Floats, "r r"]:
        rows = np.arange(self._band, dtype=np.float64)
        return rows[:, None] - rows + blocks_apart * self._band

    def _pair_decay(self, blocks_apart: int) -> Float[Floats, "r columns r columns"]:
        columns = np.arange(self._x.count, dtype=np.float64)
        along_x = self._decay(columns[:, None] - columns)
        return self._row_decay(blocks_apart)[:, None, :, None] * along_x[None, :, None, :]

    def _couple(self, i: int, j: int) -> Float[Floats, "m_i m_j"]:
        a, b = self._windows[i], self._windows[j]
        shape = (self._band, a.stop - a.start, self._band, b.stop - b.start)
        # G at the midpoints of all pairs of nodes, as a view.
        midpoints = as_strided(
            self._overlap[(i + j) * self._band :, a.start + b.start :],
            shape,
            self._overlap.strides * 2,
            writeable=False,
        )
        pairs = np.empty(shape, self._dtype)  # contiguous, so that the reshape makes no copy
        np.multiply(midpoints, self._decays[i - j][:, a, :, b], out=pairs)
        return pairs.reshape(shape[0] * shape[1], shape[2] * shape[3])

    def _factorise(self, advance: Progress) -> Factor:
        factor = Factor([], [])
        pivot = self._couple(0, 0)
        for i in range(self._num_blocks):
            np.einsum("ii->i", pivot)[:] += 1
            factor.inverses.append(invert_pivot(pivot))
            if i + 1 < self._num_blocks:
                pivot = self._couple(i + 1, i + 1)
                coupling = self._couple(i + 1, i)
                factor.gains.append(self._eliminate(factor.inverses[i], coupling, pivot))
            advance(1 / self._num_blocks)
        return factor

    def _eliminate(
        self,
        inverse: Float[Floats, "m m"],
        coupling: Float[Floats, "n m"],
        pivot: Float[Floats, "n n"],
    ) -> Float[Floats, "n m"]:
        """Subtract ``coupling inverse couplingᵀ`` from the next block's pivot; return the gain."""
        width, before = len(coupling) // self._band, len(inverse) // self._band
        gain = np.empty_like(coupling)
        for row in range(self._band):
            own, met = slice(row * width, (row + 1) * width), slice(row * before, None)
            np.matmul(coupling[own, met], inverse[met], out=gain[own])
            pivot[: own.stop, own] -= gain[: own.stop, met] @ coupling[own, met].T
        return gain

    def variance_reduction(self) -> VarianceReduction:
        """Sum ``I - Q⁻¹`` by midpoints: the V of the module's docstring, without the prior's."""
        band = self._band
        # Sorted by the row of the midpoint, the columns apart, and the first column. In the second
        # half each pair is also weighted by the square of the rows apart.
        sums = np.zeros((2, 2 * self._y.count - 1, 2 * band + 1, self._x.count), self._dtype)
        by_row = [self._midpoint_rows(blocks_apart) for blocks_apart in (0, 1)]
        for i, diagonal, below in self._factor.inverse_blocks():
            reduced = diagonal.copy()  # the recursion still needs the original
            np.einsum("ii->i", reduced)[:] -= 1
            self._add_pairs(sums, i, i, reduced, by_row[0])
            if below is not None:
                self._add_pairs(sums, i + 1, i, below, 2 * by_row[1])  # and its mirror image
        images = np.zeros((3, *self._overlap.shape))  # V; V with δ² along x; along y
        columns_apart = np.arange(-band, band + 1)
        sums *= self._decay(columns_apart.astype(np.float64))[:, None]
        for k, apart in enumerate(columns_apart):
            first, last = max(0, -apart), self._x.count - max(0, apart)
            if last <= first:  # a band wider than the lattice
                continue
            into = images[:, :, 2 * first + apart : 2 * last + apart - 1 : 2]
            together = sums[0, :, k, first:last]
            into[0] += together
            into[1] += apart**2 * together
            into[2] += sums[1, :, k, first:last]
        images *= -self._scale2
        images[1:] *= (self._x.spacing / 2) ** 2
        return VarianceReduction(
            self._length_scale, self._x.halved, self._y.halved, images[0], images[1:]
        )

    def _add_pairs(
        self,
        sums: Float[Floats, "2 half_rows columns_apart columns"],
        i: int,
        j: int,
        block: Float[Floats, "m_i m_j"],
        by_row: Float[Floats, "twice_midpoints row_pairs"],
    ) -> None:
        """Add a block of pairs of nodes, sorted by the midpoint's row and the columns apart."""
        a, b = self._windows[i], self._windows[j]
        band, width = self._band, a.stop - a.start
        # The columns of the other block, from `band` before the first to `band` after the last.
        padded = np.zeros((band, width, band, width + 2 * band), self._dtype)
        first, last = max(b.start, a.start - band), min(b.stop, a.stop + band)
        if last <= first:
            return
        pairs = block.reshape(band, width, band, b.stop - b.start)
        shift = band - a.start
        padded[..., first + shift : last + shift] = pairs[..., first - b.start : last - b.start]
        step = padded.strides
        # Pairs (column c, column c + apart) as a view (row, row', apart, c).
        diagonals = as_strided(
            padded,
            (band, band, 2 * band + 1, width),
            (step[0], step[2], step[3], step[1] + step[3]),
            writeable=False,
        )
        rows = by_row @ diagonals.reshape(band * band, -1)
        into_rows = slice((i + j) * band, (i + j) * band + 2 * band - 1)
        sums[:, into_rows, :, a] += rows.reshape(2, 2 * band - 1, 2 * band + 1, width)

    def _midpoint_rows(self, blocks_apart: int) -> Float[Floats, "twice_midpoints row_pairs"]:
        """Make the matrix that sums pairs of rows by their midpoint, weighted by their decay."""
        band = self._band
        sums = np.add.outer(np.arange(band), np.arange(band)).ravel()
        apart = self._rows_apart(blocks_apart).ravel()
        matrix = np.zeros((2, 2 * band - 1, band**2), self._dtype)
        matrix[0, sums, np.arange(band**2)] = self._row_decay(blocks_apart).ravel()
        matrix[1] = matrix[0] * apart**2
        return matrix.reshape(-1, band**2)

    def precondition(self, residual: Float[Array, "n"]) -> Float[Array, "n"]:
        """Apply ``(Φ Φᵀ + D)⁻¹``, near the inverse of ``K + D``, by Woodbury's identity."""
        whitened = residual * self._precision
        right = self._splat.to_nodes(whitened)  # all weights here are s_h times smaller
        weights = self._solve(right)
        if self._refined:
            fitted = self._scale2 * self._precision * self._splat.to_points(weights)
            weights += self._solve(right - weights - self._splat.to_nodes(fitted))
        return whitened - self._scale2 * self._precision * self._splat.to_points(weights)

    def _solve(self, right: Float[Array, "rows columns"]) -> Float[Array, "rows columns"]:
        narrow = right.astype(self._dtype)
        blocks = [(self._rows(i), window) for i, window in enumerate(self._windows)]
        solution = self._factor.solve([narrow[block].ravel() for block in blocks])
        weights = np.zeros_like(right)
        for block, values in zip(blocks, solution, strict=True):
            weights[block] = values.reshape(self._band, -1)
        return weights


def margin_of(information: float) -> float:
    """Find how far the lattice must reach beyond the points [length-scales]."""
    return max(LEAST_MARGIN, float(np.sqrt(np.log(information / BEYOND) / 2)))


def band_of(information: float, spacing_ratio: float) -> int:
    """Compute the number of nodes beyond which two bumps hardly overlap."""
    return max(2, int(np.ceil(np.sqrt(2 * np.log(information / DROPPED)) / spacing_ratio)) - 1)


def _span(reached: Bool[Mask, "columns"]) -> slice:
    columns = np.flatnonzero(reached)
    return slice(int(columns[0]), int(columns[-1]) + 1) if len(columns) else slice(0, 1)
