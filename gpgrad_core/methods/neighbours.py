"""Finds all neighbours within a radius, as flat arrays for NumPy."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.libraries import load_library


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Pairs (query, neighbour), sorted by query and then by the neighbour's index.

    Attributes:
        query: Index of the query of each pair (p,).
        index: Index of the neighbour of each pair (p,).
        counts: Number of neighbours of each query (q,).
    """

    query: Int[NDArray[np.int64], "p"]
    index: Int[NDArray[np.int64], "p"]
    counts: Int[NDArray[np.int64], "q"]

    def sum_up(self, values: Float[Array, "p c"]) -> Float[Array, "q c"]:
        """Sum values of the pairs (p, c) for each query (q, c)."""
        columns = [
            np.bincount(self.query, column, len(self.counts)).astype(np.float64)
            for column in values.T
        ]
        return np.column_stack(columns)


def neighbours_within(
    points: Float[Array, "n 3"], queries: Float[Array, "q 3"], radius: float
) -> Neighbours:
    """Find the points within a radius of each query.

    Args:
        points: Points (n, 3) [m].
        queries: Positions (q, 3) [m]. A query that is one of the points is its own neighbour.
        radius: The radius [m].
    """
    core: Any = load_library("open3d").core
    search = core.nns.NearestNeighborSearch(core.Tensor(points))
    search.fixed_radius_index(radius)
    found, _, splits = search.fixed_radius_search(core.Tensor(queries), radius, False)
    index, ends = found.numpy().astype(np.int64), splits.numpy().astype(np.int64)
    counts = np.diff(ends)
    query = np.repeat(np.arange(len(queries)), counts)
    order = np.lexsort([index, query])  # the order of the search may depend on its threads
    return Neighbours(query, index[order], counts)
