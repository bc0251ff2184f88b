"""Points of many scans -> means of voxels, with the standard deviation of their height.

Only sums are kept, so memory grows with the area of the ground and not with the number of points.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray

BITS = 21
"""Bits of a key for each axis; z has the lowest, so that the keys of a column are neighbours."""
HALF = 1 << (BITS - 1)
PRIOR_WEIGHT = 4.0
"""Weight of the usual scatter in the scatter of a column, in degrees of freedom."""
RANGE_BINS = 8
"""Number of bins of columns by range; the usual scatter is that of a bin."""
PARTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Rows and columns of the parts of a covariance that are summed."""
COMMON = 0.25
"""Share of the variance of a point that is the same in all scans, as rendered pairs over the same
ground have it: what a window of matching cannot follow there is so from every place."""
PATCH = 3
"""Side of the squares whose slope is found [voxels]; the ground of larger ones is rough."""
LEAST_NOISE = 0.001
"""Smallest standard deviation of a mean [m], where the points do not scatter at all."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """Sums over the points in each voxel."""

    size: float  # side of a voxel [m]
    keys: Int[NDArray[np.int64], "m"]  # keys of the voxels that hold points, increasing
    # one row per voxel: number of points; sums of their offsets x, y and z from the voxel's centre
    # [m], of the squares of the offset z [m²], and of the squares of the ranges at which they were
    # measured [m²]. If the scans say how uncertain their points are, also the six parts xx, xy, xz,
    # yy, yz and zz of the covariance of the sum of the points, if scans err independently of each
    # other [m²], and x, y and z of the error of the sum, if all err together [m]
    sums: Float[Array, "m k"]

    @classmethod
    def of(
        cls,
        points: Float[Array, "n 3"],
        ranges: Float[Array, "n"],
        size: float,
        errors: Float[Array, "n 3"] | None = None,
        together: float = 1.0,
    ) -> "Voxels":
        """Sort points of one scan [m], within `reach` of the origin, into voxels.

        Ranges are distances from the sensor [m]. An error is where a point would be moved by one
        standard deviation [m], and so many neighbours are moved together.
        """
        cells = np.floor(points / size)
        offset = points - (cells + 0.5) * size
        x, y, z = cells.astype(np.int64).T + HALF
        values = np.column_stack(
            [np.ones(len(points)), offset, offset[:, 2] ** 2, ranges**2],
        )
        keys = (x << (2 * BITS)) | (y << BITS) | z
        if errors is None:
            return _summed(size, keys, values)
        summed = _summed(size, keys, np.column_stack([values, errors]))
        moved = summed.sums[:, 6:] * _in_common(summed.counts, together)[:, None]
        parts = [moved[:, i] * moved[:, k] for i, k in PARTS]
        return cls(size, summed.keys, np.column_stack([summed.sums[:, :6], *parts, moved]))

    def merged(self, other: "Voxels") -> "Voxels":
        return _summed(
            self.size,
            np.concatenate([self.keys, other.keys]),
            np.concatenate([self.sums, other.sums]),
        )

    @property
    def counts(self) -> Float[Array, "m"]:
        return self.sums[:, 0]

    @property
    def points(self) -> Float[Array, "m 3"]:
        cells = [((self.keys >> shift) & (2 * HALF - 1)) - HALF for shift in (2 * BITS, BITS, 0)]
        centres = (np.column_stack(cells) + 0.5) * self.size
        return centres + self.sums[:, 1:4] / self.counts[:, None]

    @property
    def ranges(self) -> Float[Array, "m"]:
        """Root mean square of the ranges at which each voxel's points were measured [m]."""
        return np.sqrt(self.sums[:, 5] / self.counts)

    @property
    def noise_std(self) -> Float[Array, "m"]:
        """Standard deviation of each mean's height [m], from what the scans say, or the scatter.

        The scatter is that of the whole column of voxels: a single one would cut it off. A mean is
        as uncertain as one point: most errors, above all those of the pose, are the same for all.
        """
        if self.sums.shape[1] > 6:
            return np.maximum(self._carried(), LEAST_NOISE)
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

    def _carried(self) -> Float[Array, "m"]:
        """Carry the scans' covariances over to the heights of the means [m]."""
        points = self.points
        across = np.column_stack([-_slopes(points, PATCH * self.size), np.ones(len(points))])
        parts = (
            (1.0 if i == k else 2.0) * across[:, i] * across[:, k] * self.sums[:, 6 + part]
            for part, (i, k) in enumerate(PARTS)
        )
        apart, together = sum(parts), np.sum(across * self.sums[:, 12:], axis=1) ** 2
        variance = (1.0 - COMMON) * apart + COMMON * together
        return np.sqrt(np.maximum(variance, 0.0)) / self.counts


def reach(size: float) -> float:
    """Compute how far from the origin voxels of this size reach along an axis [m]."""
    return (HALF - 1) * size


def _summed(size: float, keys: NDArray[np.int64], values: Array) -> Voxels:
    distinct, owner = np.unique(keys, return_inverse=True)
    sums = [np.bincount(owner, column, minlength=len(distinct)) for column in values.T]
    return Voxels(size, distinct, np.column_stack(sums).astype(np.float64, copy=False))


def _in_common(counts: Float[Array, "m"], together: float) -> Float[Array, "m"]:
    """The error of the mean of so many neighbours, in errors of one.

    Each has the error of a square window of `together` points around it. Two windows have in common
    what they overlap, so their correlation falls linearly with their distance along each axis; here
    it is averaged over all pairs of points of a square.
    """
    side = np.sqrt(counts)
    apart = (side - 1.0 / side) / np.sqrt(together)
    far = np.maximum(apart, 1.0)
    return np.where(apart < 1.0, 1.0 - apart / 3.0, 1.0 / far - 1.0 / (3.0 * far**2))


def _slopes(points: Float[Array, "m 3"], side: float) -> Float[Array, "m 2"]:
    """Find the slope of the plane through the points of each square, along x and y [m/m]."""
    cells = np.floor(points[:, :2] / side).astype(np.int64) + HALF
    _, owner, count = np.unique(
        (cells[:, 0] << BITS) | cells[:, 1], return_inverse=True, return_counts=True
    )
    off = points - np.column_stack([np.bincount(owner, c) / count for c in points.T])[owner]
    xx, xy, xz, yy, yz, _ = (np.bincount(owner, off[:, i] * off[:, k]) for i, k in PARTS)
    # Where there are points on a line only, the ground is taken as level across it.
    least = 1e-3 * side**2 * count
    xx, yy = xx + least, yy + least
    along = np.column_stack([yy * xz - xy * yz, xx * yz - xy * xz]) / (xx * yy - xy**2)[:, None]
    return along[owner]


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
    """Adds scan after scan; sets of voxels of similar size are merged, like digits that carry."""

    def __init__(self, size: float) -> None:
        self._size = size
        self._sets: list[Voxels] = []

    def add(
        self,
        points: Float[Array, "n 3"],
        ranges: Float[Array, "n"],
        errors: Float[Array, "n 3"] | None = None,
        together: float = 1.0,
    ) -> None:
        if not len(points):
            return
        new = Voxels.of(points, ranges, self._size, errors, together)
        while self._sets and len(self._sets[-1].keys) <= 2 * len(new.keys):
            new = self._sets.pop().merged(new)
        self._sets.append(new)

    def total(self) -> Voxels:
        if not self._sets:
            return Voxels(self._size, np.empty(0, np.int64), np.empty((0, 6)))
        total = self._sets[-1]
        for earlier in reversed(self._sets[:-1]):
            total = earlier.merged(total)
        return total
