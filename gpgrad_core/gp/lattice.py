"""The exact GP for dense clouds: the variance in weight space, the mean with the kernel itself.

The lattice of `weight_space` gives the variance. It is divided into strips along x that also see
some of their neighbours' points, so the time grows linearly with the area. The mean needs more:
with little noise a ripple in the kernel is amplified, and the mean is less local than the variance.
So the mean is solved for over all strips at once, on the kernel itself, with the strips as the
preconditioner. That takes three or four steps.
"""

import threading
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, Indices, Mask
from gpgrad_core.errors import InputError
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import lattice_spacing
from gpgrad_core.gp.solution import Cost, GPProblem, Posterior, Solver, TerrainFields, clip_variance
from gpgrad_core.gp.splat import FineKernel, MeanField
from gpgrad_core.gp.weight_space import (
    MOST_INFORMATION_IN_SINGLE,
    NotPositiveDefiniteError,
    VarianceReduction,
    WeightSpace,
    band_of,
    margin_of,
)
from gpgrad_core.run import Cancelled, Progress, silent
from gpgrad_core.run.threads import own_threads, single_threaded_libraries
from gpgrad_core.types import Grid

PANEL_HALO = 7.0
"""Width of the neighbouring points that the mean of a panel is solved with [length-scales]."""
MOST_PANEL_BYTES = 1 << 29
"""Largest size of the factors that are kept while the mean of a panel is solved for."""
FIXED_COST = 20.0**3
"""Cost of a strip that does not depend on its width; its other cost is its columns cubed."""
BYTES_A_POINT = 1300
"""Memory of a point in the factors of its Gaussians."""
MOST_INFORMATION = 1e9
"""Beyond this information the lattice loses digits; tiles do not."""
MAX_STEPS = 50
MAX_STRIPS = 1024
"""Largest number of strips that is tried."""
MANY_STEPS = 1e5
"""Information from which a fit is taken to need twice as long; up to a hundredth of it, as long."""
SECONDS_A_PRODUCT, SECONDS_A_BLOCK, SECONDS_A_POINT, SECONDS = 6.2e-11, 9e-4, 2.0e-5, 0.011
"""Seconds of a fit and its samples on two cores of 2.8 GHz: for the cube of the nodes in a block,
for a block, for a point, and constant."""


@dataclass(frozen=True, eq=False)
class Strip:
    """The variance over one range of x."""

    low: float  # the strip is used for low <= x < high [m]
    high: float  # see ``low`` [m]
    reduction: VarianceReduction  # how much the data reduce the variance there


@dataclass(frozen=True, eq=False)
class Panel:
    """The mean over one range of x: the strips that are solved together."""

    low: float  # the panel is used for low <= x < high [m]
    high: float  # see ``low`` [m]
    mean: MeanField  # the posterior mean there
    # strips from low to high x; where there is none, the prior variance holds
    strips: tuple[Strip, ...]


@dataclass(frozen=True, eq=False)
class LatticePosterior(Posterior):
    """The posterior in panels from low to high x; where there is none, the prior holds."""

    panels: tuple[Panel, ...]

    @property
    def strips(self) -> tuple[Strip, ...]:
        return tuple(strip for panel in self.panels for strip in panel.strips)

    def sample(self, grid: Grid) -> TerrainFields:
        fields = TerrainFields.prior(grid, self.kernel, self.mean)

        def mean(panel: Panel) -> None:
            own = _columns(grid, panel)
            into = fields.elevation[:, own], fields.slope[:, own]
            panel.mean.add_to(grid.x[own], grid.y, *into)

        def variance(strip: Strip) -> None:
            own = _columns(grid, strip)
            fields.variance[:, own] -= strip.reduction.of_height(grid.x[own], grid.y)

        with own_threads() as executor:
            tasks = [executor.submit(mean, panel) for panel in self.panels]
            tasks += [executor.submit(variance, strip) for strip in self.strips]
        for task in tasks:
            task.result()
        clip_variance(fields.variance, self.kernel.signal_std**2)
        return fields

    def sample_slope_variance(self, grid: Grid) -> Float[Array, "rows columns 2"]:
        prior = self.kernel.slope_std**2
        variance = np.full((*grid.shape, 2), prior)
        with single_threaded_libraries():
            for strip in self.strips:
                own = _columns(grid, strip)
                variance[:, own] -= strip.reduction.of_slope(grid.x[own], grid.y)
        return clip_variance(variance, prior)


def _columns(grid: Grid, stretch: Strip | Panel) -> slice:
    first, last = np.searchsorted(grid.x, (stretch.low, stretch.high))
    return slice(int(first), int(last))


class LatticeSolver(Solver):
    """Takes a time that is linear in the points, and in the area in length-scales."""

    most_information = MOST_INFORMATION

    def fit(self, problem: GPProblem, progress: Progress = silent) -> LatticePosterior:
        layout = _StripLayout.of(problem)
        groups = layout.panels()
        report = _SharedProgress(progress, sum(len(edges) - 1 for edges in groups))
        with own_threads() as executor:
            fitter = _PanelFitter(problem, layout, report, executor)
            panels = [fitter.fit(edges) for edges in groups]
        fitted = tuple(panel for panel in panels if panel is not None)
        return LatticePosterior(problem.kernel, problem.mean, fitted)

    def cost(self, problem: GPProblem) -> Cost:
        layout, xy = _StripLayout.of(problem), problem.cloud.xy
        rows, band, halo = layout.rows, layout.band, layout.halo
        blocks = rows / band
        left, right = float(xy[:, 0].min()), float(xy[:, 0].max())
        inner = np.clip(layout.edges, left, right)
        widths = np.minimum(inner[1:] + halo, right) - np.maximum(inner[:-1] - halo, left)
        columns = (widths + 2 * layout.margin) / layout.spacing
        # Measured: with little noise, fits took up to twice as long as the products alone tell.
        steps = 1 + np.clip(np.log10(problem.information / MANY_STEPS) / 2 + 1, 0, 1)
        seconds = (
            SECONDS
            + steps * SECONDS_A_PRODUCT * blocks * np.sum((columns * band) ** 3)
            + SECONDS_A_BLOCK * blocks * len(widths)
            + SECONDS_A_POINT * len(xy)
        )
        factors = layout.bytes_a_strip * len(widths)
        # Three images of half the spacing for each strip.
        images = 12 * rows * columns.sum() * 8
        num_bytes = min(factors, MOST_PANEL_BYTES) + images + BYTES_A_POINT * len(xy)
        return Cost(float(seconds), float(num_bytes))


@dataclass(frozen=True, eq=False)
class _StripLayout:
    """How the lattice lies over the points; lengths in metres."""

    sides: Float[Array, "2"]  # of the points' box
    spacing: float  # of the nodes
    halo: float  # how far a strip sees beyond its edges
    margin: float  # how far the lattice reaches beyond the points
    band: int  # number of nodes beyond which two bumps hardly overlap
    digits: int  # bytes of a number of a factor
    edges: Float[Array, "edges"]  # of the strips; the outermost ones cover everything beyond

    @classmethod
    def of(cls, problem: GPProblem) -> "_StripLayout":
        """Choose the edges of the strips so that fitting all of them takes the least time."""
        accuracy, bits, xy = problem.accuracy, problem.information, problem.cloud.xy
        length = problem.kernel.length_scale
        spacing = lattice_spacing(length, bits, accuracy.ripple_of(bits))
        halo, margin = accuracy.lattice_halo_of(bits) * length, margin_of(bits) * length
        low, high = float(xy[:, 0].min()), float(xy[:, 0].max())
        width = high - low
        counts = np.arange(1, 1 + min(MAX_STRIPS, int(width / halo) + 1))
        # As on two cores, on any machine: the result must not depend on the number of cores.
        rounds = np.ceil(counts / 2)
        columns = (width / counts + halo * np.minimum(counts - 1, 2) + 2 * margin) / spacing
        cost = rounds * (columns**3 + FIXED_COST)
        edges = np.linspace(low, high, int(counts[np.argmin(cost)]) + 1)
        edges[0], edges[-1] = -np.inf, np.inf
        digits = 4 if bits <= MOST_INFORMATION_IN_SINGLE else 8
        sides = xy.max(axis=0) - xy.min(axis=0)
        return cls(sides, spacing, halo, margin, band_of(bits, spacing / length), digits, edges)

    @property
    def rows(self) -> float:
        return float((self.sides[1] + 2 * self.margin) / self.spacing)

    @property
    def bytes_a_strip(self) -> float:
        """Estimate the size of the factor of one strip [bytes]."""
        width = self.sides[0] / (len(self.edges) - 1)
        columns = (width + 2 * (self.halo + self.margin)) / self.spacing
        return float(2 * self.rows * columns**2 * self.band * self.digits)

    def panels(self) -> list[Float[Array, "edges_of_panel"]]:
        """Group the strips into panels so that the factors of a panel fit into the memory."""
        num_strips = len(self.edges) - 1
        together = max(1, int(MOST_PANEL_BYTES / self.bytes_a_strip))
        num_panels = -(-num_strips // together)
        cuts = np.linspace(0, num_strips, num_panels + 1).round().astype(int)
        return [self.edges[a : b + 1] for a, b in pairwise(cuts)]


class _SharedProgress:
    def __init__(self, progress: Progress, num_strips: int) -> None:
        self._progress, self._num_strips = progress, num_strips
        self._done, self._lock = 0.0, threading.Lock()
        self._cancelled: Cancelled | None = None

    def advance(self, fraction: float) -> None:
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
    members: Int[Indices, "m"]  # the points that the strip sees
    owned: Bool[Mask, "m"]  # which of these it writes
    weight_space: WeightSpace


@dataclass(frozen=True)
class _PanelFitter:
    problem: GPProblem
    layout: _StripLayout
    report: _SharedProgress
    executor: Executor

    def fit(self, edges: Float[Array, "edges"]) -> Panel | None:
        """Fit the strips between the edges, then the mean over all; None if they see no point."""
        cloud, kernel = self.problem.cloud, self.problem.kernel
        halo = PANEL_HALO * kernel.length_scale
        x = cloud.xy[:, 0]
        visible = cloud.select((x >= edges[0] - halo) & (x < edges[-1] + halo))
        if len(visible) == 0:
            self.report.advance(len(edges) - 1.0)
            return None
        # The outermost strips also write the points beyond the panel's edges.
        inner = edges[1:-1]
        owner = np.searchsorted(inner, visible.xy[:, 0], side="right")
        stretches = list(pairwise(edges))

        def fit_strip(k: int) -> tuple[_Preconditioner | None, Strip | None]:
            return self._fit_strip(visible, owner, k, stretches[k])

        fitted = list(self.executor.map(fit_strip, range(len(stretches))))
        fine = FineKernel(visible, kernel, self.problem.information)
        weights = self._solve(visible, fine, [part for part, _ in fitted if part is not None])
        strips = tuple(strip for _, strip in fitted if strip is not None)
        return Panel(float(edges[0]), float(edges[-1]), fine.field(weights), strips)

    def _fit_strip(
        self, cloud: Cloud, owner: Int[Indices, "n"], k: int, stretch: tuple[float, float]
    ) -> tuple[_Preconditioner | None, Strip | None]:
        (low, high), kernel = stretch, self.problem.kernel
        x, halo = cloud.xy[:, 0], self.layout.halo
        near = (owner == k) | ((x >= low - halo) & (x < high + halo))
        if not near.any():
            self.report.advance(1.0)
            return None, None
        members = np.flatnonzero(near)
        try:
            weight_space = WeightSpace(
                cloud.select(members),
                kernel,
                self.problem.information,
                self.layout.spacing,
                lambda done: self.report.advance(0.6 * done),
            )
        except NotPositiveDefiniteError as error:
            raise InputError(
                f"the GP cannot be solved at length-scale {kernel.length_scale:g} m with so "
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

        Every strip writes only its own points (restricted additive Schwarz), so the preconditioner
        is not symmetric, and plain conjugate gradients would not converge.
        """
        weights = np.zeros_like(cloud.heights)
        residual = cloud.heights.copy()
        if not residual.any():  # perfectly flat ground: there is nothing to solve
            return weights
        inverse_noise = 1 / cloud.noise_variance
        problem, signal_std = self.problem, self.problem.kernel.signal_std
        limit = problem.accuracy.residual_of(problem.information, cloud.signal_to_noise(signal_std))
        steps: list[tuple[Array, Array]] = []  # directions, and their images, which are orthonormal
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
            if cloud.residual_rms(residual) <= limit:
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
