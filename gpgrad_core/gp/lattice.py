"""The exact GP for dense clouds: weight space for its factor, the kernel itself for its mean.

The lattice of `weight_space` gives the variance, and a solver that is nearly right. The mean is
not left to it: small noise amplifies a ripple in the kernel. Conjugate gradients on the kernel
itself, with the lattice as their preconditioner, correct it in two or three steps. Wide clouds
are cut into strips that see enough of their neighbours, so that cost is linear in area.
"""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from gpgrad_core.errors import InputError
from gpgrad_core.gp.block_tridiagonal import NotPositiveDefiniteError
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.fine_kernel import FineKernel, MeanField
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.spacing import check_solvable, lattice_spacing
from gpgrad_core.gp.threads import num_workers, single_threaded_blas
from gpgrad_core.gp.weight_space import MARGIN, RIPPLE, VarianceReduction, WeightSpace
from gpgrad_core.progress import Cancelled, Progress, silent
from gpgrad_core.types import Grid

Array = NDArray[np.float64]

HALO = 7.0
"""Length-scales of neighbouring points that a strip sees beside its own. Measured at the seam
itself: elevation within 0.008 of the noise, slope within 0.3 %; with one less, twice that."""
MEAN_TOLERANCE = 0.005
"""Conjugate gradients stop at this residual of the heights, in units of the noise (rms)."""
MAX_STEPS = 50
MAX_STRIPS = 256


@dataclass(frozen=True, eq=False)
class Strip:
    """The fitted GP over one stretch of x."""

    low: float  # this strip answers for low <= x < high [m]
    high: float
    mean: MeanField
    reduction: VarianceReduction


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
        """Infer elevation [m], variance [m²] and slope [m/m] at every cell, Eqs. (2)-(5)."""
        prior = self.kernel.signal_std**2
        elevation = np.full(grid.shape, self.mean)
        variance = np.full(grid.shape, prior)
        slope = np.zeros((*grid.shape, 2))
        for strip in self.strips:
            first, last = np.searchsorted(grid.x, (strip.low, strip.high))
            x, own = grid.x[first:last], slice(first, last)
            height, slope[:, own, 0], slope[:, own, 1] = strip.mean.sample(x, grid.y)
            elevation[:, own] += height
            variance[:, own] -= strip.reduction.sample(x, grid.y)
        # Rounding may leave a hair below zero or above the prior.
        np.clip(variance, 1e-12 * prior, prior, out=variance)
        return elevation, variance, slope


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
    cloud = Cloud.of(points, noise_std, offset)
    check_solvable(cloud, kernel)
    spacing = lattice_spacing(cloud, kernel, RIPPLE)
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
    cloud: Cloud,
    kernel: SquaredExponential,
    spacing: float,
    report: _SharedProgress,
) -> Strip:
    try:
        weight_space = WeightSpace(cloud, kernel, spacing, lambda done: report.advance(0.6 * done))
    except NotPositiveDefiniteError as error:
        raise InputError(
            f"the GP cannot be solved at length-scale {kernel.length_scale:g} m with so little "
            "noise: raise noise_std or lower the length-scale"
        ) from error
    reduction = weight_space.variance_reduction()
    fine = FineKernel(cloud, kernel)
    mean = fine.field(_solve_exactly(cloud, fine, weight_space))
    report.advance(0.4)
    return Strip(*stretch, mean, reduction)


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


def _solve_exactly(
    cloud: Cloud,
    fine: FineKernel,
    weight_space: WeightSpace,
) -> Float[Array, "n"]:
    """Solve ``(K + D) weights = heights`` by preconditioned conjugate gradients."""
    weights = np.zeros_like(cloud.heights)
    residual = cloud.heights.copy()
    if not residual.any():  # perfectly flat ground: nothing to solve, and no way to step
        return weights
    direction = step = weight_space.precondition(residual)
    energy = residual @ step
    for _ in range(MAX_STEPS):
        image = fine.times(direction) + cloud.noise_variance * direction
        length = energy / (direction @ image)
        weights += length * direction
        residual -= length * image
        if cloud.residual_rms(residual) <= MEAN_TOLERANCE:
            return weights
        step = weight_space.precondition(residual)
        energy, previous = residual @ step, energy
        direction = step + (energy / previous) * direction
    raise InputError(
        f"the GP did not converge in {MAX_STEPS} steps with so little noise: raise noise_std or "
        "lower the length-scale"
    )
