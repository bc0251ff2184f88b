"""A map prepared for comparison: its elevation, smoothed over the scale of comparison."""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, sqrt
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.uncertainty import BandNoise
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Grid, read_only

Image: TypeAlias = NDArray[np.float32]

FINE_CELL, CELL = 0.25, 0.75
"""Sides of cells [scales of comparison]: while smoothing, and after it."""
MOST_CELLS, MOST_SIDE = 1_000_000, 16_000
"""Largest number of cells of a thinned map, and along one side. A scale that follows from the
points leaves a twentieth of that; OpenCV samples images of at most 32766 a side."""


@dataclass(frozen=True, eq=False)
class Relief:
    """The elevation of a map, smoothed over one scale of comparison.

    Shorter waves are mostly noise. The longer ones agree between two visits of a place to a few
    per cent, so they distinguish places and align one map with the other. Only the relief of
    `placement.Sharp` is not smoothed.

    Attributes:
        grid: Grid of the thinned cells.
        elevation: Height above `base` (rows, columns) [m].
        slope: Slope of that along x and y (rows, columns, 2) [m/m].
        terrain: Two octaves of the elevation from the scale on, levelled to the same strength
            (rows, columns); see `level_octaves`.
        trusted: Cells that the variance mask trusts (rows, columns).
        noise: Variance of the elevation's error in each band (rows, columns, bands) [m²].
        base: Mean elevation of the trusted cells [m].
        scale: Scale of comparison [m].
    """

    grid: Grid
    elevation: Float[Image, "rows columns"]
    slope: Float[Image, "rows columns 2"]
    terrain: Float[Image, "rows columns"]
    trusted: Bool[NDArray[np.bool_], "rows columns"]
    noise: Float[Image, "rows columns bands"]
    base: float
    scale: float

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.elevation, self.slope, self.terrain, self.trusted, self.noise):
            read_only(array)


def make_relief(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Relief:
    """Smooth a map's elevation and thin it.

    Args:
        gradient_map: The map; cells that are not trusted take no part in the smoothing.
        max_std_ratio: Threshold of the variance mask.
    """
    scale = gradient_map.scale
    grid = thin_grid(gradient_map.grid, FINE_CELL * scale)
    fine = thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(max_std_ratio)[fine]
    elevation, base = above_mean(gradient_map.elevation[fine], trusted)
    smooth = blur(elevation, trusted.astype(np.float32), scale / grid.resolution)
    kept = thin_grid(grid, CELL * scale)
    coarse = thinned(grid, kept)
    smooth, trusted = smooth[coarse].copy(), trusted[coarse].copy()
    noise = BandNoise.of(gradient_map).at(gradient_map.variance[fine][coarse])
    along_y, along_x = (
        np.gradient(smooth, kept.resolution, axis=axis) if side > 1 else np.zeros_like(smooth)
        for axis, side in enumerate(smooth.shape)
    )
    slope = np.dstack([along_x, along_y]).astype(np.float32)
    terrain = _levelled(smooth, trusted, kept.resolution, scale, scale)
    return Relief(kept, smooth, slope, terrain, trusted, noise, base, scale)


def above_mean(
    elevation: Float[NDArray[np.float64], "rows columns"],
    trusted: Bool[NDArray[np.bool_], "rows columns"],
) -> tuple[Float[Image, "rows columns"], float]:
    """Give the elevation above the mean of its trusted cells, and that mean [m]."""
    base = float(elevation[trusted].mean()) if trusted.any() else 0.0
    return (elevation - base).astype(np.float32), base


def level_octaves(relief: Relief, shortest: float) -> Float[Image, "rows columns"]:
    """Extract two octaves of terrain, each scaled to the same strength.

    Natural ground is rougher at longer waves. After levelling, every wave counts the same, and
    the correlation of unrelated ground stays near 0.

    Args:
        relief: The map.
        shortest: Shortest wave of the first octave [m]; at least the scale of comparison.
    """
    return _levelled(
        relief.elevation, relief.trusted, relief.grid.resolution, relief.scale, shortest
    )


def _levelled(
    elevation: Float[Image, "rows columns"],
    trusted: Bool[NDArray[np.bool_], "rows columns"],
    cell: float,
    smoothed: float,
    shortest: float,
) -> Float[Image, "rows columns"]:
    weight = trusted.astype(np.float32)
    total = np.zeros_like(elevation)
    if not trusted.any():
        return total
    levels: list[Image] = []
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
    field: Float[Image, "rows columns"], weight: Float[Image, "rows columns"], sigma: float
) -> Float[Image, "rows columns"]:
    """Smooth a field with a Gaussian of sigma cells, as an average weighted by cell."""
    pair = cv2.GaussianBlur(
        np.dstack([field * weight, weight]), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(pair[..., 0] / np.maximum(pair[..., 1], 1e-6), np.float32)


def thin_grid(grid: Grid, cell: float) -> Grid:
    """Keep every n-th row and column, so that cells become about as large as wanted [m].

    They become larger than wanted where a map would be left with too many of them.
    """
    least = max(grid.num_cells / MOST_CELLS, 1.0) ** 0.5
    stride = max(round(cell / grid.resolution), ceil(least), ceil(max(grid.shape) / MOST_SIDE))
    rows, columns = (-(-side // stride) for side in grid.shape)
    return Grid(grid.origin, stride * grid.resolution, (rows, columns))


def thinned(grid: Grid, thinner: Grid) -> tuple[slice, slice]:
    """Give slices of the rows and columns that the thinner grid keeps."""
    stride = round(thinner.resolution / grid.resolution)
    return slice(None, None, stride), slice(None, None, stride)
