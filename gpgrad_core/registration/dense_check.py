"""Compares two maps under one motion: overlap area, correlation of the slopes, the paper's h."""

from dataclasses import dataclass
from math import ceil

import cv2
import numpy as np
from jaxtyping import Float, Float32

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.relief import MOST_SIDE
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, Array, GradientMap, Grid

BoolArray = NDArray[np.bool_]

CHECKED_CELLS = 6000
"""Approximate number of cells of a map that the dense check uses. More are not needed, because
slopes change little from cell to cell."""


@dataclass(frozen=True, eq=False)
class ThinMap:
    """Every n-th row and column of a map.

    Attributes:
        grid: Grid of the cells kept.
        image: Slope along x and y [m/m], variance of the elevation [m²], and 1 where trusted.
        map_cells: Number of the map's cells that one of these stands for.
    """

    grid: Grid
    image: Float32[NDArray[np.float32], "rows columns 4"]
    map_cells: int


def thin_out(gradient_map: GradientMap, max_std_ratio: float = MAX_STD_RATIO) -> ThinMap:
    """Keep about `CHECKED_CELLS` of a map's cells, or fewer of a very long map.

    Args:
        gradient_map: The map.
        max_std_ratio: Threshold of the variance mask.
    """
    grid = gradient_map.grid
    sparse = round(np.sqrt(grid.num_cells / CHECKED_CELLS))
    stride = max(1, sparse, ceil(max(grid.shape) / MOST_SIDE))
    thin = (slice(None, None, stride), slice(None, None, stride))
    fields = gradient_map.slope[thin], gradient_map.variance[thin]
    # As one image of four channels, it is sampled once per motion.
    image = np.dstack([*fields, gradient_map.trusted(max_std_ratio)[thin]]).astype(np.float32)
    shape = (image.shape[0], image.shape[1])
    return ThinMap(Grid(grid.origin, stride * grid.resolution, shape), image, stride**2)


class DenseCheck:
    """Compares two maps under a motion."""

    def __init__(self, query: ThinMap, database: ThinMap) -> None:
        """Prepare the database's trusted cells."""
        self._query, self._database = query, database
        trusted = database.image[..., 3] > 0
        y, x = np.meshgrid(database.grid.y, database.grid.x, indexing="ij")
        self._positions = np.column_stack([x[trusted], y[trusted]])
        self._slope = database.image[trusted, :2].astype(np.float64)
        self._variance = database.image[trusted, 2].astype(np.float64)

    def _overlap(
        self, T_database_query: SE2
    ) -> tuple[BoolArray, Float[Array, "common 2"], Float[Array, "common"]]:
        """Find the cells that both maps trust.

        Returns:
            Which of the database's cells are common, and the query's slope there, rotated into
            the database's frame, and its variance.
        """
        there = T_database_query.inverse().apply(self._positions)
        pixels = self._query.grid.to_pixel(there).astype(np.float32)
        sampled = (
            cv2.remap(
                self._query.image,
                pixels[:, :1],
                pixels[:, 1:],
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=(0, 0, 0, 0),
            )
            .reshape(-1, 4)
            .astype(np.float64)
        )
        common = sampled[:, 3] > 0.999  # all four neighbours are trusted
        return common, T_database_query.rotate(sampled[common, :2]), sampled[common, 2]

    def compare(self, T_database_query: SE2) -> tuple[float, float]:
        """Compute the overlap area [m²] and the correlation of the slope vectors over it."""
        common, query, _ = self._overlap(T_database_query)
        area = len(query) * self._database.grid.resolution**2
        if len(query) < 2:
            return area, 0.0
        database = self._slope[common]
        # By matrix products, because NumPy's means of long arrays of pairs are ten times slower.
        share = np.full(len(query), 1 / len(query))
        query, database = query - share @ query, database - share @ database
        energy = float(np.sqrt(np.vdot(query, query) * np.vdot(database, database)))
        return area, float(np.vdot(query, database)) / energy if energy > 0 else 0.0

    def dissimilarity(self, T_database_query: SE2) -> tuple[float, int]:
        """Compute the paper's metric h (ComputeSSDMetric), and over how many of the map's cells.

            h = Σ (I_g^q - I_g^d)² / (I_v^q I_v^d)    Le Gentil 2020, Sec. V

        The sum over the thinned cells is multiplied by the number of cells that each stands for.
        """
        common, query, variance = self._overlap(T_database_query)
        difference = np.hypot(*query.T) - np.hypot(*self._slope[common].T)
        terms = difference**2 / (variance * self._variance[common])
        cells = self._database.map_cells
        return float(cells * np.sum(terms)), cells * len(terms)
