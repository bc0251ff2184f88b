"""The points of a cloud in the order that the fast solvers need."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Array, NDArray

POINTS_TOGETHER = 256
"""Number of points of a square patch that are sorted next to each other, for matrix products."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points sorted so that neighbours are together.

    Attributes:
        xy: Positions (n, 2) [m].
        heights: Heights relative to the mean (n,) [m].
        noise_variance: Variance of each height (n,) [m²].
    """

    xy: Float[Array, "n 2"]
    heights: Float[Array, "n"]
    noise_variance: Float[Array, "n"]

    @classmethod
    def of(
        cls, points: Float[Array, "n 3"], noise_std: float | Float[Array, "n"], mean: float
    ) -> "Cloud":
        """Sort points patch by patch, and subtract the mean from their heights.

        Args:
            points: Positions (n, 3) [m].
            noise_std: Standard deviation of the heights [m], one for all or one for each point.
            mean: Height to subtract [m].
        """
        order = _patch_by_patch(points[:, :2])
        noise = np.broadcast_to(noise_std, len(points))[order]
        return cls(points[order, :2], points[order, 2] - mean, noise**2)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.xy)

    def select(self, chosen: Bool[NDArray[np.bool_], "n"] | Int[NDArray[np.intp], "k"]) -> "Cloud":
        """Return the chosen points."""
        return Cloud(self.xy[chosen], self.heights[chosen], self.noise_variance[chosen])

    def signal_to_noise(self, signal_std: float) -> float:
        """Compute the terrain's standard deviation [m] in those of the middle point."""
        return signal_std / float(np.sqrt(np.median(self.noise_variance)))

    def residual_rms(self, residual: Float[Array, "n"]) -> float:
        """Compute the rms of a residual of the heights [m], in units of the noise."""
        return float(np.sqrt(np.mean(residual**2 / self.noise_variance)))


def _patch_by_patch(xy: Float[Array, "n 2"]) -> Int[NDArray[np.intp], "n"]:
    """Sort points by square patches, row by row, with every other row backwards.

    Then any run of consecutive points lies close together, wherever it starts and ends.
    """
    low = xy.min(axis=0)
    width, height = np.maximum(xy.max(axis=0) - low, 1e-9)
    num_patches = max(1.0, len(xy) / POINTS_TOGETHER)
    # On a narrow cloud the patches are as wide as the cloud, and shorter.
    side = max(np.sqrt(width * height / num_patches), max(width, height) / num_patches)
    column, row = ((xy - low) / side).astype(np.int64).T
    last = column.max()
    along = np.where(row % 2 == 0, column, last - column)
    # Within a patch points are sorted by y, so that equal patches of two clouds have one order.
    return np.lexsort((xy[:, 0], xy[:, 1], row * (last + 1) + along))
