"""The exact GP for dense clouds: weight space for its factor, the kernel itself for its mean.

The lattice of `weight_space`, in strips that see enough of their neighbours, gives the variance;
cost is linear in area. The mean is not left to it: small noise amplifies a ripple in the kernel,
and the mean is less local than the variance. It is solved for over all strips at once, on the
kernel itself, with the strips as the preconditioner: three or four steps.
"""

import threading
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.gp.accuracy import EXACT, Accuracy
from gpgrad_core.gp.block_tridiagonal import NotPositiveDefiniteError
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.fine_kernel import FineKernel, MeanField
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.solution import TerrainFields, clip_variance
from gpgrad_core.gp.spacing import check_solvable, information, lattice_spacing
from gpgrad_core.gp.weight_space import MARGIN, VarianceReduction, WeightSpace, band_of
from gpgrad_core.run.progress import Cancelled, Progress, silent
from gpgrad_core.run.threads import num_workers, single_threaded_blas
from gpgrad_core.types import Grid

PANEL_HALO = 7.0
"""Length-scales of neighbouring points that a panel's mean is solved with beside its own: at the
seam itself it is then within 0.008 of the noise, and its slope within 0.3 %."""
MOST_PANEL_BYTES = 1 << 29
"""Of the factors that are held at once while the mean of a panel is solved for."""
FIXED_COST = 20.0**3
"""What a strip costs however narrow it is; its cost beside that is its columns cubed."""
MAX_STEPS = 50
MAX_STRIPS = 1024
SECONDS_A_PRODUCT, SECONDS_A_BLOCK, SECONDS_A_POINT, SECONDS = 6.2e-11, 9e-4, 2.0e-5, 0.011
"""What a fit and its samples took on two cores of 2.8 GHz: by the cube of the nodes in a block,
by blocks and points (fitted to 90 clouds and length-scales, within 25 %)."""


@dataclass(frozen=True, eq=False)
class Strip:
    """The variance over one stretch of x."""

    low: float  # this strip answers for low <= x < high [m]
    high: float
    reduction: VarianceReduction


@dataclass(frozen=True, eq=False)
class Panel:
    """The mean over one stretch of x: as many strips as are solved together."""

    low: float  # this panel answers for low <= x < high [m]
    high: float
    mean: MeanField
    strips: tuple[Strip, ...]  # from low to high x; the prior holds where there is none


@dataclass(frozen=True, eq=False)
class LatticePosterior:
    """A fitted GP that can be sampled on any grid."""

    kernel: SquaredExponential
    mean: float  # taken off before, added after [m]
    panels: tuple[Panel, ...]  # from low to high x

    @property
    def strips(self) -> tuple[Strip, ...]:
        """Strips of all panels, from low to high x."""
        return tuple(strip for panel in self.panels for strip in panel.strips)

    def sample(self, grid: Grid) -> TerrainFields:
        """Infer elevation [m], its variance and slope [m/m] at every cell, Eqs. (2)-(5)."""
        fields = TerrainFields.prior(grid, self.kernel, self.mean)

        def mean(panel: Panel) -> None:
            own = _columns(grid, panel)
            height, slope_x, slope_y = panel.mean.sample(grid.x[own], grid.y)
            fields.elevation[:, own] += height
            fields.slope[:, own, 0] = slope_x
            fields.slope[:, own, 1] = slope_y

        def variance(strip: Strip) -> None:
            own = _columns(grid, strip)
            fields.variance[:, own] -= strip.reduction.of_height(grid.x[own], grid.y)

        with single_threaded_blas(), ThreadPoolExecutor(num_workers()) as executor:
            tasks = [executor.submit(mean, panel) for panel in self.panels]
            tasks += [executor.submit(variance, strip) for strip in self.strips]
        for task in tasks:
            task.result()
        clip_variance(fields.variance, self.kernel.signal_std**2)
        return fields

    def sample_slope_variance(self, grid: Grid) -> Float[Array, "rows columns 2"]:
        """Infer the variance of both slopes [m²/m²] at every cell."""
        prior = self.kernel.slope_std**2
        variance = np.full((*grid.shape, 2), prior)
        with single_threaded_blas():
            for strip in self.strips:
                own = _columns(grid, strip)
                variance[:, own] -= strip.reduction.of_slope(grid.x[own], grid.y)
        return clip_variance(variance, prior)


def _columns(grid: Grid, stretch: Strip | Panel) -> slice:
    first, last = np.searchsorted(grid.x, (stretch.low, stretch.high))
    return slice(int(first), int(last))


def fit_lattice(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
    accuracy: Accuracy = EXACT,
    progress: Progress = silent,
) -> LatticePosterior:
    """Fit the GP of Eq. (1) to points; cost linear in the points and in the area.

    Args:
        points: Positions [m].
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights, one for all or one a point [m].
        mean: Height that is taken off before and added after [m]; None: the points' mean.
        accuracy: How exact it is to be.
        progress: Called once a block of lattice rows.

    Raises:
        InputError: If the lattice would be too large, or the equations cannot be solved to
            the accuracy; says which parameter to change.
    """
    offset = float(points[:, 2].mean()) if mean is None else mean
    cloud = Cloud.of(points, noise_std, offset)
    bits = information(cloud.xy, cloud.noise_variance, kernel)
    check_solvable(cloud.xy, kernel, bits)
    spacing = lattice_spacing(kernel.length_scale, bits, accuracy.ripple)
    halo = accuracy.lattice_halo * kernel.length_scale
    edges = _strip_edges(cloud.xy, kernel.length_scale, spacing, halo)
    groups = _panels(cloud.xy, edges, kernel.length_scale, spacing, halo, bits)
    report = _SharedProgress(progress, len(edges) - 1)
    panels: list[Panel] = []
    with single_threaded_blas(), ThreadPoolExecutor(num_workers()) as executor:
        for group in groups:
            fitter = _PanelFitter(kernel, bits, spacing, accuracy, report, executor)
            panels.append(fitter.fit(cloud, group))
    return LatticePosterior(kernel, offset, tuple(panels))


def estimate_seconds(
    xy: Float[Array, "n 2"],
    kernel: SquaredExponential,
    information: float,
    accuracy: Accuracy = EXACT,
) -> float:
    """Estimate what a fit takes [s], to tell whether another solver would be faster.

    Args:
        xy: Positions of the points [m].
        kernel: Covariance of the terrain.
        information: Largest precision that data bring to one bump, see `spacing`.
        accuracy: How exact it is to be.
    """
    length = kernel.length_scale
    spacing = lattice_spacing(length, information, accuracy.ripple)
    band, margins = band_of(information, spacing / length), 2 * MARGIN * length
    halo = accuracy.lattice_halo * length
    (left, _), (right, _) = low, high = xy.min(axis=0), xy.max(axis=0)
    blocks = (high - low + margins)[1] / spacing / band
    inner = np.clip(_strip_edges(xy, length, spacing, halo), left, right)
    seen = np.minimum(inner[1:] + halo, right) - np.maximum(inner[:-1] - halo, left)
    products = blocks * np.sum(((seen + margins) / spacing * band) ** 3)
    return float(
        SECONDS
        + SECONDS_A_PRODUCT * products
        + SECONDS_A_BLOCK * blocks * len(seen)
        + SECONDS_A_POINT * len(xy)
    )


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


@dataclass(frozen=True, eq=False)
class _Preconditioner:
    """A strip while the mean is solved for."""

    members: Int[NDArray[np.intp], "m"]  # points that it sees
    owned: Bool[NDArray[np.bool_], "m"]  # of these, those that it writes
    weight_space: WeightSpace


@dataclass(frozen=True)
class _PanelFitter:
    """What all strips of a panel are fitted with."""

    kernel: SquaredExponential
    information: float
    spacing: float  # [m]
    accuracy: Accuracy
    report: _SharedProgress
    executor: Executor

    def fit(self, cloud: Cloud, edges: Float[Array, "edges"]) -> Panel:
        """Fit the strips between edges, then the mean over all of them."""
        halo = PANEL_HALO * self.kernel.length_scale
        x = cloud.xy[:, 0]
        seen = cloud.select((x >= edges[0] - halo) & (x < edges[-1] + halo))
        # The outermost strips also solve for the points that the panel only sees.
        inner = edges[1:-1]
        owner = np.searchsorted(inner, seen.xy[:, 0], side="right")
        stretches = list(pairwise(edges))

        def fit_strip(k: int) -> tuple[_Preconditioner | None, Strip | None]:
            return self._fit_strip(seen, owner, k, stretches[k])

        fitted = list(self.executor.map(fit_strip, range(len(stretches))))
        fine = FineKernel(seen, self.kernel, self.information)
        weights = self._solve(seen, fine, [part for part, _ in fitted if part is not None])
        strips = tuple(strip for _, strip in fitted if strip is not None)
        return Panel(float(edges[0]), float(edges[-1]), fine.field(weights), strips)

    def _fit_strip(
        self,
        cloud: Cloud,
        owner: Int[NDArray[np.intp], "n"],
        k: int,
        stretch: tuple[float, float],
    ) -> tuple[_Preconditioner | None, Strip | None]:
        low, high = stretch
        x, halo = cloud.xy[:, 0], self.accuracy.lattice_halo * self.kernel.length_scale
        near = (owner == k) | ((x >= low - halo) & (x < high + halo))
        if not near.any():
            self.report.advance(1.0)
            return None, None
        members = np.flatnonzero(near)
        try:
            weight_space = WeightSpace(
                cloud.select(members),
                self.kernel,
                self.information,
                self.spacing,
                lambda done: self.report.advance(0.6 * done),
            )
        except NotPositiveDefiniteError as error:
            raise InputError(
                f"the GP cannot be solved at length-scale {self.kernel.length_scale:g} m with so "
                "little noise: raise noise_std or lower the length-scale"
            ) from error
        reduction = weight_space.variance_reduction()
        self.report.advance(0.4)
        part = _Preconditioner(members, owner[members] == k, weight_space)
        return part, Strip(low, high, reduction)

    def _solve(
        self, cloud: Cloud, fine: FineKernel, parts: list[_Preconditioner]
    ) -> Float[Array, "n"]:
        """Solve ``(K + D) weights = heights`` by generalised conjugate residuals.

        The preconditioner, in which every strip writes its own points only (restricted additive
        Schwarz), is not symmetric: plain conjugate gradients would not do.
        """
        weights = np.zeros_like(cloud.heights)
        residual = cloud.heights.copy()
        if not residual.any():  # perfectly flat ground: nothing to solve, and no way to step
            return weights
        inverse_noise = 1 / cloud.noise_variance
        steps: list[tuple[Array, Array]] = []  # directions and their images, these orthonormal
        for _ in range(MAX_STEPS):
            step = self._precondition(residual, parts)
            image = fine.times(step) + cloud.noise_variance * step
            for direction, earlier in steps:
                along = (inverse_noise * earlier) @ image
                image -= along * earlier
                step -= along * direction
            size = np.sqrt((inverse_noise * image) @ image)
            if size == 0:
                break
            image /= size
            step /= size
            steps.append((step, image))
            length = (inverse_noise * image) @ residual
            weights += length * step
            residual -= length * image
            if cloud.residual_rms(residual) <= self.accuracy.residual:
                return weights
        raise InputError(
            f"the GP did not converge in {MAX_STEPS} steps with so little noise: raise noise_std "
            "or lower the length-scale"
        )

    def _precondition(
        self, residual: Float[Array, "n"], parts: list[_Preconditioner]
    ) -> Float[Array, "n"]:
        step = np.zeros_like(residual)

        def solve(part: _Preconditioner) -> Float[Array, "owned"]:
            return part.weight_space.precondition(residual[part.members])[part.owned]

        for part, solved in zip(parts, self.executor.map(solve, parts), strict=True):
            step[part.members[part.owned]] = solved
        return step


def _strip_edges(
    xy: Float[Array, "n 2"], length_scale: float, spacing: float, halo: float
) -> Float[Array, "edges"]:
    """Cut the stretch of x so that fitting all strips takes the least time.

    A strip's cost grows with the cube of its width, and it must see the halo of each neighbour
    and reach the margin beyond: too few strips are wide, too many mostly overlap.
    """
    low, high = float(xy[:, 0].min()), float(xy[:, 0].max())
    width = high - low
    counts = np.arange(1, 1 + min(MAX_STRIPS, int(width / halo) + 1))
    rounds = np.ceil(counts / 2)  # as on two cores, anywhere: cuts must not depend on the machine
    shared = halo * np.minimum(counts - 1, 2) + 2 * MARGIN * length_scale
    columns = (width / counts + shared) / spacing
    cost = rounds * (columns**3 + FIXED_COST)
    edges = np.linspace(low, high, int(counts[np.argmin(cost)]) + 1)
    edges[0], edges[-1] = -np.inf, np.inf  # the outermost strips answer for all beyond
    return edges


def _panels(
    xy: Float[Array, "n 2"],
    edges: Float[Array, "edges"],
    length_scale: float,
    spacing: float,
    halo: float,
    information: float,
) -> list[Float[Array, "edges_of_panel"]]:
    """Group strips so that the factors of a group fit the memory."""
    sides = xy.max(axis=0) - xy.min(axis=0)
    num_strips = len(edges) - 1
    columns = (sides[0] / num_strips + 2 * (halo + MARGIN * length_scale)) / spacing
    rows = sides[1] / spacing
    a_strip = 2 * rows * columns**2 * band_of(information, spacing / length_scale) * 4
    together = max(1, int(MOST_PANEL_BYTES / a_strip))
    num_panels = -(-num_strips // together)
    cuts = np.linspace(0, num_strips, num_panels + 1).round().astype(int)
    return [edges[a : b + 1] for a, b in pairwise(cuts)]
