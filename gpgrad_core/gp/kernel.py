"""The paper's kernel, Eq. (6), and its factors along x and y."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array


@dataclass(frozen=True)
class SquaredExponential:
    """``k(d) = signal_std² exp(-d² / (2 length_scale²))``, Eq. (6).

    The paper prints both hyperparameters unsquared. Here both are lengths in metres.
    """

    signal_std: float  # standard deviation of the terrain's height [m]
    length_scale: float  # distance over which the height changes little [m]

    @property
    def slope_std(self) -> float:
        """Standard deviation of the terrain's slope along any direction [m/m]."""
        return self.signal_std / self.length_scale

    def __call__(self, a_xy: Float[Array, "a 2"], b_xy: Float[Array, "b 2"]) -> Float[Array, "a b"]:
        """Compute the covariance of the heights at two sets of positions (a, b) [m²]."""
        x = _bump(a_xy[:, 0], b_xy[:, 0], self.length_scale)
        y = _bump(a_xy[:, 1], b_xy[:, 1], self.length_scale)
        return self.signal_std**2 * x * y

    def gradient(
        self, a_xy: Float[Array, "a 2"], b_xy: Float[Array, "b 2"]
    ) -> Float[Array, "2 a b"]:
        """Compute the covariance of the slope at a with the height at b (2, a, b) [m].

        It is the derivative of the covariance with respect to a, along x and along y: the linear
        operator of Eqs. (4), (5).
        """
        covariance = self(a_xy, b_xy)
        offsets = (a_xy[:, None, :] - b_xy[None, :, :]) / self.length_scale**2
        return np.stack([-offsets[..., 0] * covariance, -offsets[..., 1] * covariance])


def _bump(a: Float[Array, "a"], b: Float[Array, "b"], length_scale: float) -> Float[Array, "a b"]:
    return np.exp(-0.5 * ((a[:, None] - b[None, :]) / length_scale) ** 2)
