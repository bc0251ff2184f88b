"""Both maps under one motion: common area, correlation of the slopes, the paper's h."""

import cv2
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from gpgrad_core.registration.relief import MAX_STD_RATIO
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, GradientMap, Grid

BoolArray = NDArray[np.bool_]

CHECKED_CELLS = 6000
"""Cells of a map that the dense check looks at; slopes are smooth over many cells."""


class DenseCheck:
    """Compares two maps under a motion, on thinned grids: slopes are smooth over many cells."""

    def __init__(self, query: GradientMap, database: GradientMap) -> None:
        """Thin both maps."""
        stride = _stride(database)
        thin = (slice(None, None, stride), slice(None, None, stride))
        trusted = database.trusted(MAX_STD_RATIO)[thin]
        y, x = np.meshgrid(database.grid.y[thin[0]], database.grid.x[thin[1]], indexing="ij")
        self._positions = np.column_stack([x[trusted], y[trusted]])
        self._slope = database.slope[thin][trusted]
        self._variance = database.variance[thin][trusted]
        self._cell_area = (stride * database.grid.resolution) ** 2
        self._map_cells = stride**2

        stride = _stride(query)
        thin = (slice(None, None, stride), slice(None, None, stride))
        # One image of four channels: one remapping a motion.
        self._query_image = np.dstack(
            [query.slope[thin], query.variance[thin], query.trusted(MAX_STD_RATIO)[thin]]
        ).astype(np.float32)
        self._query_grid = Grid(
            query.grid.origin, stride * query.grid.resolution, self._query_image.shape[:2]
        )

    def _overlap(
        self, T_database_query: SE2
    ) -> tuple[BoolArray, Float[Array, "common 2"], Float[Array, "common"]]:
        """Which cells both maps know; the query's slope there (turned) and its variance."""
        there = T_database_query.inverse().apply(self._positions)
        pixels = self._query_grid.to_pixel(there).astype(np.float32)
        sampled = (
            cv2.remap(
                self._query_image,
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
        """Overlap area [m²], and correlation of the slope vectors over it."""
        common, query, _ = self._overlap(T_database_query)
        area = len(query) * self._cell_area
        if len(query) < 2:
            return area, 0.0
        database = self._slope[common]
        # As matrix products: NumPy's own means of long arrays of pairs are ten times slower.
        share = np.full(len(query), 1 / len(query))
        query, database = query - share @ query, database - share @ database
        energy = float(np.sqrt(np.vdot(query, query) * np.vdot(database, database)))
        return area, float(np.vdot(query, database)) / energy if energy > 0 else 0.0

    def dissimilarity(self, T_database_query: SE2) -> float:
        """ComputeSSDMetric, the paper's h: Σ (I_g^q - I_g^d)² / (I_v^q I_v^d) over the overlap.

        Summed over the thinned cells, each for the map's cells that it stands for.
        """
        common, query, variance = self._overlap(T_database_query)
        difference = np.hypot(*query.T) - np.hypot(*self._slope[common].T)
        return float(self._map_cells * np.sum(difference**2 / (variance * self._variance[common])))


def _stride(gradient_map: GradientMap) -> int:
    return max(1, round(np.sqrt(gradient_map.grid.num_cells / CHECKED_CELLS)))
