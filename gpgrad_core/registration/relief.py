"""A map made ready for comparison: its elevation, smoothed over the scale of comparison."""

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.uncertainty import BandNoise
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Grid, read_only

Image: TypeAlias = NDArray[np.float32]

FINE_CELL, CELL = 0.25, 0.75
"""Sides of cells [scales]: of those that are smoothed, and of those kept of these."""


@dataclass(frozen=True, eq=False)
class Relief:
    """The elevation of a map, mostly smoothed over one scale of comparison.

    Shorter waves are mostly noise, and the longer ones agree between two visits of a place to
    a few per cent: they tell places apart, and place one map on the other.
    """

    grid: Grid
    elevation: Float[Image, "rows columns"]  # above `base` [m]
    slope: Float[Image, "rows columns 2"]  # of that [m/m]
    terrain: Float[Image, "rows columns"]  # two octaves from one scale on, levelled
    trusted: Bool[NDArray[np.bool_], "rows columns"]
    noise: Float[Image, "rows columns bands"]  # variance of what each band leaves unknown [m²]
    base: float  # mean elevation [m]
    scale: float  # scale of comparison [m]

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.elevation, self.slope, self.terrain, self.trusted, self.noise):
            read_only(array)


def make_relief(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Relief:
    """Smooth a map's elevation and thin it.

    Args:
        gradient_map: Cells that it does not trust take no part in the smoothing.
        max_std_ratio: The variance mask.
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
    """Split two octaves of terrain off, each brought to the same strength.

    Natural ground is rougher the longer the waves. Levelled so, every wave is evidence of its
    own, and the correlation of unrelated ground stays near 0.

    Args:
        relief: The map.
        shortest: Where the first octave begins [m]; the scale of comparison or more.
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
        # The variances of Gaussians add up.
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
    """Smooth a field with a Gaussian of sigma cells, heeding its cells by their weight."""
    pair = cv2.GaussianBlur(
        np.dstack([field * weight, weight]), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(pair[..., 0] / np.maximum(pair[..., 1], 1e-6), np.float32)


def thin_grid(grid: Grid, cell: float) -> Grid:
    """Keep every so manyth row and column, so that cells become about as large as asked."""
    stride = max(1, round(cell / grid.resolution))
    rows, columns = (-(-side // stride) for side in grid.shape)
    return Grid(grid.origin, stride * grid.resolution, (rows, columns))


def thinned(grid: Grid, thinner: Grid) -> tuple[slice, slice]:
    """Rows and columns of a grid that the thinner one keeps."""
    stride = round(thinner.resolution / grid.resolution)
    return slice(None, None, stride), slice(None, None, stride)
