"""The prior mean of the terrain: one height, or the mean of the heights around a place.

Where points are few, a GP falls back to its prior mean. With one height for all ground, a map bends
towards it at every edge of what was seen, and two submaps that end at different places bend
differently. The heights around do not bend the map.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.types import Grid

POINTS_AVERAGED = 16.0
"""Smallest number of points under the Gaussian on average over the bounding box."""
NODES_A_WIDTH = 2
"""Nodes of the spline along a width of the Gaussian."""
LEAST_WEIGHT = 1e-3
"""Where all weights add up to less [weight of a typical point], a wider average counts instead, and
where its weights do too, the median of all heights."""
WIDER = 4.0
"""Width of the wider average [widths]."""
MOST_NODES = 4e6
"""Largest number of nodes; a GP over so much ground is refused before long."""
MARGIN = 3
"""Nodes beyond the outermost points; a cubic spline reaches over two."""


class PriorMean(ABC):
    """The height that a GP expects before it sees any point."""

    @abstractmethod
    def at(self, xy: Float[Array, "n 2"]) -> Float[Array, "n"]:
        """Determine the height at positions [m]."""

    @abstractmethod
    def on(self, grid: Grid) -> tuple[Float[Array, "rows columns"], Float[Array, "rows columns 2"]]:
        """Determine height [m] and slope along x and y [m/m] in all cells of a grid."""


@dataclass(frozen=True)
class ConstantMean(PriorMean):
    """One height."""

    height: float  # [m]

    def at(self, xy: Float[Array, "n 2"]) -> Float[Array, "n"]:
        return np.full(len(xy), self.height)

    def on(self, grid: Grid) -> tuple[Float[Array, "rows columns"], Float[Array, "rows columns 2"]]:
        return np.full(grid.shape, self.height), np.zeros((*grid.shape, 2))


@dataclass(frozen=True, eq=False)
class LocalMean(PriorMean):
    """A cubic spline whose coefficients are Gaussian averages of the heights around each node."""

    origin: Float[Array, "2"]  # position of the first node [m]
    spacing: float  # distance between nodes [m]
    coefficients: Float[Array, "rows columns"]  # [m]

    @classmethod
    def of(
        cls, points: Float[Array, "n 3"], noise_std: Float[Array, "n"], width: float
    ) -> "LocalMean":
        """Average points [m] with weights ``exp(-d² / (2 width²)) / noise_std²``.

        Where the width [m] holds few points, it becomes wider: the mean should not follow noise.
        """
        from scipy.ndimage import gaussian_filter  # noqa: PLC0415 - loads slowly

        extent = float(np.prod(np.ptp(points[:, :2], axis=0)))
        width = max(width, (POINTS_AVERAGED * extent / (2 * np.pi * len(points))) ** 0.5)
        spacing = max(width / NODES_A_WIDTH, (extent / MOST_NODES) ** 0.5)
        origin = points[:, :2].min(axis=0) - MARGIN * spacing
        place = (points[:, :2] - origin) / spacing
        first = place.astype(np.intp)
        rows, columns = first.max(axis=0)[::-1] + 1 + MARGIN
        middle = float(np.median(points[:, 2]))
        weight = (np.median(noise_std) / noise_std) ** 2
        right, up = (place - first).T
        # Shared among four nodes, so that no rounding moves a point from one node to the next.
        nodes = columns * first[:, 1] + first[:, 0] + np.array([[0], [1], [columns], [columns + 1]])
        shares = np.stack([(1 - right) * (1 - up), right * (1 - up), (1 - right) * up, right * up])

        def averaged(values: Float[Array, "n"], std: float) -> Float[Array, "rows columns"]:
            sums = np.bincount(nodes.ravel(), (shares * values).ravel(), rows * columns)
            # The filter's weights add up to 1; here that of a point at the node itself is 1.
            blurred = gaussian_filter(sums.reshape(rows, columns), std, mode="constant")
            return 2 * np.pi * std**2 * np.asarray(blurred, np.float64)

        heights = np.zeros((rows, columns))
        for std in (WIDER * NODES_A_WIDTH, NODES_A_WIDTH):
            around = averaged(weight * (points[:, 2] - middle), std)
            heights = (around + LEAST_WEIGHT * heights) / (averaged(weight, std) + LEAST_WEIGHT)
        return cls(origin, spacing, middle + heights)

    def at(self, xy: Float[Array, "n 2"]) -> Float[Array, "n"]:
        from scipy.ndimage import map_coordinates  # noqa: PLC0415 - loads slowly

        last = np.array(self.coefficients.shape[::-1]) - 2  # farther away all is flat
        nodes = np.clip((xy - self.origin) / self.spacing, 1, last)
        return map_coordinates(self.coefficients, nodes.T[::-1], order=3, prefilter=False)

    def on(self, grid: Grid) -> tuple[Float[Array, "rows columns"], Float[Array, "rows columns 2"]]:
        across, slope_across = self._basis(grid.x, axis=0)
        along, slope_along = self._basis(grid.y, axis=1)
        by_rows = along @ self.coefficients
        slope = np.empty((*grid.shape, 2))
        np.matmul(by_rows, slope_across.T, out=slope[..., 0])
        np.matmul(slope_along @ self.coefficients, across.T, out=slope[..., 1])
        return by_rows @ across.T, slope

    def _basis(
        self, x: Float[Array, "n"], axis: int
    ) -> tuple[Float[Array, "n nodes"], Float[Array, "n nodes"]]:
        """Weights of the nodes along an axis at positions [m], and their derivatives [1/m]."""
        count = self.coefficients.shape[1 - axis]
        place = (x - self.origin[axis]) / self.spacing
        inside = np.clip(place, 1, count - 2)  # as `at` does
        first = np.minimum(inside.astype(np.intp), count - 3)
        t = inside - first
        values = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3]
        slopes = [-((1 - t) ** 2), 3 * t**2 - 4 * t, 1 + 2 * t - 3 * t**2, t**2]
        nodes = first[:, None] + np.arange(-1, 3)
        still = (inside == place) / (2 * self.spacing)

        def weights(each: list[Float[Array, "n"]]) -> Float[Array, "n nodes"]:
            matrix = np.zeros((len(x), count))
            np.put_along_axis(matrix, nodes, np.column_stack(each), axis=1)
            return matrix

        return weights([v / 6 for v in values]), weights([still * v for v in slopes])
