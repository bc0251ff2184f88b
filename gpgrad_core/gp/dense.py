"""The paper's GP as it is printed: dense Cholesky, Eqs. (2)-(5); slow, the oracle of all else."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky, solve_triangular

from gpgrad_core.arrays import Array
from gpgrad_core.gp.kernel import SquaredExponential


@dataclass(frozen=True, eq=False)
class DensePosterior:
    """A GP fitted to n points by a Cholesky factor of all of them."""

    kernel: SquaredExponential
    points_xy: Float[Array, "n 2"]  # [m]
    weights: Float[Array, "n"]  # [K(X, X) + σz² I]⁻¹ Z
    factor: Float[Array, "n n"]  # lower triangle of the Cholesky factor
    mean: float  # taken off before, added after [m]


def fit_dense(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
) -> DensePosterior:
    """Fit the GP of Eq. (1) to points.

    Args:
        points: Positions [m]. Memory grows as n², time as n³.
        kernel: Covariance of the terrain.
        noise_std: Standard deviation of the heights, one for all or one a point [m].
        mean: Height that is taken off before and added after [m]; None: the points' mean.
    """
    xy, z = points[:, :2], points[:, 2]
    offset = float(z.mean()) if mean is None else mean
    covariance = kernel(xy, xy)
    covariance[np.diag_indices(len(xy))] += np.broadcast_to(noise_std, len(xy)) ** 2
    factor = cholesky(covariance, lower=True, overwrite_a=True)
    return DensePosterior(kernel, xy, cho_solve((factor, True), z - offset), factor, offset)


def infer_elevation(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q"]:
    """Posterior mean of the height [m], Eq. (2)."""
    return posterior.kernel(query_xy, posterior.points_xy) @ posterior.weights + posterior.mean


def infer_variance(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q"]:
    """Posterior variance of the height [m²], Eq. (3); cost q n²."""
    rows = posterior.kernel(posterior.points_xy, query_xy)
    whitened = solve_triangular(posterior.factor, rows, lower=True)
    return posterior.kernel.signal_std**2 - np.sum(whitened**2, axis=0)


def infer_slope(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q 2"]:
    """Infer the terrain's slope at query positions.

    Differentiation is linear, so it passes through the GP: only the kernel row is
    differentiated, and the weights solved for elevation serve again.

        dz/dx(x*) = dK(x*, X)/dx · [K(X, X) + σz² I]⁻¹ Z    Le Gentil 2020, Eqs. (4), (5)

    Args:
        posterior: Fitted to n points; holds their positions and solved weights.
        query_xy: Positions in the submap frame [m]. Builds a (2, q, n) array: tile q.

    Returns:
        Slope along x and along y [m/m]; decays to 0 far from all points, where the
        variance must mask it.
    """
    return (posterior.kernel.gradient(query_xy, posterior.points_xy) @ posterior.weights).T


def infer_slope_variance(
    posterior: DensePosterior, query_xy: Float[Array, "q 2"]
) -> Float[Array, "q 2"]:
    """Posterior variance of the slope along x and along y [m²/m²]; the paper leaves it out.

    The linear operator of Eqs. (4), (5) passes through Eq. (3) as it does through Eq. (2):

        var(dz/dx) = signal_std² / length_scale² - |L⁻¹ dK(X, x*)/dx|²
    """
    rows = posterior.kernel.gradient(query_xy, posterior.points_xy)
    whitened = [solve_triangular(posterior.factor, along.T, lower=True) for along in rows]
    return posterior.kernel.slope_std**2 - np.stack([np.sum(w**2, axis=0) for w in whitened], -1)
