"""All neighbours within a radius, as flat arrays for NumPy."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.libraries import load_library


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Pairs (query, neighbour), by query and then by the neighbour's index."""

    query: Int[NDArray[np.int64], "p"]
    index: Int[NDArray[np.int64], "p"]
    counts: Int[NDArray[np.int64], "q"]  # neighbours of each query

    def sum_up(self, values: Float[Array, "p c"]) -> Float[Array, "q c"]:
        """Add up values of the pairs, for each query."""
        columns = [
            np.bincount(self.query, column, len(self.counts)).astype(np.float64)
            for column in values.T
        ]
        return np.column_stack(columns)


def neighbours_within(
    points: Float[Array, "n 3"], queries: Float[Array, "q 3"], radius: float
) -> Neighbours:
    """Find the points within a radius [m] of each query, itself included if it is one."""
    core: Any = load_library("open3d").core
    search = core.nns.NearestNeighborSearch(core.Tensor(points))
    search.fixed_radius_index(radius)
    found, _, splits = search.fixed_radius_search(core.Tensor(queries), radius, False)
    index, ends = found.numpy().astype(np.int64), splits.numpy().astype(np.int64)
    counts = np.diff(ends)
    query = np.repeat(np.arange(len(queries)), counts)
    order = np.lexsort([index, query])  # the search's own order may depend on its threads
    return Neighbours(query, index[order], counts)
