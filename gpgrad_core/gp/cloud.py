"""Points as the fast solvers want them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points sorted by y, heights about zero, each with its own noise."""

    xy: Float[Array, "n 2"]  # [m]
    heights: Float[Array, "n"]  # [m]
    noise_variance: Float[Array, "n"]  # [m²]

    @classmethod
    def of(
        cls, points: Float[Array, "n 3"], noise_std: float | Float[Array, "n"], mean: float
    ) -> "Cloud":
        """Sort points [m], take the mean [m] off."""
        by_y = np.argsort(points[:, 1], kind="stable")
        noise = np.broadcast_to(noise_std, len(points))[by_y]
        return cls(points[by_y, :2], points[by_y, 2] - mean, noise**2)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.xy)

    def select(self, chosen: Bool[NDArray[np.bool_], "n"]) -> "Cloud":
        """Keep some points."""
        return Cloud(self.xy[chosen], self.heights[chosen], self.noise_variance[chosen])

    def residual_rms(self, residual: Float[Array, "n"]) -> float:
        """Size of a residual of the heights [m], in units of the noise."""
        return float(np.sqrt(np.mean(residual**2 / self.noise_variance)))
