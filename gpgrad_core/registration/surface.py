"""A map prepared for comparison: smooth for the search and the score, sharp for the alignment."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import ceil, pi, sqrt

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from gpgrad_core.arrays import Array, Mask, Singles
from gpgrad_core.scale import noise_density
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Grid, read_only

FINE_CELL, CELL = 0.25, 0.75
"""Sides of cells [scales of comparison]: while smoothing, and after it."""
MOST_CELLS, MOST_SIDE = 1_000_000, 16_000
"""Largest number of cells of a thinned map, and along one side (OpenCV's limit is 32766)."""
SHARP_CELL = 0.35
"""Side of a cell that is not smoothed [scales of comparison]."""
CHECKED_CELLS = 6000
"""Number of cells of a map for the dense check, about."""
NUM_BANDS = 2
"""Number of octaves to compare from the scale of comparison on."""
NUM_DENSITIES, NUM_WAVES = 60, 120
"""Number of entries of the lookup table, and of wavenumbers in the sum behind each entry."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The elevation of a map on thinned cells.

    A *smooth* one has no waves below the scale of comparison, which are mostly noise; it
    distinguishes places. A *sharp* one is not smoothed; it serves the last centimetres of a motion.
    """

    grid: Grid  # grid of the thinned cells
    elevation: Float[Singles, "rows columns"]  # height above `base` (rows, columns) [m]
    slope: Float[Singles, "rows columns 2"]  # slope of that along x and y (rows, columns, 2) [m/m]
    # two octaves of the elevation from the scale on, levelled to the same strength (rows, columns);
    # see `level_octaves`. A sharp surface has none (0, 0).
    terrain: Float[Singles, "terrain_rows terrain_columns"]
    # cells that the variance mask trusts (rows, columns)
    trusted: Bool[Mask, "rows columns"]
    # variance of the elevation's error in each band (rows, columns, bands) [m²]. A sharp surface
    # has no bands.
    noise: Float[Singles, "rows columns bands"]
    base: float  # mean elevation of the trusted cells [m]
    scale: float  # scale of comparison [m]

    def __post_init__(self) -> None:
        for array in (self.elevation, self.slope, self.terrain, self.trusted, self.noise):
            read_only(array)

    @cached_property
    def disc(self) -> tuple[Float[Array, "2"], float]:
        """Middle of the trusted cells (x, y), and the distance of the farthest from it [m]."""
        rows, columns = np.nonzero(self.trusted)
        if len(rows) == 0:
            return np.zeros(2), 0.0
        xy = self.grid.to_position(np.column_stack([columns, rows]).astype(np.float64))
        cells = np.array([[columns.mean(), rows.mean()]])
        middle = self.grid.to_position(cells)[0]
        return middle, float(np.hypot(*(xy - middle).T).max())

    @cached_property
    def _long_waves(
        self,
    ) -> tuple[Float[Singles, "rows columns"], Float[Singles, "rows columns 2"]]:
        weight, sigma = self.trusted.astype(np.float32), self.scale / self.grid.resolution
        along: list[Singles] = [
            blur(np.ascontiguousarray(self.slope[..., axis]), weight, sigma) for axis in (0, 1)
        ]
        return blur(self.elevation, weight, sigma), np.dstack(along)

    def less_long_waves(self, share: float) -> "Surface":
        """Remove a share of the waves that are longer than the scale of comparison."""
        elevation, slope = self._long_waves
        return replace(
            self,
            elevation=self.elevation - np.float32(share) * elevation,
            slope=self.slope - np.float32(share) * slope,
        )


@dataclass(frozen=True, eq=False)
class ThinMap:
    """Every n-th row and column of a map."""

    grid: Grid  # grid of the cells kept
    # slope along x and y [m/m], variance of the elevation [m²], and 1 where trusted
    image: Float32[Singles, "rows columns 4"]
    map_cells: int  # number of the map's cells that one of these stands for


@dataclass(frozen=True, eq=False)
class Prepared:
    """What the registration computes of one map, once for all pairs that it is in."""

    smooth: Surface  # the elevation, smoothed over the scale of comparison
    sharp: Surface  # the elevation without smoothing, for the final alignment
    thin: ThinMap  # the cells for the dense check


def prepare(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Prepared:
    """Prepare a map for registration."""
    return Prepared(
        smooth_surface(gradient_map, max_std_ratio),
        sharp_surface(gradient_map, max_std_ratio),
        thin_out(gradient_map, max_std_ratio),
    )


def smooth_surface(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Surface:
    """Smooth a map's elevation and thin it."""
    scale = gradient_map.scale
    grid = thin_grid(gradient_map.grid, FINE_CELL * scale)
    fine = thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(max_std_ratio)[fine]
    elevation, base = _above_mean(gradient_map.elevation[fine], trusted)
    smooth = blur(elevation, trusted.astype(np.float32), scale / grid.resolution)
    thinner = thin_grid(grid, CELL * scale)
    coarse = thinned(grid, thinner)
    smooth, trusted = smooth[coarse].copy(), trusted[coarse].copy()
    noise = band_noise(gradient_map, gradient_map.variance[fine][coarse])
    along_y, along_x = (
        np.gradient(smooth, thinner.resolution, axis=axis) if side > 1 else np.zeros_like(smooth)
        for axis, side in enumerate(smooth.shape)
    )
    slope = np.dstack([along_x, along_y]).astype(np.float32)
    terrain = _levelled(smooth, trusted, thinner.resolution, scale, scale)
    return Surface(thinner, smooth, slope, terrain, trusted, noise, base, scale)


def sharp_surface(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Surface:
    """Thin a map without smoothing it."""
    grid = thin_grid(gradient_map.grid, SHARP_CELL * gradient_map.scale)
    thin = thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(max_std_ratio)[thin].copy()
    elevation, base = _above_mean(gradient_map.elevation[thin], trusted)
    slope = gradient_map.slope[thin].astype(np.float32)
    no_terrain, no_noise = np.zeros((0, 0), np.float32), np.zeros((*trusted.shape, 0), np.float32)
    return Surface(grid, elevation, slope, no_terrain, trusted, no_noise, base, gradient_map.scale)


def thin_out(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> ThinMap:
    """Keep about `CHECKED_CELLS` of a map's cells, or fewer of a very long map."""
    grid = gradient_map.grid
    sparse = round(np.sqrt(grid.num_cells / CHECKED_CELLS))
    stride = max(1, sparse, ceil(max(grid.shape) / MOST_SIDE))
    thin = (slice(None, None, stride), slice(None, None, stride))
    fields = gradient_map.slope[thin], gradient_map.variance[thin]
    # As one image of four channels, it is sampled once per motion.
    image = np.dstack([*fields, gradient_map.trusted(max_std_ratio)[thin]]).astype(np.float32)
    shape = (image.shape[0], image.shape[1])
    return ThinMap(Grid(grid.origin, stride * grid.resolution, shape), image, stride**2)


def _above_mean(
    elevation: Float[Array, "rows columns"], trusted: Bool[Mask, "rows columns"]
) -> tuple[Float[Singles, "rows columns"], float]:
    base = float(elevation[trusted].mean()) if trusted.any() else 0.0
    return (elevation - base).astype(np.float32), base


def level_octaves(surface: Surface, shortest: float) -> Float[Singles, "rows columns"]:
    """Extract two octaves of a smooth surface from a wave [m] on, scaled to the same strength."""
    return _levelled(
        surface.elevation, surface.trusted, surface.grid.resolution, surface.scale, shortest
    )


def _levelled(
    elevation: Float[Singles, "rows columns"],
    trusted: Bool[Mask, "rows columns"],
    cell: float,
    smoothed: float,
    shortest: float,
) -> Float[Singles, "rows columns"]:
    weight = trusted.astype(np.float32)
    total = np.zeros_like(elevation)
    if not trusted.any():
        return total
    levels: list[Singles] = []
    for scale in (shortest, 2 * shortest, 4 * shortest):
        # The variances of successive Gaussians add up.
        more = sqrt(max(scale**2 - smoothed**2, 0.0)) / cell
        levels.append(blur(elevation, weight, more) if more > 0 else elevation)
    for fine, coarse in pairwise(levels):
        strength = float((fine - coarse)[trusted].std())
        if strength > 0:
            total += (fine - coarse) / strength
    return np.asarray(total * weight, np.float32)


def blur(
    field: Float[Singles, "rows columns"], weight: Float[Singles, "rows columns"], sigma: float
) -> Float[Singles, "rows columns"]:
    """Smooth a field with a Gaussian of sigma cells, as an average weighted by cell."""
    pair = cv2.GaussianBlur(
        np.dstack([field * weight, weight]), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(pair[..., 0] / np.maximum(pair[..., 1], 1e-6), np.float32)


def thin_grid(grid: Grid, cell: float) -> Grid:
    """Keep every n-th row and column: cells of about this side [m], larger under `MOST_CELLS`."""
    least = max(grid.num_cells / MOST_CELLS, 1.0) ** 0.5
    stride = max(round(cell / grid.resolution), ceil(least), ceil(max(grid.shape) / MOST_SIDE))
    rows, columns = (-(-side // stride) for side in grid.shape)
    return Grid(grid.origin, stride * grid.resolution, (rows, columns))


def thinned(grid: Grid, thinner: Grid) -> tuple[slice, slice]:
    """Slices of the rows and columns that the thinner grid keeps."""
    stride = round(thinner.resolution / grid.resolution)
    return slice(None, None, stride), slice(None, None, stride)


def band_edges(scale: float, band: int) -> tuple[float, float]:
    """Widths of the two Gaussians whose difference passes the band [m]."""
    return scale * 2**band, scale * 2 ** (band + 1)


def band_noise(
    gradient_map: GradientMap, variance: Float[Array, "rows columns"]
) -> Float[Singles, "rows columns bands"]:
    """Compute the variance of a map's error in each band from its posterior variance [m²].

    For each wave of the terrain with power S, noise of density N disturbs the posterior mean by
    the power W² N with the gain W = S / (S + N). The variance in a band is the integral of that
    over the wavenumbers k, with H(k) the gain of the band's filter:

        N_band = ∫ H² W² N k dk / 2π

    The density N comes from the posterior variance, cell by cell (`scale.noise_density`).
    """
    signal, length = gradient_map.signal_std, gradient_map.length_scale
    strongest = 2 * pi * (signal * length) ** 2
    density = np.logspace(-12, 2, NUM_DENSITIES) * strongest
    log_k = np.linspace(np.log(0.02), np.log(12.0), NUM_WAVES)
    k = np.exp(log_k) / gradient_map.scale
    power = strongest * np.exp(-0.5 * (k * length) ** 2)
    passed = power / (power + density[:, None])
    disturbed = passed**2 * density[:, None] * k**2 / (2 * pi)
    target = np.log(noise_density(variance, signal, length))
    bands: list[Array] = []
    for band in range(NUM_BANDS):
        fine, coarse = band_edges(gradient_map.scale, band)
        let_through = np.exp(-0.5 * (k * fine) ** 2) - np.exp(-0.5 * (k * coarse) ** 2)
        step = log_k[1] - log_k[0]
        row = np.log((disturbed * let_through**2).sum(axis=1) * step + 1e-30)
        bands.append(np.exp(np.interp(target, np.log(density), row)))
    return np.stack(bands, axis=-1).astype(np.float32)
