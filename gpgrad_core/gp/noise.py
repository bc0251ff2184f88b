"""Measures the noise of each point from the scatter of its neighbours, and finds the outliers.

Within a cell of a few points the ground is a plane, apart from detail that the GP cannot follow
either. The scatter of the heights about that plane is the noise. Cells hold few points, so their
sums of squares are pooled with those of the cells around, and a little with those of the whole
cloud.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, Mask, NDArray
from gpgrad_core.gp.cloud import OwnAxes

POINTS_A_CELL = 9.0
"""Number of points wanted in a cell; a plane uses up three of them."""
MOST_LENGTH_SCALES = 1.0
"""Largest width of a cell [length-scales]; the GP follows what is wider."""
POOLED_CELLS = 1.0
"""Width of the Gaussian that pools neighbouring cells [cells]."""
PRIOR_WEIGHT = 2.0
"""Degrees of freedom of the cloud in the pool of a cell, and of the prior in a small cloud."""
ENOUGH_FREEDOM = 30.0
"""The prior counts half as much in a cloud of so many degrees of freedom, and ever less in a larger
one."""
CLIPPED_AT = 1.5
"""Residuals are clipped at this many standard deviations (Huber's second proposal)."""
OUTLYING = 5.0
"""An outlier is further than this many standard deviations from the plane of its neighbours."""
STARTED_WITHIN = 5.0
"""The first guess clips residuals at this many times their median."""
ROUNDS = 3
"""Rounds of fitting planes and clipping residuals; the first starts from medians."""


@dataclass(frozen=True, eq=False)
class PointNoise:
    """The noise of each point of a cloud."""

    std: Float[
        Array, "n"
    ]  # of its height (n,) [m]; of an outlier, the distance from its neighbours
    outlying: Bool[Mask, "n"]  # which points are outliers (n,): too far from their neighbours


@dataclass(frozen=True, eq=False)
class MeasuredNoise(PointNoise):
    """The noise over an area, and of each point that it was measured from."""

    _axes: OwnAxes
    _low: Float[Array, "2"]
    _cell: float
    _std_of_cells: Float[Array, "rows columns"]

    def std_at(self, xy: Float[Array, "q 2"]) -> Float[Array, "q"]:
        """Interpolate the noise of a point that is not an outlier at positions (q, 2) [m]."""
        from scipy.ndimage import map_coordinates  # noqa: PLC0415 - loads slowly

        at = ((self._axes.along(xy) - self._low) / self._cell - 0.5).T[::-1]
        return map_coordinates(self._std_of_cells, at, order=1, mode="nearest")


def measure_noise(
    points: Float[Array, "n 3"], length_scale: float, prior_std: float
) -> MeasuredNoise:
    """Measure the noise of points [m] from their scatter within cells."""
    axes = OwnAxes.of(points[:, :2])
    points = np.column_stack([axes.along(points[:, :2]), points[:, 2]])
    cells = _Cells.over(points, length_scale)
    prior = prior_std**2
    residual = points[:, 2] - cells.median(points[:, 2])
    usual = STARTED_WITHIN * float(np.median(np.abs(residual)))
    squares = np.minimum(residual**2, usual**2)
    variance = _pooled(cells, squares, np.maximum(cells.counts - 1, 0), prior)
    has_plane = np.zeros(len(cells.counts), bool)
    # By this factor n points scatter less about their own plane than about the ground.
    left = np.sqrt(np.maximum(1 - 3 / np.maximum(cells.counts, LEAST_POINTS), 0.0))
    for _ in range(ROUNDS):
        limit = CLIPPED_AT * np.sqrt(variance)[cells.owner]
        weight = np.minimum(1.0, limit / np.maximum(np.abs(residual), 1e-12))
        residual, has_plane = cells.off_plane(points, weight)
        clipped = np.minimum(np.abs(residual), limit * left[cells.owner])
        squares = np.where(has_plane[cells.owner], clipped**2 / _clipped_mean_square(), 0.0)
        freedom = np.where(has_plane, cells.counts - 3, 0)
        variance = _pooled(cells, squares, freedom, prior)
    std = np.sqrt(variance)
    there = std[cells.owner]
    off = np.abs(residual)
    outlying = has_plane[cells.owner] & (off > OUTLYING * there)
    # As with Student's t: beyond the limit, the noise is as large as the residual.
    point_std = np.where(outlying, off, there)
    return MeasuredNoise(point_std, outlying, axes, cells.low, cells.side, std.reshape(cells.shape))


def find_outliers(
    points: Float[Array, "n 3"], length_scale: float, noise_std: Float[Array, "n"]
) -> PointNoise:
    """Find the outliers, and raise their noise [m] to their distance from the neighbours' plane."""
    measured = measure_noise(points, length_scale, float(np.median(noise_std)))
    outlying = measured.outlying & (measured.std > OUTLYING * noise_std)
    return PointNoise(np.where(outlying, measured.std, noise_std), outlying)


def _clipped_mean_square() -> float:
    """Compute the mean square of a standard normal variable clipped at `CLIPPED_AT`."""
    from scipy.special import ndtr  # noqa: PLC0415 - loads slowly

    within = 2 * ndtr(CLIPPED_AT) - 1
    density = np.exp(-0.5 * CLIPPED_AT**2) / np.sqrt(2 * np.pi)
    return float(within - 2 * CLIPPED_AT * density + CLIPPED_AT**2 * (1 - within))


@dataclass(frozen=True, eq=False)
class _Cells:
    low: Float[Array, "2"]  # [m]
    side: float  # [m]
    shape: tuple[int, int]
    owner: Int[NDArray[np.int64], "n"]
    counts: Float[Array, "cells"]

    @classmethod
    def over(cls, points: Float[Array, "n 3"], length_scale: float) -> "_Cells":
        xy = points[:, :2]
        low = xy.min(axis=0)
        width, height = np.maximum(xy.max(axis=0) - low, 1e-9)
        side = np.sqrt(POINTS_A_CELL * width * height / len(xy))
        side = float(min(side, MOST_LENGTH_SCALES * length_scale))
        side = max(side, float(np.sqrt(width * height / MOST_CELLS)), 1e-6)
        column, row = np.floor((xy - low) / side).astype(np.int64).T
        shape = (int(row.max()) + 1, int(column.max()) + 1)
        owner = row * shape[1] + column
        counts = np.bincount(owner, minlength=shape[0] * shape[1]).astype(np.float64)
        return cls(low, side, shape, owner, counts)

    def sum(self, values: Float[Array, "n"]) -> Float[Array, "cells"]:
        return np.bincount(self.owner, values, minlength=len(self.counts)).astype(np.float64)

    def mean(self, values: Float[Array, "n"]) -> Float[Array, "cells"]:
        return self.sum(values) / np.maximum(self.counts, 1)

    def median(self, values: Float[Array, "n"]) -> Float[Array, "n"]:
        """Find, for each point, the lower median of its cell."""
        order = np.lexsort((values, self.owner))
        first = np.concatenate([[0], np.cumsum(self.counts)[:-1]]).astype(np.int64)
        middle = first + (np.maximum(self.counts, 1).astype(np.int64) - 1) // 2
        return values[order[np.minimum(middle, len(values) - 1)]][self.owner]

    def off_plane(
        self, points: Float[Array, "n 3"], weight: Float[Array, "n"]
    ) -> tuple[Float[Array, "n"], Bool[Mask, "cells"]]:
        """Compute heights above the weighted plane of each cell [m], and which cells have one."""
        total = np.maximum(self.sum(weight), 1e-12)
        centre = [self.sum(weight * points[:, k]) / total for k in range(3)]
        x, y, z = (points[:, k] - centre[k][self.owner] for k in range(3))
        xx, xy, yy = (self.sum(weight * a * b) for a, b in ((x, x), (x, y), (y, y)))
        xz, yz = self.sum(weight * x * z), self.sum(weight * y * z)
        area = xx * yy - xy**2
        has_plane = (self.counts >= LEAST_POINTS) & (area > 1e-3 * (xx + yy) ** 2)
        area = np.where(has_plane, area, 1.0)
        along_x = np.where(has_plane, (xz * yy - yz * xy) / area, 0.0)
        along_y = np.where(has_plane, (yz * xx - xz * xy) / area, 0.0)
        return z - along_x[self.owner] * x - along_y[self.owner] * y, has_plane


MOST_CELLS = 1_000_000
"""Largest number of cells; on a larger area the cells grow."""
LEAST_POINTS = 5
"""Smallest number of points to which a plane is fitted."""


def _pooled(
    cells: _Cells, squares: Float[Array, "n"], freedom: Float[Array, "cells"], prior: float
) -> Float[Array, "cells"]:
    """Estimate the variance of each cell from its points, those around, the cloud and the prior."""
    from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - loads slowly

    def pool(values: Float[Array, "cells"]) -> Float[Array, "cells"]:
        image = values.reshape(cells.shape)
        blurred = gaussian_filter(image, POOLED_CELLS, mode="constant", truncate=3.0)
        return blurred.ravel() * 2 * np.pi * POOLED_CELLS**2

    summed = cells.sum(squares)
    weight = PRIOR_WEIGHT / (1 + freedom.sum() / ENOUGH_FREEDOM)
    overall = (summed.sum() + weight * prior) / (freedom.sum() + weight)
    return (pool(summed) + PRIOR_WEIGHT * overall) / (pool(freedom) + PRIOR_WEIGHT)
