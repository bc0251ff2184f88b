"""Lays one surface on another: overlaid cell by cell, or aligned to a few centimetres."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi, sqrt
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from gpgrad_core.arrays import Array, Indices, Mask, Singles
from gpgrad_core.registration.surface import NUM_BANDS, Surface
from gpgrad_core.se2 import SE2, move_covariance, turned_by
from gpgrad_core.types import Grid

FEWEST_CELLS = 30
"""Smallest number of common cells that a motion is estimated from."""
DRIFT_SHIFT, DRIFT_TURN, DRIFT_RISE = 0.0021, 0.008, 0.0012
"""Standard deviation that drift within a submap adds to a motion: shares of the query's width along
x and y, and of the height, and of the yaw [rad]."""
NOISE_SHARE = 0.7
"""Share of the variance between patches of two maps by which a motion errs; the rest is differences
that pull it nowhere."""
RIGID_TILT = 0.0015
"""Maps that are tilted by this against each other [rad] have half of that variance."""
ROBUSTNESS = 1.0
"""A residual whose square is this many (robust) variances has half of the full weight."""
ROUGH_CELLS, ROUGH_ITERATIONS = 3000, 8
"""Number of cells and of steps with which the whole elevation is aligned."""
FINE_CELLS, FINE_ITERATIONS = 6000, 8
"""Number of cells and of steps with which the weighted waves are then aligned."""
NEAR = 4.0
"""Cells farther than this from the query take no part in an alignment [scales of comparison]."""
MOST_REMOVED = 0.9
"""Largest share of the long waves that is removed."""
WARP_ROUNDS = 3
"""Rounds of weighted least squares, which separate the warp from rocks."""
WARP_CELLS = 600
"""Number of cells that the warp is fitted to."""

Heights: TypeAlias = Float32[Singles, "m rows columns"]


@dataclass(frozen=True)
class Warp:
    """How much the shapes of two maps may differ, besides the motion."""

    tilt_std: float  # standard deviation of the tilt between them [rad]: how well gravity is known
    # standard deviation of the coefficients of x², xy and y² of their height difference [1/m], as
    # odometry drifts; None allows no bend
    bend_std: float | None = None


LEVEL = Warp(0.005)
"""A small tilt only: with more freedom, wrong starts could be made to look right."""
DRIFTED = Warp(0.03, 0.005)
"""Enough for submaps that drift as they are built."""


@dataclass(frozen=True, eq=False)
class Alignments:
    """Motions after some steps of an alignment, one row each."""

    motions: Float[Array, "m 3"]  # x [m], y [m] and yaw [rad] of each ``T_database_query`` (m, 3)
    # how well the terrain of both maps correlates (m,), both octaves levelled to the same strength
    likeness: Float[Array, "m"]
    problem: "_Problem"  # what was solved
    weight: Float[Singles, "m cells"] | None  # weights of the cells in the last step (m, cells)

    def motion(self, k: int) -> SE2:
        return _motion(self.motions[k])

    def alignment(self, k: int) -> "Alignment":
        weight = None if self.weight is None else self.weight[k : k + 1]
        return self.problem.believe(self.motions[k : k + 1], weight)


@dataclass(frozen=True, eq=False)
class Alignment:
    """A motion after alignment, and how far it can be believed."""

    motion: SE2  # ``T_database_query``, with its yaw in (-pi, pi]
    held: bool  # whether the maps overlap enough; if they do not, the motion is unchanged
    z_offset: float  # height to add to the query so that it lies on the database [m]
    z_std: float  # standard deviation of that [m], at the middles of the maps
    noise: Float[Array, "3 3"]  # covariance of x, y and yaw at the middle by noise (3, 3)
    drift: Float[Array, "3 3"]  # what drift within the submaps adds to it (3, 3)
    middle: tuple[float, float]  # middle (x, y) of the common cells, in the database's frame [m]

    @property
    def covariance(self) -> Float[Array, "3 3"]:
        return self.noise + self.drift


def align(
    query: Surface,
    database: Surface,
    start: SE2,
    *,
    num_cells: int,
    iterations: int,
    warp: Warp = LEVEL,
) -> Alignment:
    """Align two maps from a ``T_database_query`` that is up to a few scales of comparison off.

    Gauss-Newton steps minimise the difference of the elevations over about ``num_cells`` of the
    database's cells, apart from an offset and a small warp. The residuals have the weights of
    Cauchy's distribution, because rocks hide the ground behind them from one side only.
    """
    problem = _problem(query, database, num_cells, warp).near(start)
    return problem.believe(*problem.descend([start], iterations))


def align_all(
    query: Surface, database: Surface, starts: list[SE2], *, num_cells: int, iterations: int
) -> Alignments:
    """Align as `align` does from several starts at once, with a small tilt only; one row each."""
    problem = _problem(query, database, num_cells, LEVEL)
    motions, weight = problem.descend(starts, iterations)
    return Alignments(motions, problem.likeness(motions), problem, weight)


def align_fine(query: Surface, database: Surface, start: SE2) -> Alignment:
    """Align two maps: first the whole elevation, then with short and long waves weighted.

    Drift within a submap makes long waves differ more than short ones. For least squares, both
    should differ equally, so a share of the long waves is removed. On dense clouds this brings a
    right motion a fifth closer to the truth; on noisy clouds it changes nothing.
    """
    rough = align(
        query, database, start, num_cells=ROUGH_CELLS, iterations=ROUGH_ITERATIONS, warp=DRIFTED
    )
    share = _long_wave_share(query, database, rough.motion) if rough.held else 0.0
    if share == 0:
        return rough
    fine = align(
        query.less_long_waves(share),
        database.less_long_waves(share),
        rough.motion,
        num_cells=FINE_CELLS,
        iterations=FINE_ITERATIONS,
        warp=DRIFTED,
    )
    middle = query.disc[0][None]
    moved = fine.motion.apply(middle) - rough.motion.apply(middle)
    if np.linalg.norm(moved) >= database.scale:
        return rough
    return replace(rough, motion=fine.motion, noise=fine.noise)


def _long_wave_share(query: Surface, database: Surface, motion: SE2) -> float:
    """Compute the share of long waves to remove, so that long and short waves differ equally."""
    overlap = overlay(query, database, [motion])
    if overlap.counts[0] < FEWEST_CELLS:
        return 0.0
    ours, theirs = take_warp_out(overlap)
    smooth_ours, smooth_theirs = smooth_between(ours, theirs, overlap, (0.0, overlap.scale))
    long = (smooth_ours - smooth_theirs)[overlap.common]
    short = (ours - theirs)[overlap.common] - long
    least, most = (float(np.median(np.square(part))) for part in (short, long))
    return min(max(1 - sqrt(least / most), 0.0), MOST_REMOVED) if most > 0 else 0.0


@dataclass(frozen=True, eq=False)
class SparseOverlay:
    """Two maps on some of the database's cells, under several motions at once."""

    common: Bool[Mask, "m cells"]  # which of the cells both maps trust (m, cells)
    query: Float[Singles, "m cells"]  # elevation of the query there (m, cells) [m]
    database: Float[Singles, "cells"]  # elevation of the database (cells,) [m]
    # half the variance of the uncertainty of both maps, all bands together (m, cells) [m²]
    noise: Float[Singles, "m cells"]
    # where the cells are, relative to their middle (2, cells) [m]
    positions: Float[Singles, "2 cells"]
    cells_a_patch: float  # number of these cells in a patch of 2π scale²


def sparse_overlay(
    query: Surface, database: Surface, motions: Float[Array, "m 3"], num_cells: int
) -> SparseOverlay:
    """Resample the query on about ``num_cells`` of the database's cells, under several motions."""
    return _problem(query, database, num_cells, LEVEL).overlay(motions)


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two maps on the database's cells under several motions, in the box of all common cells."""

    common: Bool[Mask, "m rows columns"]  # cells that both maps trust (m, rows, columns)
    ours: Heights  # elevation of the query (m, rows, columns) [m]
    theirs: Float32[Singles, "rows columns"]  # elevation of the database (rows, columns) [m]
    # half the variance of the uncertainty of both maps in each band, at the common cells of one
    # motion after the other (n, bands) [m²]
    noise: Float32[Singles, "n bands"]
    counts: Int[Indices, "m"]  # number of common cells under each motion (m,)
    grid: Grid  # of these cells, in the database's frame
    scale: float  # scale of comparison [m]

    @property
    def step(self) -> float:
        return self.grid.resolution

    def select(self, motions: Bool[Mask, "m"]) -> "Overlay":
        """Select some of the motions."""
        if motions.all():
            return self
        return replace(
            self,
            common=self.common[motions],
            ours=self.ours[motions],
            noise=self.noise[np.repeat(motions, self.counts)],
            counts=self.counts[motions],
        )


def overlay(query: Surface, database: Surface, motions: Sequence[SE2]) -> Overlay:
    """Resample the query on the database's cells under each ``T_database_query``."""
    grid, image = database.grid, _heights_and_noise(query)
    moved = np.empty((len(motions), *grid.shape, image.shape[2]), np.float32)
    matrices = _to_pixels(query.grid, _rows(motions), np.array(grid.origin))
    matrices[..., :2] *= grid.resolution
    for onto, out in zip(matrices, moved, strict=True):
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        cv2.warpAffine(image, onto, grid.shape[::-1], out, flags=flags)
    common = (moved[..., 1] > 0.999) & database.trusted
    cells = np.flatnonzero(common)  # by number they are found in half the time
    bands = database.noise.shape[2]
    noise = moved.reshape(-1, image.shape[2])[cells, 2 : 2 + bands]
    num_cells = database.trusted.size
    noise += database.noise.reshape(num_cells, bands)[cells % num_cells]
    noise *= np.float32(0.5)
    rows, columns = (np.flatnonzero(common.any(axis=axes)) for axes in ((0, 2), (0, 1)))
    if not len(cells):
        rows = columns = np.zeros(1, int)
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    inside = np.ascontiguousarray(common[:, *box])
    x, y = grid.origin
    corner = x + grid.resolution * int(columns[0]), y + grid.resolution * int(rows[0])
    return Overlay(
        inside,
        np.ascontiguousarray(moved[:, *box, 0]),
        np.ascontiguousarray(database.elevation[box]),
        noise,
        np.array([np.count_nonzero(one) for one in inside]),
        Grid(corner, grid.resolution, (inside.shape[1], inside.shape[2])),
        database.scale,
    )


# The last results of these functions are kept, because a query is compared with many databases in a
# row, and several times with each. They are too large to be kept with each map.
@lru_cache(maxsize=16)
def _elevation_and_slope(surface: Surface) -> Float[Singles, "rows columns 4"]:
    """Make one image of the elevation, its slope along x and y, and 1 where a cell is trusted."""
    return _merge(surface.elevation, surface.slope, surface.trusted.astype(np.float32))


@lru_cache(maxsize=16)
def _heights_and_noise(surface: Surface) -> Float[Singles, "rows columns 4"]:
    """Make one image of the elevation, 1 where a cell is trusted, and the noise in each band."""
    # Always as many fields, because OpenCV interpolates two in coarser steps than four.
    noise = np.zeros((*surface.grid.shape, NUM_BANDS), np.float32)
    noise[..., : surface.noise.shape[2]] = surface.noise
    return _merge(surface.elevation, surface.trusted.astype(np.float32), noise)


def _merge(*images: Singles) -> Singles:
    """Join images of some fields to one; NumPy's `dstack` is several times slower."""
    return np.asarray(cv2.merge(images), np.float32)


def take_warp_out(overlap: Overlay) -> tuple[Heights, Heights]:
    """Remove the offset, tilt and bend of the difference, half from each map, and the mean.

    There is at least one common cell under each motion. Elsewhere the heights are 0.
    """
    common, step, counts = overlap.common, overlap.step, overlap.counts
    shown = common.astype(np.float32)
    # Relative to the middle of the common cells.
    rows, columns = (np.arange(side, dtype=np.float64) for side in common.shape[1:])
    x = step * (columns - (shown.sum(axis=1) @ columns / counts)[:, None])
    y = step * (rows - (shown.sum(axis=2) @ rows / counts)[:, None])
    every = np.maximum(1, counts // WARP_CELLS)
    cells, used = _every(common, every)
    rows, columns = np.divmod(cells, common.shape[2])
    x_there, y_there = np.take_along_axis(x, columns, 1), np.take_along_axis(y, rows, 1)
    some = np.stack(
        [np.ones_like(x_there), x_there, y_there, x_there**2, x_there * y_there, y_there**2], axis=1
    )
    ours_there = np.take_along_axis(overlap.ours.reshape(len(common), -1), cells, 1)
    theirs_there = overlap.theirs.reshape(-1)[cells]
    difference = ours_there.astype(np.float64) - theirs_there
    precision = _precision(DRIFTED)[3:]  # of the offset, the tilts and the bends
    cells_a_patch = np.maximum(1.0, 2 * pi * overlap.scale**2 / (every * step**2))
    diagonal = np.arange(len(precision))
    coefficients = np.zeros((len(common), 1, len(precision)))
    numbers = used.sum(axis=1)
    left = difference - _medians(difference, numbers)[:, None]
    weight = used.astype(np.float64)
    for _ in range(WARP_ROUNDS):
        squared = left * left
        variance = _medians(squared, numbers) / 0.455 + 1e-12
        weighed = some * weight[:, None]
        normal = weighed @ some.transpose(0, 2, 1)
        normal[:, diagonal, diagonal] *= 1 + 1e-9
        normal[:, diagonal, diagonal] += np.outer(variance * cells_a_patch, precision)
        solved = np.linalg.solve(normal, weighed @ difference[..., None])
        coefficients = solved.transpose(0, 2, 1)
        left = difference - (coefficients @ some)[:, 0]
        weight = used / (1 + left * left / variance[:, None])
    offset, along_x, along_y, *bends = (
        np.float32(0.5) * coefficients.astype(np.float32)
    ).transpose(2, 0, 1)[..., None]
    x, y = x.astype(np.float32)[:, None], y.astype(np.float32)[..., None]
    half = (offset + (along_x + bends[0] * x) * x) + (along_y + bends[1] * x + bends[2] * y) * y
    pair = np.stack([overlap.ours - half, half + overlap.theirs]) * shown
    means = pair.sum(axis=(2, 3), dtype=np.float64) / counts
    pair -= shown * means.astype(np.float32)[..., None, None]
    return pair[0], pair[1]


def _every(
    common: Bool[Mask, "m rows columns"], steps: Int[Indices, "m"]
) -> tuple[Int[Indices, "m cells"], Bool[Mask, "m cells"]]:
    """Number every n-th common cell of each motion; rows are as long as the longest."""
    chosen = [np.flatnonzero(one)[::step] for one, step in zip(common, steps, strict=True)]
    lengths = np.array([len(one) for one in chosen])
    used = np.arange(lengths.max()) < lengths[:, None]
    cells = np.zeros(used.shape, np.intp)
    cells[used] = np.concatenate(chosen)
    return cells, used


def _medians(values: Float[Array, "m n"], numbers: Int[Indices, "m"]) -> Float[Array, "m"]:
    """Compute the median of the first values of each row."""
    return np.array([median(row[:n]) for row, n in zip(values, numbers.tolist(), strict=True)])


def median(values: Float[Array, "n"]) -> float:
    """The median of finite values, as NumPy's does, in a fifth of its time for a few hundred.

    >>> median(np.array([3.0, 1.0, 2.0])), median(np.array([4.0, 1.0]))
    (2.0, 2.5)
    """
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    around = np.partition(values, (half - 1, half))
    return float((around[half - 1] + around[half]) / 2)


def smooth_between(
    ours: Heights, theirs: Heights, overlap: Overlay, edges: tuple[float, float]
) -> tuple[Heights, Heights]:
    """Smooth heights [m] between the edges of a band, which are widths of Gaussians [m]."""
    fine, coarse = edges
    sigma = sqrt(coarse**2 - fine**2) / overlap.step
    blurred = np.empty((3, *ours.shape), np.float32)
    weight = overlap.common.astype(np.float32)
    for k, parts in enumerate(zip(ours, theirs, weight, strict=True)):
        once = cv2.GaussianBlur(_merge(*parts), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
        cv2.split(once, list(blurred[:, k]))
    share = weight / np.maximum(blurred[2], 1e-6)
    return blurred[0] * share, blurred[1] * share


@dataclass(frozen=True, eq=False)
class _SampledCells:
    rows: Int[Indices, "n"]  # where they are in its grid (n,)
    columns: Int[Indices, "n"]  # the same (n,)
    middle: Float[Array, "2"]  # mean of their positions (x, y) [m]
    positions: Float[Singles, "3 n"]  # x and y relative to that, and 1 (3, n) [m]
    cells_a_patch: float  # how many of them one independent sample of the residual covers


@lru_cache(maxsize=16)
def _some_cells(surface: Surface, count: int) -> _SampledCells:
    """Choose about as many of a map's trusted cells as wanted."""
    rows, columns = np.nonzero(surface.trusted)
    every = max(1, len(rows) // count)
    rows, columns = rows[::every], columns[::every]
    positions = surface.grid.to_position(np.column_stack([columns, rows]).astype(float))
    # Relative to their middle, float32 is precise enough, however far the origin lies.
    middle = positions.mean(axis=0) if len(positions) else np.zeros(2)
    x, y = (positions - middle).astype(np.float32).T
    patch, cell = 2 * pi * surface.scale**2, every * surface.grid.resolution**2
    return _SampledCells(
        rows, columns, middle, np.stack([x, y, np.ones_like(x)]), max(1.0, patch / cell)
    )


@dataclass(frozen=True, eq=False)
class _Step:
    # x, y [m] and yaw [rad] at the middle of the cells, offset [m], tilts [rad], bends [1/m]
    change: Float[Array, "m p"]
    normal: Float[Array, "m p p"]  # its inverse is the covariance, for residuals of variance 1
    variance: Float[Array, "m"]  # of the residual of an independent sample
    middle: Float[Array, "m 2"]  # of the common cells, in the database's frame [m]
    weight: Float[Singles, "m cells"]
    held: Bool[Mask, "m"]


class _Problem:
    def __init__(self, query: Surface, database: Surface, num_cells: int, warp: Warp) -> None:
        self._query, self._database = query, database
        self._warp = warp
        cells = _some_cells(database, num_cells)
        self._rows, self._columns = cells.rows, cells.columns
        self._middle, self._positions = cells.middle, cells.positions
        self._elevation = database.elevation[cells.rows, cells.columns]
        self._half_slope = np.float32(0.5) * database.slope[cells.rows, cells.columns].T
        self._cells_a_patch = cells.cells_a_patch
        # The query's, because the database may be a part of a larger model.
        self._width = sqrt(query.grid.num_cells) * query.grid.resolution
        self._precision = _precision(warp)

    def near(self, start: SE2) -> "_Problem":
        """The same problem with the cells that a motion near this one may bring together."""
        grid, margin = self._query.grid, NEAR * self._query.scale
        xy = self._positions[:2].T.astype(np.float64) + self._middle
        pixels = grid.to_pixel(start.inverse().apply(xy))
        outside = np.maximum(-pixels, pixels - (np.array(grid.shape[::-1]) - 1)) * grid.resolution
        near = (outside <= margin).all(axis=1)
        if not near.any():
            return self
        some = copy(self)
        some._rows, some._columns = self._rows[near], self._columns[near]
        some._positions = self._positions[:, near]
        some._elevation, some._half_slope = self._elevation[near], self._half_slope[:, near]
        return some

    def descend(
        self, starts: list[SE2], iterations: int
    ) -> tuple[Float[Array, "m 3"], Float[Singles, "m cells"] | None]:
        motions = _rows(starts)
        weight: Float[Singles, "m cells"] | None = None
        moving = np.arange(len(motions))
        for _ in range(iterations):
            step = self.linearise(motions[moving], None if weight is None else weight[moving])
            if weight is None:
                weight = step.weight
            else:
                weight[moving] = step.weight
            # A motion that is not held stays where it is, and so it is never held.
            moving = moving[step.held]
            if not len(moving):
                break
            motions[moving] = self._moved(motions[moving], step.change[step.held])
        return motions, weight

    def _moved(
        self, motions: Float[Array, "m 3"], change: Float[Array, "m p"]
    ) -> Float[Array, "m 3"]:
        turn = change[:, 2]
        there = turned_by(motions[:, :2] - self._middle, turn) + change[:, :2] + self._middle
        return np.column_stack([there, motions[:, 2] + turn])

    def linearise(
        self, motions: Float[Array, "m 3"], weight: Float[Singles, "m cells"] | None
    ) -> _Step:
        """Compute one step for each motion, with the weights from the previous step."""
        elevation, along, across, trusted = cv2.split(
            self._sample(_elevation_and_slope(self._query), motions)
        )
        common = trusted > 0.999
        shown = common.astype(np.float32)
        count = shown.sum(axis=1).astype(np.intp)  # NumPy counts what is true four times slower
        held = count >= FEWEST_CELLS
        weight = shown if weight is None else weight * shown

        # The Jacobian has one row each for x, y, yaw, offset, tilts and bends; then the residual.
        size = len(self._precision)
        system = np.empty((len(motions), size + 1, shown.shape[1]), np.float32)
        by_x, by_y, by_yaw = system[:, 0], system[:, 1], system[:, 2]
        # The mean of both slopes is less noisy, and swapping the maps does not change it.
        c, s = (np.float32(0.5) * factor for factor in _cos_sin(motions))
        np.subtract(s * across - c * along, self._half_slope[0], out=by_x)
        np.subtract(-s * along - c * across, self._half_slope[1], out=by_y)
        # Turned about the middle of the cells, because the query's origin may lie anywhere.
        x, y, _ = self._positions
        np.subtract(by_y * x, by_x * y, out=by_yaw)
        system[:, 3] = 1.0
        per_cell = (1 / np.maximum(count, 1)[:, None]).astype(np.float32)
        middle = (shown @ self._positions[:2].T) * per_cell
        tilts = np.subtract(self._positions[:2], middle[..., None], out=system[:, 4:6])
        if self._warp.bend_std is not None:
            bends = system[:, 6:9]
            np.multiply(tilts[:, :1], tilts, out=bends[:, :2])
            np.multiply(tilts[:, 1], tilts[:, 1], out=bends[:, 2])
            bends -= (bends @ shown[..., None]) * per_cell[..., None]
        residual = np.subtract(elevation, self._elevation, out=system[:, size])

        products = ((system * weight[:, None]) @ system.transpose(0, 2, 1)).astype(np.float64)
        normal, gradient = products[:, :size, :size], products[:, :size, size]
        # The prior of the warp weighs as much as the noise of one patch.
        weighed = np.maximum(products[:, 3, 3, None], 1e-12)
        off = residual - (gradient[:, 3, None] / weighed).astype(np.float32)
        scale = _robust_variance(np.square(off, out=off), common, count)
        diagonal = np.arange(size)
        normal[:, diagonal, diagonal] *= 1 + 1e-9
        normal[:, diagonal, diagonal] += 1e-9 + np.outer(
            scale * self._cells_a_patch, self._precision
        )
        change = np.asarray(-np.linalg.solve(normal, gradient[..., None])[..., 0], np.float64)
        applied = np.concatenate([change, np.ones((len(change), 1))], axis=1)
        left = (applied[:, None].astype(np.float32) @ system)[:, 0]
        squared = np.square(left, out=left)
        variance = _robust_variance(squared, common, count)
        half = (ROBUSTNESS * variance[:, None]).astype(np.float32)
        return _Step(
            change,
            normal,
            variance * self._cells_a_patch,
            middle + self._middle,
            half / (half + squared),
            held,
        )

    def believe(
        self, motions: Float[Array, "1 3"], weight: Float[Singles, "1 cells"] | None
    ) -> Alignment:
        last = self.linearise(motions, weight)
        covariance, middle = last.variance[0] * np.linalg.inv(last.normal[0]), last.middle[0]
        drift = self._drift(last)
        return Alignment(
            _motion(motions[0]),
            bool(last.held[0]),
            float(last.change[0, 3]) + self._database.base - self._query.base,
            self._height_std(motions[0], last, max(covariance[3, 3], 0.0) + drift[3, 3]),
            move_covariance(NOISE_SHARE * covariance[:3, :3], middle - self._middle),
            drift[:3, :3],
            (float(middle[0]), float(middle[1])),
        )

    def _drift(self, step: _Step) -> Float[Array, "4 4"]:
        """Compute the covariance of x, y, yaw and the height by drift, which tilts the maps."""
        squared = np.sum(step.change[0, 4:6] ** 2)
        drifted = squared / (squared + RIGID_TILT**2)
        shift, rise = DRIFT_SHIFT * self._width, DRIFT_RISE * self._width
        return drifted * np.diag(np.array([shift, shift, DRIFT_TURN, rise]) ** 2)

    def _height_std(self, motion: Float[Array, "3"], step: _Step, variance: float) -> float:
        """Add the tilt to a variance of the height offset; a deviation at the maps' middles [m]."""
        tilt, middle = np.sum(step.change[0, 4:6] ** 2), step.middle[0]
        query = _motion(motion).apply(self._query.disc[0][None])[0]
        ways = (np.sum((place - middle) ** 2) for place in (query, self._database.disc[0]))
        ways_squared = sum(np.minimum(way, self._width**2) for way in ways)
        return float(np.sqrt(variance + tilt * ways_squared / 4))

    def likeness(self, motions: Float[Array, "m 3"]) -> Float[Array, "m"]:
        if not self._query.terrain.size:
            return np.zeros(len(motions))
        image = _merge(self._query.terrain, self._query.trusted.astype(np.float32))
        terrain, trusted = cv2.split(self._sample(image, motions))
        common = (trusted > 0.999).astype(np.float32)
        theirs, ours = terrain * common, self._database.terrain[self._rows, self._columns] * common
        energy = np.sum(theirs**2, axis=1) * np.sum(ours**2, axis=1)
        product = np.sum(theirs * ours, axis=1).astype(np.float64)
        correlation = product / np.sqrt(np.maximum(energy, 1e-20))
        squared = np.clip(correlation, 0.0, 0.9999) ** 2
        return -np.log1p(-squared) * np.sqrt(common.sum(axis=1))

    def overlay(self, motions: Float[Array, "m 3"]) -> SparseOverlay:
        sampled = self._sample(_heights_and_noise(self._query), motions)
        elevation, trusted, *bands = (np.asarray(one, np.float32) for one in cv2.split(sampled))
        there = self._database.noise[self._rows, self._columns].sum(axis=1)
        return SparseOverlay(
            trusted > 0.999,
            elevation,
            self._elevation,
            np.float32(0.5) * (np.add(*bands) + there),
            self._positions[:2],
            self._cells_a_patch,
        )

    def _sample(
        self, image: Float[Singles, "rows columns fields"], motions: Float[Array, "m 3"]
    ) -> Float[Singles, "m cells fields"]:
        """Sample images of the query at the database's cells; 0 beyond the query's edge."""
        onto = _to_pixels(self._query.grid, motions, self._middle).astype(np.float32)
        columns, rows = onto.transpose(1, 0, 2) @ self._positions
        sampled = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.asarray(sampled, np.float32)


@lru_cache(maxsize=4)
def _problem(query: Surface, database: Surface, num_cells: int, warp: Warp) -> _Problem:
    """Make the problem of a pair; the last ones are cached, because calls come in a row."""
    return _Problem(query, database, num_cells, warp)


def _precision(warp: Warp) -> Float[Array, "p"]:
    """Prior precision of each parameter; the motion and the offset have no prior."""
    tilts = [warp.tilt_std**-2] * 2
    bends = [] if warp.bend_std is None else [warp.bend_std**-2] * 3
    return np.array([0.0] * 4 + tilts + bends)


def _to_pixels(
    grid: Grid, motions: Float[Array, "m 3"], middle: Float[Array, "2"]
) -> Float[Array, "m 2 3"]:
    """Make the matrices from positions of the database [m], relative to a middle, to pixels."""
    c, s = np.cos(motions[:, 2]) / grid.resolution, np.sin(motions[:, 2]) / grid.resolution
    x, y = (middle - motions[:, :2]).T
    column, row = (origin / grid.resolution for origin in grid.origin)
    onto = np.array([[c, s, c * x + s * y - column], [-s, c, c * y - s * x - row]])
    return np.ascontiguousarray(onto.transpose(2, 0, 1))


def _rows(motions: Sequence[SE2]) -> Float[Array, "m 3"]:
    return np.array([[motion.x, motion.y, motion.yaw] for motion in motions])


def _motion(row: Float[Array, "3"]) -> SE2:
    x, y, yaw = (float(value) for value in row)
    return SE2(x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw))))


def _cos_sin(motions: Float[Array, "m 3"]) -> tuple[Float[Singles, "m 1"], Float[Singles, "m 1"]]:
    yaw = motions[:, 2:]
    return np.cos(yaw).astype(np.float32), np.sin(yaw).astype(np.float32)


def _robust_variance(
    squared: Float[Singles, "m cells"], common: Bool[Mask, "m cells"], count: Indices
) -> Float[Array, "m"]:
    """Estimate the variance from the median of the squared residuals."""
    ordered = np.sort(np.where(common, squared, np.float32(np.inf)), axis=1)
    median = ordered[np.arange(len(squared)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, median, 0.0).astype(np.float64) / 0.455 + 1e-12
