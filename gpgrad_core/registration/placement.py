"""Aligns two maps to a few centimetres, without smoothing them."""

from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.alignment import DRIFTED, FEWEST_CELLS, Alignments, align
from gpgrad_core.registration.overlay import overlay, smooth_between, take_warp_out
from gpgrad_core.registration.relief import Image, Relief, above_mean, blur, thin_grid, thinned
from gpgrad_core.registration.uncertainty import NUM_BANDS
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Grid

SHARP_CELL = 0.35
"""Side of a cell [scales of comparison]."""
ROUGH_CELLS, ROUGH_ITERATIONS = 3000, 8
"""Number of cells and of steps with which the whole elevation is aligned."""
FINE_CELLS, FINE_ITERATIONS = 6000, 8
"""Number of cells and of steps with which the weighted waves are then aligned."""
MOST_TAKEN = 0.9
"""Largest share of the long waves that is removed; with more, the yaw gets worse."""


@dataclass(frozen=True, eq=False)
class Sharp:
    """A map's elevation without smoothing, for the last centimetres of a motion.

    Attributes:
        grid: Grid of the thinned cells.
        elevation: Height above `base` (rows, columns) [m].
        slope: Slope of that along x and y (rows, columns, 2) [m/m].
        trusted: Cells that the variance mask trusts (rows, columns).
        base: Mean elevation of the trusted cells [m].
        scale: Scale of comparison [m].
        whole: The elevation without smoothing, as the alignment takes it.
        long_elevation: Its long waves (rows, columns) [m]: smoothed over the scale of comparison.
        long_slope: Slope of the long waves (rows, columns, 2) [m/m].
    """

    grid: Grid
    elevation: Float[Image, "rows columns"]
    slope: Float[Image, "rows columns 2"]
    trusted: Bool[NDArray[np.bool_], "rows columns"]
    base: float
    scale: float
    whole: Relief = field(init=False)
    long_elevation: Float[Image, "rows columns"] = field(init=False)
    long_slope: Float[Image, "rows columns 2"] = field(init=False)

    def __post_init__(self) -> None:
        """Extract the long waves once."""
        weight, sigma = self.trusted.astype(np.float32), self.scale / self.grid.resolution
        along: list[Image] = [
            blur(np.ascontiguousarray(self.slope[..., axis]), weight, sigma) for axis in (0, 1)
        ]
        # The final alignment uses neither the terrain nor the noise.
        nothing = np.zeros_like(self.elevation)
        whole = Relief(
            self.grid,
            self.elevation,
            self.slope,
            nothing,
            self.trusted,
            np.zeros((*nothing.shape, NUM_BANDS), np.float32),
            self.base,
            self.scale,
        )
        object.__setattr__(self, "whole", whole)
        object.__setattr__(self, "long_elevation", blur(self.elevation, weight, sigma))
        object.__setattr__(self, "long_slope", np.dstack(along))

    def less(self, share: float) -> Relief:
        """Remove a share of the long waves."""
        return replace(
            self.whole,
            elevation=self.whole.elevation - np.float32(share) * self.long_elevation,
            slope=self.whole.slope - np.float32(share) * self.long_slope,
        )


def sharpen(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> Sharp:
    """Thin a map without smoothing it.

    Args:
        gradient_map: The map.
        max_std_ratio: Threshold of the variance mask; other cells take no part.
    """
    grid = thin_grid(gradient_map.grid, SHARP_CELL * gradient_map.scale)
    thin = thinned(gradient_map.grid, grid)
    trusted = gradient_map.trusted(max_std_ratio)[thin].copy()
    elevation, base = above_mean(gradient_map.elevation[thin], trusted)
    slope = gradient_map.slope[thin].astype(np.float32)
    return Sharp(grid, elevation, slope, trusted, base, gradient_map.scale)


def place(query: Sharp, database: Sharp, start: SE2) -> Alignments:
    """Align two maps: first the whole elevation, then with short and long waves weighted.

    Drift within a submap makes long waves differ more than short ones; noise does the opposite.
    For least squares, both should differ equally. So a share of the long waves is removed if they
    differ more, but never a share of the short waves. On dense clouds this brings a right motion
    a fifth closer to the truth; on noisy clouds it changes nothing.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        start: ``T_database_query``, up to a few scales of comparison off.

    Returns:
        One motion. Its height offset and its covariance are those of the whole elevation.
    """
    rough = align(
        query.whole,
        database.whole,
        [start],
        num_cells=ROUGH_CELLS,
        iterations=ROUGH_ITERATIONS,
        warp=DRIFTED,
    )
    share = _taken(query.whole, database.whole, rough.motion(0)) if rough.held[0] else 0.0
    if share == 0:
        return rough
    fine = align(
        query.less(share),
        database.less(share),
        [rough.motion(0)],
        num_cells=FINE_CELLS,
        iterations=FINE_ITERATIONS,
        warp=DRIFTED,
    )
    moved = np.hypot(*(fine.motions - rough.motions)[0, :2])
    return replace(rough, motions=fine.motions) if moved < database.whole.scale else rough


def _taken(query: Relief, database: Relief, motion: SE2) -> float:
    """Compute the share of the long waves to remove, so that long and short waves differ equally.

    The variances are estimated from medians, because rocks hide the ground behind them from one
    side only.
    """
    laid = overlay(query, database, motion)
    if laid.count < FEWEST_CELLS:
        return 0.0
    pair = take_warp_out(laid)
    smooth = smooth_between(pair, laid.common, (0.0, laid.scale), laid.step)
    long = (smooth[..., 0] - smooth[..., 1])[laid.common]
    short = (pair[..., 0] - pair[..., 1])[laid.common] - long
    least, most = (float(np.median(np.square(part))) for part in (short, long))
    return min(max(1 - sqrt(least / most), 0.0), MOST_TAKEN) if most > 0 else 0.0
