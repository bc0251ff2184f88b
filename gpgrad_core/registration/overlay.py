"""Overlays two maps under a motion: their common cells, and the difference without the warp."""

from dataclasses import dataclass
from math import pi, sqrt
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.relief import Relief
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Grid

TILT_STD, BEND_STD = 0.03, 0.005
"""Standard deviations of the tilt [rad] and the bend [1/m] between two submaps, which drift brings
about while they are built. They are the same as in the alignment."""
WARP_ROUNDS = 3
"""Rounds of weighted least squares, which separate the warp from rocks."""
WARP_CELLS = 600
"""Number of cells that the warp is fitted to; it is smooth, so a few are enough."""

Pair: TypeAlias = Float32[NDArray[np.float32], "rows columns 2"]
Mask: TypeAlias = Bool[NDArray[np.bool_], "rows columns"]


@dataclass(frozen=True, eq=False)
class Overlay:
    """Two maps on the database's cells, cropped to the box around their common cells.

    Attributes:
        common: Cells that both maps trust (rows, columns).
        heights: Elevation of the query and of the database (rows, columns, 2) [m].
        noise: Half the variance of the uncertainty of both maps in each band
            (rows, columns, bands) [m²].
        grid: Of these cells, in the database's frame.
        scale: Scale of comparison [m].
    """

    common: Mask
    heights: Pair
    noise: Float32[NDArray[np.float32], "rows columns bands"]
    grid: Grid
    scale: float

    @property
    def step(self) -> float:
        """Side of a cell [m]."""
        return self.grid.resolution

    @property
    def count(self) -> int:
        """Number of common cells."""
        return int(np.count_nonzero(self.common))


def overlay(query: Relief, database: Relief, T_database_query: SE2) -> Overlay:
    """Resample the query on the database's cells.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        T_database_query: The motion.
    """
    inverse, step = T_database_query.inverse(), database.grid.resolution
    corner = query.grid.to_pixel(inverse.apply(np.array([database.grid.origin])))[0]
    onto = np.column_stack([inverse.rotation * (step / query.grid.resolution), corner])
    moved = cv2.warpAffine(
        np.dstack([query.elevation, query.trusted.astype(np.float32), query.noise]),
        onto,
        database.grid.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    common = (moved[..., 1] > 0.999) & database.trusted
    rows, columns = np.flatnonzero(common.any(axis=1)), np.flatnonzero(common.any(axis=0))
    if not len(rows):
        rows = columns = np.zeros(1, int)
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    heights = np.asarray(np.dstack([moved[..., 0], database.elevation])[box], np.float32)
    noise = np.float32(0.5) * (moved[..., 2:] + database.noise)[box]
    x, y = database.grid.origin
    corner = x + step * int(columns[0]), y + step * int(rows[0])
    height, width = common[box].shape
    grid = Grid(corner, step, (height, width))
    return Overlay(common[box], heights, np.asarray(noise, np.float32), grid, database.scale)


def take_warp_out(laid: Overlay) -> Pair:
    """Remove the offset, tilt and bend of the difference, half from each map, and the mean.

    Args:
        laid: The two maps; they must have a common cell.

    Returns:
        The heights of both maps (rows, columns, 2) [m]; 0 outside of the common cells.
    """
    common, step = laid.common, laid.step
    row, column = np.nonzero(common)
    x, y = (column - column.mean()) * step, (row - row.mean()) * step
    bends = np.stack([x * x, x * y, y * y])
    columns = np.vstack([np.ones((1, len(x))), x, y, bends - bends.mean(axis=1, keepdims=True)])
    precision = np.array([0.0] + 2 * [TILT_STD**-2] + 3 * [BEND_STD**-2])
    both = laid.heights[common].astype(np.float64)
    every = max(1, len(x) // WARP_CELLS)
    some, difference = columns[:, ::every], (both[:, 0] - both[:, 1])[::every]
    left = difference - median(difference)
    cells_a_patch = max(1.0, 2 * pi * laid.scale**2 / (every * step**2))
    coefficients = np.zeros(len(precision))
    weight = np.ones_like(difference)
    for _ in range(WARP_ROUNDS):
        variance = median(left * left) / 0.455 + 1e-12
        weighed = some * weight
        normal = weighed @ some.T
        normal += np.diag(precision * variance * cells_a_patch + 1e-9 * np.diagonal(normal))
        coefficients = np.linalg.solve(normal, weighed @ difference)
        left = difference - coefficients @ some
        weight = 1 / (1 + left * left / variance)
    warp = coefficients @ columns
    both[:, 0] -= warp / 2
    both[:, 1] += warp / 2
    flat = np.zeros_like(laid.heights)
    flat[common] = both - both.mean(axis=0)
    return flat


def median(values: Float[NDArray[np.float64], "n"]) -> float:
    """Give the median of finite values, as NumPy's does, in a fifth of its time for a few hundred.

    >>> median(np.array([3.0, 1.0, 2.0])), median(np.array([4.0, 1.0]))
    (2.0, 2.5)
    """
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    around = np.partition(values, (half - 1, half))
    return float((around[half - 1] + around[half]) / 2)


def smooth_between(pair: Pair, common: Mask, edges: tuple[float, float], step: float) -> Pair:
    """Smooth from the finer edge of a band to the coarser one.

    Args:
        pair: Heights of both maps [m], already smoothed over the finer edge.
        common: The cells that count.
        edges: Widths of the two Gaussians [m]; their variances add up.
        step: Side of a cell [m].
    """
    fine, coarse = edges
    weight = common.astype(np.float32)
    blurred = cv2.GaussianBlur(
        np.dstack([pair, weight]),
        (0, 0),
        sqrt(coarse**2 - fine**2) / step,
        borderType=cv2.BORDER_CONSTANT,
    )
    share = np.maximum(blurred[..., 2:], 1e-6)
    return np.where(common[..., None], blurred[..., :2] / share, np.float32(0))
