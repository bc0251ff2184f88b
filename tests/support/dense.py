"""The paper's GP as printed, by a dense Cholesky factor, Eqs. (2)-(6): the slow reference."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from gpgrad_core.arrays import Array
from gpgrad_core.gp.kernel import SquaredExponential


def covariance(kernel: SquaredExponential, a_xy: Array, b_xy: Array) -> Array:
    """Compute Eq. (6) between two sets of positions (a, b) [m²]."""
    squared = np.sum((a_xy[:, None] - b_xy) ** 2, axis=2)
    return kernel.signal_std**2 * np.exp(-0.5 * squared / kernel.length_scale**2)


def slope_covariance(kernel: SquaredExponential, a_xy: Array, b_xy: Array) -> Array:
    """Compute the covariance of the slopes at a with the heights at b (2, a, b) [m].

    It is the derivative of Eq. (6) along x and y of a: the linear operator of Eqs. (4), (5).
    """
    offsets = (a_xy[:, None] - b_xy) / kernel.length_scale**2
    return -np.moveaxis(offsets, 2, 0) * covariance(kernel, a_xy, b_xy)


@dataclass(frozen=True, eq=False)
class DensePosterior:
    kernel: SquaredExponential
    points_xy: Array  # (n, 2) [m]
    weights: Array  # [K(X, X) + D]⁻¹ Z, with D the noise variances (n,)
    factor: Array  # lower triangle of the Cholesky factor of K(X, X) + D (n, n)
    mean: float  # height that was subtracted before the fit [m]


def fit_dense(
    points: Array,
    kernel: SquaredExponential,
    noise_std: float | Array,
    *,
    mean: float | None = None,
) -> DensePosterior:
    """Fit the GP of Eq. (1); the mean height is subtracted, None takes the points' mean."""
    xy, z = points[:, :2], points[:, 2]
    offset = float(z.mean()) if mean is None else mean
    noisy = covariance(kernel, xy, xy)
    noisy[np.diag_indices(len(xy))] += np.broadcast_to(noise_std, len(xy)) ** 2
    factor = cholesky(noisy, lower=True, overwrite_a=True)
    return DensePosterior(kernel, xy, cho_solve((factor, True), z - offset), factor, offset)


def infer_elevation(posterior: DensePosterior, query_xy: Array) -> Array:
    """z(x*) = K(x*, X) [K(X, X) + D]⁻¹ Z    Le Gentil 2020, Eq. (2)."""
    rows = covariance(posterior.kernel, query_xy, posterior.points_xy)
    return rows @ posterior.weights + posterior.mean


def infer_variance(posterior: DensePosterior, query_xy: Array) -> Array:
    """var(x*) = K(x*, x*) - K(x*, X) [K(X, X) + D]⁻¹ K(x*, X)ᵀ    Le Gentil 2020, Eq. (3)."""
    rows = covariance(posterior.kernel, posterior.points_xy, query_xy)
    whitened = solve_triangular(posterior.factor, rows, lower=True)
    return posterior.kernel.signal_std**2 - np.sum(whitened**2, axis=0)


def infer_slope(posterior: DensePosterior, query_xy: Array) -> Array:
    """dz/dx(x*) = dK(x*, X)/dx · [K(X, X) + σz² I]⁻¹ Z    Le Gentil 2020, Eqs. (4), (5)."""
    rows = slope_covariance(posterior.kernel, query_xy, posterior.points_xy)
    return (rows @ posterior.weights).T


def infer_slope_variance(posterior: DensePosterior, query_xy: Array) -> Array:
    """var(dz/dx) = signal_std² / length_scale² - |L⁻¹ dK(X, x*)/dx|², which no paper prints."""
    rows = slope_covariance(posterior.kernel, query_xy, posterior.points_xy)
    whitened = [solve_triangular(posterior.factor, along.T, lower=True) for along in rows]
    return posterior.kernel.slope_std**2 - np.stack([np.sum(w**2, axis=0) for w in whitened], -1)
