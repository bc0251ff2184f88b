"""Maps of synthetic ground, as a perfect sensor would make them."""

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import GradientMap, Grid
from tests.support.ground import Ground

GRID = Grid((-4.0, -4.0), 0.1, (81, 81))  # small enough to be checked cell by cell
GROUND = Ground.random(4, shortest=1.0)


def map_of(T_world_map: SE2, ground: Ground = GROUND, grid: Grid = GRID) -> GradientMap:
    """Make the map that a perfect sensor would; the variance differs from cell to cell."""
    xy, step = grid.positions, 1e-4

    def height(shift: Array) -> Array:
        return ground.height(T_world_map.apply(xy + shift)).reshape(grid.shape)

    slope = np.stack([(height(s) - height(-s)) / (2 * step) for s in step * np.eye(2)], axis=-1)
    x, y = xy.T.reshape(2, *grid.shape)
    variance = 1e-4 * (2 + np.sin(0.5 * x) + np.cos(0.4 * y))
    return GradientMap(grid, height(np.zeros(2)), variance, slope, 0.15, 0.3)


DATABASE = map_of(SE2())
