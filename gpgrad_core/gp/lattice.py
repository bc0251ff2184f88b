"""The exact GP, fast: weights on a lattice factorise it, the kernel itself corrects it.

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
recursion in matrix products. The mean is not left to the lattice: small noise amplifies a ripple
in the kernel. Conjugate gradients on the kernel itself, preconditioned by Q through Woodbury's
identity, correct it in two or three steps.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from gpgrad_core.errors import InputError
from gpgrad_core.gp.block_tridiagonal import Factor, NotPositiveDefiniteError, invert_pivot
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.splat import Axis, Splat, gaussian, gaussian_slope
from gpgrad_core.gp.threads import num_workers, single_threaded_blas
from gpgrad_core.progress import Cancelled, Progress, silent
from gpgrad_core.types import Array, Grid

RIPPLE = 0.08
"""Ripple of the lattice kernel times information of the data that is let pass: the standard
deviation is then within about 2 % (measured: 0.3 x this), and the mean takes two or three steps."""
DROPPED = 0.05
"""Largest entry left out of Q beside its band, relative to the prior precision."""
MARGIN = 2.5
"""Length-scales by which the lattice reaches beyond the points: exp(-2 x 2.5²) is 4e-6."""
HALO = 6.0
"""Length-scales of neighbouring points that a strip sees beside its own. Measured at the seam
itself: elevation within 0.015 of the noise, slope within 0.7 %; with one less, thrice that."""
FINE_SPACING = 0.5
"""Spacing, in length-scales, at which the lattice kernel is the kernel: ripple 5e-9."""
FINE_MARGIN = 3.5
MEAN_TOLERANCE = 0.005
"""Conjugate gradients stop at this residual of the heights, in units of the noise (rms)."""
MAX_STEPS = 50
MAX_STRIPS = 256
MAX_NODES = 4_000_000


@dataclass(frozen=True, eq=False)
class Strip:
    """The fitted GP over one stretch of x: two small lattices of weights."""

    low: float  # this strip answers for low <= x < high [m]
    high: float
    mean_axes: tuple[Axis, Axis]  # (x, y) of `mean_weights`
    mean_weights: Float[Array, "mean_rows mean_columns"]
    variance_axes: tuple[Axis, Axis]  # (x, y) of `variance_weights`
    variance_weights: Float[Array, "variance_rows variance_columns"]  # of the prior's reduction


@dataclass(frozen=True, eq=False)
class LatticePosterior:
    """A fitted GP that can be sampled on any grid."""

    kernel: SquaredExponential
    mean: float  # taken off before, added after [m]
    strips: tuple[Strip, ...]  # from low to high x; the prior holds where there is none

    def sample(
        self, grid: Grid
    ) -> tuple[
        Float[Array, "rows columns"], Float[Array, "rows columns"], Float[Array, "rows columns 2"]
    ]:
        """Infer elevation [m], variance [m²] and slope [m/m] at every cell, Eqs. (2)-(5).

        Separability makes each field a product of three matrices.
        """
        prior = self.kernel.signal_std**2
        elevation = np.full(grid.shape, self.mean)
        variance = np.full(grid.shape, prior)
        slope = np.zeros((*grid.shape, 2))
        length = self.kernel.length_scale
        for strip in self.strips:
            first, last = np.searchsorted(grid.x, (strip.low, strip.high))
            x, own = grid.x[first:last], slice(first, last)

            axis_x, axis_y = strip.mean_axes
            along_x, along_y = gaussian(x, axis_x, length), gaussian(grid.y, axis_y, length)
            half = strip.mean_weights @ along_x.T
            elevation[:, own] += along_y @ half
            slope[:, own, 0] = (along_y @ strip.mean_weights) @ gaussian_slope(x, axis_x, length).T
            slope[:, own, 1] = gaussian_slope(grid.y, axis_y, length) @ half

            axis_x, axis_y = strip.variance_axes
            width = length / np.sqrt(2)
            variance[:, own] -= (
                gaussian(grid.y, axis_y, width)
                @ strip.variance_weights
                @ gaussian(x, axis_x, width).T
            )
        # Rounding may leave a hair below zero or above the prior.
        np.clip(variance, 1e-12 * prior, prior, out=variance)
        return elevation, variance, slope


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Points as the fit wants them: sorted by y, heights about zero."""

    xy: Float[Array, "n 2"]  # [m]
    heights: Float[Array, "n"]  # [m]
    noise_variance: Float[Array, "n"]  # [m²]

    def select(self, chosen: NDArray[np.bool_]) -> "_Cloud":
        return _Cloud(self.xy[chosen], self.heights[chosen], self.noise_variance[chosen])

    @property
    def least_noise(self) -> float:
        """Smallest standard deviation of a height [m], for messages."""
        return float(np.sqrt(self.noise_variance.min()))


def fit_lattice(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
    progress: Progress = silent,
) -> LatticePosterior:
    """Fit the GP of Eq. (1) to points; cost linear in the points and in the area.

    Args:
        points: Positions [m].
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights, one for all or one a point [m].
        mean: Height that is taken off before and added after [m]; None: the points' mean.
        progress: Called once a block of lattice rows.

    Raises:
        InputError: If the lattice would be too large, or the equations cannot be solved to
            `MEAN_TOLERANCE`; says which parameter to change.
    """
    offset = float(points[:, 2].mean()) if mean is None else mean
    by_y = np.argsort(points[:, 1], kind="stable")
    cloud = _Cloud(
        points[by_y, :2],
        points[by_y, 2] - offset,
        np.broadcast_to(noise_std, len(points))[by_y] ** 2,
    )
    spacing = kernel.length_scale * _spacing_for(_information(cloud, kernel))
    _check_size(cloud, kernel, spacing)

    halo = HALO * kernel.length_scale
    stretches = list(pairwise(_strip_edges(cloud.xy[:, 0], halo, MARGIN * kernel.length_scale)))
    report = _SharedProgress(progress, len(stretches))

    def fit(stretch: tuple[float, float]) -> Strip | None:
        x = cloud.xy[:, 0]
        near = (x >= stretch[0] - halo) & (x < stretch[1] + halo)
        if not near.any():
            return None
        return _fit_strip(stretch, cloud.select(near), kernel, spacing, report)

    with single_threaded_blas(), ThreadPoolExecutor(num_workers()) as executor:
        strips = tuple(strip for strip in executor.map(fit, stretches) if strip is not None)
    return LatticePosterior(kernel, offset, strips)


class _SharedProgress:
    """Adds up the progress of strips that are fitted side by side; keeps a refusal for all."""

    def __init__(self, progress: Progress, num_strips: int) -> None:
        self._progress, self._num_strips = progress, num_strips
        self._done, self._lock = 0.0, threading.Lock()
        self._cancelled: Cancelled | None = None

    def advance(self, fraction: float) -> None:
        """Report that a further fraction of one strip is done."""
        with self._lock:
            if self._cancelled is not None:
                raise self._cancelled
            self._done += fraction / self._num_strips
            try:
                self._progress(min(self._done, 1.0))
            except Cancelled as cancelled:
                self._cancelled = cancelled
                raise


def _fit_strip(
    stretch: tuple[float, float],
    cloud: _Cloud,
    kernel: SquaredExponential,
    spacing: float,
    report: _SharedProgress,
) -> Strip:
    try:
        lattice = _Lattice(cloud, kernel, spacing, report)
    except NotPositiveDefiniteError as error:
        raise InputError(
            f"the GP cannot be solved at length-scale {kernel.length_scale:g} m with noise "
            f"{cloud.least_noise:g} m: raise the noise or lower the length-scale"
        ) from error
    variance_axes, variance_weights = lattice.variance_weights()
    fine, mean_axes, fine_scale = _fine_kernel(cloud.xy, kernel)
    weights = _solve_exactly(cloud, fine, fine_scale, lattice)
    report.advance(0.4)
    return Strip(
        *stretch, mean_axes, fine_scale * fine.to_nodes(weights), variance_axes, variance_weights
    )


class _Lattice:
    """The factorised posterior precision Q of the bumps' weights.

    Nodes are taken in blocks of `_band` rows, so that a block meets only the next. Each block
    keeps the columns from the first to the last that data can reach; the others keep their prior.
    """

    def __init__(
        self,
        cloud: _Cloud,
        kernel: SquaredExponential,
        spacing: float,
        report: _SharedProgress,
    ) -> None:
        length = kernel.length_scale
        xy, precision = cloud.xy, 1 / cloud.noise_variance
        information = _information(cloud, kernel)
        # Beyond this many nodes apart, two bumps share too little to matter.
        self._band = max(
            2,
            int(np.ceil(length / spacing * np.sqrt(2 * np.log(max(information, 1) / DROPPED)))) - 1,
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
        self._factor = self._factorise(report)

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

    def _factorise(self, report: _SharedProgress) -> Factor:
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
            report.advance(0.6 / self._num_blocks)
        return factor

    def variance_weights(self) -> tuple[tuple[Axis, Axis], Float[Array, "half_rows half_cols"]]:
        """Sum ``I - Q⁻¹`` by midpoints: how far the data bring V down; and its axes (x, y).

        The prior itself is left out, so that it holds exactly, also beyond the lattice.
        """
        summed = np.zeros_like(self._overlap)
        for i, diagonal, below in self._factor.inverse_blocks():
            reduced = diagonal.copy()  # the recursion goes on with its own
            np.einsum("ii->i", reduced)[:] -= 1
            self._add_pairs(summed, i, i, reduced)
            if below is not None:
                self._add_pairs(summed, i + 1, i, 2 * below)  # twice: for its mirror image too
        return (self._x.halved, self._y.halved), -self._scale2 * summed

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


def _information(cloud: _Cloud, kernel: SquaredExponential) -> float:
    """Largest precision that the data bring to one bump, relative to its prior: s² max G."""
    low = cloud.xy.min(axis=0)
    cells = np.floor((cloud.xy - low) / kernel.length_scale).astype(np.int64)
    _, owner = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
    densest = np.bincount(owner, weights=1 / cloud.noise_variance).max()
    return float(kernel.signal_std**2 * densest * np.pi / 2)


def _spacing_for(information: float) -> float:
    """Lattice spacing, in length-scales, whose ripple times the information is `RIPPLE`."""
    ripple = RIPPLE / max(information, 1.0)
    return float(np.clip(np.pi / np.sqrt(2 * np.log(2 / ripple)), FINE_SPACING, 0.8))


def _check_size(cloud: _Cloud, kernel: SquaredExponential, spacing: float) -> None:
    width, height = cloud.xy.max(axis=0) - cloud.xy.min(axis=0)
    nodes = (width / spacing + 1) * (height / spacing + 1)
    if nodes > MAX_NODES:
        raise InputError(
            f"length-scale {kernel.length_scale:g} m is too short for a cloud of "
            f"{width:,.0f} m x {height:,.0f} m: the GP would need {nodes:,.0f} nodes, more than "
            f"the {MAX_NODES:,} allowed; raise the length-scale or cut the cloud into submaps"
        )


def _strip_edges(x: Float[Array, "n"], overlap: float, margin: float) -> Float[Array, "edges"]:
    """Cut the stretch of x so that fitting all strips takes the least time.

    A strip's cost grows with the cube of its width, and it must see ``overlap`` of each
    neighbour and reach ``margin`` beyond: too few strips are wide, too many mostly overlap.
    """
    low, high = float(x.min()), float(x.max())
    width = high - low
    counts = np.arange(1, 1 + min(MAX_STRIPS, int(width / overlap) + 1))
    rounds = np.ceil(counts / 2)  # as on two cores, anywhere: cuts must not depend on the machine
    shared = overlap * np.minimum(counts - 1, 2) + 2 * margin
    cost = rounds * (width / counts + shared) ** 3
    edges = np.linspace(low, high, int(counts[np.argmin(cost)]) + 1)
    edges[0], edges[-1] = -np.inf, np.inf  # the outermost strips answer for all beyond
    return edges


def _fine_kernel(
    xy: Float[Array, "n 2"], kernel: SquaredExponential
) -> tuple[Splat, tuple[Axis, Axis], float]:
    """The kernel to rounding, as bumps on a fine lattice: ``K v = scale Φ (Φᵀ v)``."""
    length = kernel.length_scale
    low, high = xy.min(axis=0), xy.max(axis=0)
    x, y = (
        Axis.covering(low[k], high[k], FINE_SPACING * length, FINE_MARGIN * length) for k in (0, 1)
    )
    scale = kernel.signal_std**2 * 2 * FINE_SPACING**2 / np.pi
    return Splat(xy, x, y, length), (x, y), scale


def _solve_exactly(
    cloud: _Cloud,
    fine: Splat,
    fine_scale: float,
    lattice: _Lattice,
) -> Float[Array, "n"]:
    """Solve ``(K + D) weights = heights`` by preconditioned conjugate gradients."""
    noise_variance = cloud.noise_variance
    weights = np.zeros_like(cloud.heights)
    residual = cloud.heights.copy()
    direction = step = lattice.precondition(residual)
    energy = residual @ step
    for _ in range(MAX_STEPS):
        image = fine_scale * fine.to_points(fine.to_nodes(direction)) + noise_variance * direction
        length = energy / (direction @ image)
        weights += length * direction
        residual -= length * image
        if np.sqrt(np.mean(residual**2 / noise_variance)) <= MEAN_TOLERANCE:
            return weights
        step = lattice.precondition(residual)
        energy, previous = residual @ step, energy
        direction = step + (energy / previous) * direction
    raise InputError(
        f"the GP did not converge in {MAX_STEPS} steps with noise "
        f"{cloud.least_noise:g} m: raise the noise or lower the length-scale"
    )
