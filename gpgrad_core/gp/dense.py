"""The paper's GP as printed, by a dense Cholesky factor, Eqs. (2)-(5): the slow reference."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.kernel import SquaredExponential


@dataclass(frozen=True, eq=False)
class DensePosterior:
    """A GP fitted to n points by a Cholesky factor of their full covariance."""

    kernel: SquaredExponential  # covariance of the terrain
    points_xy: Float[Array, "n 2"]  # positions (n, 2) [m]
    weights: Float[Array, "n"]  # [K(X, X) + D]⁻¹ Z, with D the noise variances (n,)
    factor: Float[Array, "n n"]  # lower triangle of the Cholesky factor of K(X, X) + D (n, n)
    mean: float  # height that was subtracted before the fit [m]


def fit_dense(
    points: Float[Array, "n 3"],
    kernel: SquaredExponential,
    noise_std: float | Float[Array, "n"],
    *,
    mean: float | None = None,
) -> DensePosterior:
    """Fit the GP of Eq. (1) to points [m]; memory grows as n², time as n³.

    The mean height [m] is subtracted before and added after; None takes the points' mean.
    """
    from scipy.linalg import cho_solve, cholesky  # noqa: PLC0415 - loads slowly

    xy, z = points[:, :2], points[:, 2]
    offset = float(z.mean()) if mean is None else mean
    covariance = kernel(xy, xy)
    covariance[np.diag_indices(len(xy))] += np.broadcast_to(noise_std, len(xy)) ** 2
    factor = cholesky(covariance, lower=True, overwrite_a=True)
    return DensePosterior(kernel, xy, cho_solve((factor, True), z - offset), factor, offset)


def infer_elevation(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q"]:
    """Infer the posterior mean of the height at query positions [m], Eq. (2).

    z(x*) = K(x*, X) [K(X, X) + D]⁻¹ Z    Le Gentil 2020, Eq. (2)
    """
    return posterior.kernel(query_xy, posterior.points_xy) @ posterior.weights + posterior.mean


def infer_variance(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q"]:
    """Infer the posterior variance of the height at query positions [m²], Eq. (3).

    var(x*) = K(x*, x*) - K(x*, X) [K(X, X) + D]⁻¹ K(x*, X)ᵀ    Le Gentil 2020, Eq. (3)
    """
    from scipy.linalg import solve_triangular  # noqa: PLC0415 - loads slowly

    rows = posterior.kernel(posterior.points_xy, query_xy)
    whitened = solve_triangular(posterior.factor, rows, lower=True)
    return posterior.kernel.signal_std**2 - np.sum(whitened**2, axis=0)


def infer_slope(posterior: DensePosterior, query_xy: Float[Array, "q 2"]) -> Float[Array, "q 2"]:
    """Infer the terrain's slope along x and along y at query positions [m/m].

    Differentiation is linear, so only the kernel row is differentiated, and the weights of the
    elevation are used again. The slope decays to 0 far from all points, where the variance has to
    mask it. The kernel rows take 2 q n numbers: tile q.

        dz/dx(x*) = dK(x*, X)/dx · [K(X, X) + σz² I]⁻¹ Z    Le Gentil 2020, Eqs. (4), (5)
    """
    return (posterior.kernel.gradient(query_xy, posterior.points_xy) @ posterior.weights).T


def infer_slope_variance(
    posterior: DensePosterior, query_xy: Float[Array, "q 2"]
) -> Float[Array, "q 2"]:
    """Infer the posterior variance of the slope along x and along y (q, 2) [m²/m²].

    The paper does not have it. The linear operator of Eqs. (4), (5) is applied to Eq. (3):

        var(dz/dx) = signal_std² / length_scale² - |L⁻¹ dK(X, x*)/dx|²
    """
    from scipy.linalg import solve_triangular  # noqa: PLC0415 - loads slowly

    rows = posterior.kernel.gradient(query_xy, posterior.points_xy)
    whitened = [solve_triangular(posterior.factor, along.T, lower=True) for along in rows]
    return posterior.kernel.slope_std**2 - np.stack([np.sum(w**2, axis=0) for w in whitened], -1)
