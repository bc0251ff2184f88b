"""Points -> one mean for each voxel that holds any."""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array


def voxel_means(points: Float[Array, "n 3"], size: float) -> Float[Array, "m 3"]:
    """Replace the points of each voxel by their mean [m], in order of the voxels' x, y, z.

    The voxels lie on whole multiples of their side [m].
    """
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    _, owner, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = [np.bincount(owner, points[:, axis]) for axis in range(3)]
    return np.column_stack(sums) / counts[:, None]
