"""Maps of synthetic ground, as a perfect sensor would make them."""

import numpy as np

from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid
from tests.support.ground import Ground, seen_from

GRID = Grid((-4.0, -4.0), 0.1, (81, 81))  # small enough to be checked cell by cell
GROUND = Ground.random(4, shortest=1.0)


def map_of(T_world_map: SE2, ground: Ground = GROUND, grid: Grid = GRID) -> GradientMap:
    """Make a map whose variance differs from cell to cell."""
    x, y = grid.positions.T.reshape(2, *grid.shape)
    variance = 1e-4 * (2 + np.sin(0.5 * x) + np.cos(0.4 * y))
    return seen_from(ground, T_world_map, grid, variance=variance)


DATABASE = map_of(SE2())
