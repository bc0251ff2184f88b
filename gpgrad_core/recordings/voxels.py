"""Points of many scans -> means of voxels, with the standard deviation of their height.

Only sums are kept, so memory grows with the area of the ground and not with the number of points.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray

BITS = 21
"""Bits of a key for each axis. z has the lowest bits, so that the keys of a column of voxels follow
one another."""
HALF = 1 << (BITS - 1)
PRIOR_WEIGHT = 4.0
"""Weight of the usual scatter in the scatter of a column, in degrees of freedom."""
RANGE_BINS = 8
"""Number of bins of columns by range; the usual scatter is that of a bin."""
LEAST_NOISE = 0.001
"""Smallest standard deviation of a mean [m], where the points do not scatter at all."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """Sums over the points in each voxel."""

    size: float  # side of a voxel [m]
    keys: Int[NDArray[np.int64], "m"]  # keys of the voxels that hold points, increasing
    # one row per voxel: number of points; sums of their offsets x, y and z from the voxel's centre
    # [m], of the squares of the offset z [m²], and of the squares of the ranges at which they were
    # measured [m²]
    sums: Float[Array, "m 6"]

    @classmethod
    def of(cls, points: Float[Array, "n 3"], ranges: Float[Array, "n"], size: float) -> "Voxels":
        """Sort points into voxels.

        Points [m] lie within `reach` of the origin; ranges are their distances from the sensor that
        measured them [m].
        """
        cells = np.floor(points / size)
        offset = points - (cells + 0.5) * size
        x, y, z = cells.astype(np.int64).T + HALF
        values = np.column_stack(
            [np.ones(len(points)), offset, offset[:, 2] ** 2, ranges**2],
        )
        return _summed(size, (x << (2 * BITS)) | (y << BITS) | z, values)

    def merged(self, other: "Voxels") -> "Voxels":
        """Merge two sets of voxels of the same size."""
        return _summed(
            self.size,
            np.concatenate([self.keys, other.keys]),
            np.concatenate([self.sums, other.sums]),
        )

    @property
    def counts(self) -> Float[Array, "m"]:
        """Number of points in each voxel."""
        return self.sums[:, 0]

    @property
    def points(self) -> Float[Array, "m 3"]:
        """Mean of each voxel's points [m]."""
        cells = [((self.keys >> shift) & (2 * HALF - 1)) - HALF for shift in (2 * BITS, BITS, 0)]
        centres = (np.column_stack(cells) + 0.5) * self.size
        return centres + self.sums[:, 1:4] / self.counts[:, None]

    @property
    def ranges(self) -> Float[Array, "m"]:
        """Root mean square of the ranges at which each voxel's points were measured [m]."""
        return np.sqrt(self.sums[:, 5] / self.counts)

    @property
    def noise_std(self) -> Float[Array, "m"]:
        """Standard deviation of each mean's height [m], from the scatter of the points.

        The scatter is that of the whole column of voxels; a single voxel would cut off the points
        above and below it. Where a column has few points, the usual scatter at its range counts as
        well.

        A mean is as uncertain as one point, and not √n times more certain: most errors of its
        points, above all those of the pose, are the same for all. Within a column, voxels with
        more points are more certain.
        """
        _, first, column = np.unique(self.keys >> BITS, return_index=True, return_inverse=True)
        z = self.points[:, 2]
        number = np.add.reduceat(self.counts, first)
        mean = np.add.reduceat(self.counts * z, first) / number
        within = self.sums[:, 4] - self.sums[:, 3] ** 2 / self.counts
        squares = np.add.reduceat(within + self.counts * (z - mean[column]) ** 2, first)
        squares, freedom = np.maximum(squares, 0.0), number - 1
        usual = _usual(squares, freedom, np.add.reduceat(self.sums[:, 5], first) / number)
        variance = (squares + PRIOR_WEIGHT * usual) / (freedom + PRIOR_WEIGHT)
        usual_count = number / np.diff([*first, len(z)])
        share = self.counts / usual_count[column]
        return np.maximum(np.sqrt(variance[column] / share), LEAST_NOISE)


def reach(size: float) -> float:
    """Compute how far from the origin voxels of this size reach along an axis [m]."""
    return (HALF - 1) * size


def _summed(size: float, keys: NDArray[np.int64], values: Array) -> Voxels:
    distinct, owner = np.unique(keys, return_inverse=True)
    sums = [np.bincount(owner, column, minlength=len(distinct)) for column in values.T]
    return Voxels(size, distinct, np.column_stack(sums).astype(np.float64, copy=False))


def _usual(
    squares: Float[Array, "c"], freedom: Float[Array, "c"], squared_range: Float[Array, "c"]
) -> Float[Array, "c"]:
    """Compute the average variance of the columns at the same range [m²]."""
    overall = squares.sum() / max(freedom.sum(), 1.0)
    edges = np.quantile(squared_range, np.linspace(0, 1, RANGE_BINS + 1)[1:-1])
    range_bin = np.searchsorted(edges, squared_range)
    summed = np.bincount(range_bin, squares, minlength=RANGE_BINS)
    number = np.bincount(range_bin, freedom, minlength=RANGE_BINS)
    return ((summed + PRIOR_WEIGHT * overall) / (number + PRIOR_WEIGHT))[range_bin]


class VoxelSums:
    """Adds scan after scan; sets of voxels of similar size are merged, like digits that carry.

    So the cost of adding a scan depends on its own points and not on the whole submap.
    """

    def __init__(self, size: float) -> None:
        """Begin with no points.

        The size is the side of a voxel [m].
        """
        self._size = size
        self._sets: list[Voxels] = []

    def add(self, points: Float[Array, "n 3"], ranges: Float[Array, "n"]) -> None:
        """Add a scan's points; see `Voxels.of`."""
        if not len(points):
            return
        new = Voxels.of(points, ranges, self._size)
        while self._sets and len(self._sets[-1].keys) <= 2 * len(new.keys):
            new = self._sets.pop().merged(new)
        self._sets.append(new)

    def total(self) -> Voxels:
        """Give the voxels of all scans."""
        if not self._sets:
            return Voxels(self._size, np.empty(0, np.int64), np.empty((0, 6)))
        total = self._sets[-1]
        for earlier in reversed(self._sets[:-1]):
            total = earlier.merged(total)
        return total
