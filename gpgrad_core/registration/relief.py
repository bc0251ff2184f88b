"""A map made ready for comparison: its smoothed elevation on cells of about a length-scale."""

from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import GradientMap, Grid, read_only

Image: TypeAlias = NDArray[np.float32]

MAX_STD_RATIO = 0.3
"""Maps are compared where their standard deviation is at most this share of signal_std."""
FINE_CELL, CELL, SHARP_CELL = 0.25, 0.75, 0.35
"""Sides of cells [length-scales]: that are smoothed, that are kept of these, and of a sharp one."""


@dataclass(frozen=True, eq=False)
class Relief:
    """The elevation of a map, mostly smoothed over one length-scale.

    Shorter waves are mostly noise, and the longer ones agree between two visits of a place to
    a few per cent: they tell places apart, and place one map on the other.
    """

    grid: Grid
    elevation: Float[Image, "rows columns"]  # above `base` [m]
    slope: Float[Image, "rows columns 2"]  # of that [m/m]
    terrain: Float[Image, "rows columns"]  # octaves of it from one length-scale on, levelled
    trusted: Bool[NDArray[np.bool_], "rows columns"]
    base: float  # mean elevation [m]
    length_scale: float  # [m]

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.elevation, self.slope, self.terrain, self.trusted):
            read_only(array)


def make_relief(gradient_map: GradientMap) -> Relief:
    """Smooth a map's elevation and thin it.

    Args:
        gradient_map: Cells that it does not trust take no part in the smoothing.
    """
    length_scale = gradient_map.length_scale
    grid = _thin_grid(gradient_map.grid, FINE_CELL * length_scale)
    fine = _thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(MAX_STD_RATIO)[fine]
    elevation, base = _above_mean(gradient_map.elevation[fine], trusted)
    smooth = blur(elevation, trusted.astype(np.float32), length_scale / grid.resolution)
    kept = _thin_grid(grid, CELL * length_scale)
    coarse = _thinned(grid, kept)
    smooth, trusted = smooth[coarse].copy(), trusted[coarse].copy()
    along_y, along_x = (
        np.gradient(smooth, kept.resolution, axis=axis) if side > 1 else np.zeros_like(smooth)
        for axis, side in enumerate(smooth.shape)
    )
    slope = np.dstack([along_x, along_y]).astype(np.float32)
    terrain = _levelled(smooth, trusted, kept.resolution, length_scale, length_scale)
    return Relief(kept, smooth, slope, terrain, trusted, base, length_scale)


def sharp_relief(gradient_map: GradientMap) -> Relief:
    """Thin a map without smoothing it: the last centimetres of a pose lie in the short waves."""
    grid = _thin_grid(gradient_map.grid, SHARP_CELL * gradient_map.length_scale)
    thin = _thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(MAX_STD_RATIO)[thin].copy()
    elevation, base = _above_mean(gradient_map.elevation[thin], trusted)
    slope = gradient_map.slope[thin].astype(np.float32)
    return Relief(
        grid, elevation, slope, np.zeros_like(elevation), trusted, base, gradient_map.length_scale
    )


def _above_mean(
    elevation: Float[NDArray[np.float64], "rows columns"],
    trusted: Bool[NDArray[np.bool_], "rows columns"],
) -> tuple[Float[Image, "rows columns"], float]:
    base = float(elevation[trusted].mean()) if trusted.any() else 0.0
    return (elevation - base).astype(np.float32), base


def level_octaves(relief: Relief, shortest: float) -> Float[Image, "rows columns"]:
    """Split two octaves of terrain off, each brought to the same strength.

    Natural ground is rougher the longer the waves. Levelled so, every wave is evidence of its
    own, and the correlation of unrelated ground stays near 0.

    Args:
        relief: The map.
        shortest: Where the first octave begins [m]; a length-scale or more.
    """
    return _levelled(
        relief.elevation, relief.trusted, relief.grid.resolution, relief.length_scale, shortest
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


def _thin_grid(grid: Grid, cell: float) -> Grid:
    """Keep every so manyth row and column, so that cells become about as large as asked."""
    stride = max(1, round(cell / grid.resolution))
    rows, columns = (-(-side // stride) for side in grid.shape)
    return Grid(grid.origin, stride * grid.resolution, (rows, columns))


def _thinned(grid: Grid, thinner: Grid) -> tuple[slice, slice]:
    """Rows and columns of a grid that the thinner one keeps."""
    stride = round(thinner.resolution / grid.resolution)
    return slice(None, None, stride), slice(None, None, stride)
