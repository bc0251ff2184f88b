"""Maps as a perfect sensor would make them, of ground seen from anywhere."""

from functools import cache

import numpy as np

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.matching import match_features
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Features, GradientMap, Grid
from tests.support.ground import SIGNAL_STD, Ground, seen_from


@cache
def ground_turned_by(
    degrees: float, resolution: float = 0.05, seed: int = 2
) -> tuple[GradientMap, SE2]:
    """Make a map of the same ground, turned and shifted; and ``T_world_map``."""
    T_world_map = SE2(0.8, -0.5, np.radians(degrees)) if degrees else SE2()
    side = round(10 / resolution) + 1
    grid = Grid((-5.0, -5.0), resolution, (side, side))
    return seen_from(Ground.random(seed, shortest=0.6), T_world_map, grid), T_world_map


def right_matches(
    query: Features, database: Features, T_database_query: SE2, within: float, inner: float
) -> NDArray[np.bool_]:
    """Which mutual matches are right within some metres, of those that both maps hold."""
    matches = match_features(query, database)
    there = T_database_query.apply(matches.query_xy)
    known = (np.abs(there) < inner).all(axis=1)
    return np.hypot(*(there - matches.database_xy).T)[known] <= within


def by_hand(grid: Grid, slope: Array, height: Array | float = 0.0) -> GradientMap:
    """Make a map that is known everywhere, of slopes (..., 2) and heights of each cell."""
    heights = np.broadcast_to(height, grid.num_cells).reshape(grid.shape).copy()
    variance = np.full(grid.shape, 1e-6)
    return GradientMap(grid, heights, variance, slope.reshape(*grid.shape, 2), SIGNAL_STD, 0.3)
