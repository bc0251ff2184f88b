"""The log marginal likelihood of hyperparameters and its gradient, over patches of a cloud."""

import threading
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, Indices
from gpgrad_core.gp.cloud import OwnAxes
from gpgrad_core.types import read_only

Members = Int[Indices, "_"]

PATCH_POINTS = 500
"""Number of points of a patch; its dense GP takes 10 ms."""
MOST_OFTEN = 2.0
"""Largest mean number of patches that a point of a small cloud is in."""
TREND_STD, TREND_SLOPE_STD = 3.0, 1.0
"""Prior standard deviations of a trend's height [m] and slopes [m/m]: too large to matter."""
JITTER = 1e-10
"""Added to the diagonal of the covariance, times signal_std², so that its factor exists without
noise."""


@dataclass(frozen=True)
class Hyperparameters:
    """The hyperparameters of the marginal likelihood; a fit searches over their logarithms."""

    length_scale: float  # distance over which the terrain's height changes little [m]
    signal_std: float  # standard deviation of the terrain's height [m]
    # standard deviation of one point's height [m]; or a factor without a unit, if the patch gives
    # the noise of each point
    noise_std: float

    @classmethod
    def from_logs(cls, logs: Float[Array, "3"]) -> "Hyperparameters":
        return cls(*np.exp(logs).tolist())

    @property
    def logs(self) -> Float[Array, "3"]:
        return np.log([self.length_scale, self.signal_std, self.noise_std])


@dataclass(frozen=True, eq=False)
class Patch:
    """Points whose heights have one joint likelihood."""

    xy: Float[Array, "n 2"]  # positions (n, 2) [m]
    heights: Float[Array, "n"]  # heights relative to the terrain's mean (n,) [m]
    # noise of each point (n,) [m], which ``noise_std`` multiplies; ones if all points share one
    # noise
    point_noise_std: Float[Array, "n"]
    # whether the terrain's mean is an unknown plane, the trend; else it is 0
    has_trend: bool = False
    # squared distances between all points (n, n) [m²]; every evaluation needs them
    squared_distances: Float[Array, "n n"] = field(init=False)
    # covariance of the trend's heights (n, n) [m²]; empty without one
    trend: Float[Array, "k k"] = field(init=False)

    def __post_init__(self) -> None:
        x, y = self.xy.T
        squared = np.subtract.outer(x, x) ** 2 + np.subtract.outer(y, y) ** 2
        around = (self.xy - self.xy.mean(axis=0))[: len(self) if self.has_trend else 0]
        trend = TREND_STD**2 + TREND_SLOPE_STD**2 * (around @ around.T)
        read_only(squared, trend)
        object.__setattr__(self, "squared_distances", squared)
        object.__setattr__(self, "trend", trend)

    def with_noise(self, point_noise_std: Float[Array, "n"]) -> "Patch":
        patch = copy(self)
        object.__setattr__(patch, "point_noise_std", point_noise_std)
        return patch

    def __len__(self) -> int:
        return len(self.xy)


class _Workspace(threading.local):
    """Two matrices for each thread: a new one costs as much time as what is computed into it."""

    def __init__(self) -> None:
        self._both = np.empty((2, 0, 0))

    def matrices(self, size: int) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
        if self._both.shape[1] != size:
            self._both = np.empty((2, size, size))
        return self._both[0], self._both[1]


_workspace = _Workspace()


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The log density of a patch's heights, and what its computation yields besides."""

    value: float  # the log density
    # its derivatives by the logarithms of the hyperparameters, in the order of their fields (3,);
    # zeros if they were not wanted
    gradient: Float[Array, "3"]
    information: Float[Array, "3 3"]  # the average information (3, 3); zeros if it was not wanted
    # height of each point less its prediction from the others (n,) [m]; empty if it was not wanted
    residual: Float[Array, "n"]
    # variance of that prediction, without the noise of the point itself (n,) [m²]
    variance: Float[Array, "n"]


def log_marginal_likelihood(
    patch: Patch, hyperparameters: Hyperparameters, *, gradient: bool = True
) -> Likelihood:
    """Compute the log density of a patch's heights, its gradient, and the points left out.

    With ``K`` the covariance of the noisy heights ``z``, and ``α = K⁻¹ z``:

        log p = -½ zᵀα - ½ log |K| - n/2 log 2π              Rasmussen & Williams 2006, Eq. (5.8)
        ∂ log p / ∂θ = ½ tr((α αᵀ - K⁻¹) ∂K/∂θ)              Eq. (5.9)
        rᵢ = αᵢ / [K⁻¹]ᵢᵢ, of variance 1 / [K⁻¹]ᵢᵢ           Eq. (5.12)

    where ``r`` are the residuals of points left out. A patch's trend is a plane with a vague prior,
    a further term of ``K`` (Eq. (2.39)) that no hyperparameter changes. The average information ``½
    αᵀ ∂K/∂θ K⁻¹ ∂K/∂θ' α`` is the mean of the expected and the observed second derivatives without
    their costly traces (Gilmour, Thompson & Cullis, Biometrics 51, 1995). Without a gradient, only
    the density is computed, in less than half of the time.

    Raises:
        numpy.linalg.LinAlgError: If rounding makes the covariance indefinite.
    """
    from scipy.linalg.lapack import dpotrf, dpotri, dpotrs  # noqa: PLC0415 - loads slowly

    n, z = len(patch), patch.heights
    signal_variance = hyperparameters.signal_std**2
    scaled, covariance = _workspace.matrices(n)
    np.divide(patch.squared_distances, hyperparameters.length_scale**2, out=scaled)
    np.exp(np.multiply(scaled, -0.5, out=covariance), out=covariance)
    covariance *= signal_variance
    by_length_scale = np.multiply(covariance, scaled, out=scaled)  # ∂K / ∂ log length_scale
    noise_variance = (hyperparameters.noise_std * patch.point_noise_std) ** 2
    covariance[np.diag_indices(n)] += noise_variance + JITTER * signal_variance
    if patch.has_trend:
        covariance += patch.trend

    # It is symmetric, so its entries are already in LAPACK's order and no copy is made.
    factor, info = dpotrf(covariance.T, lower=1, clean=1, overwrite_a=1)
    if info != 0:
        raise np.linalg.LinAlgError(f"covariance of {n} points is not positive definite")
    weights, _ = dpotrs(factor, z, lower=1)
    log_determinant = 2 * float(np.log(np.diagonal(factor)).sum())
    value = -0.5 * (float(z @ weights) + log_determinant + n * float(np.log(2 * np.pi)))
    if not gradient:
        return Likelihood(value, np.zeros(3), np.zeros((3, 3)), np.empty(0), np.empty(0))
    # ∂K/∂θ α; what noise and trend leave of K is the signal's share.
    of_length, of_noise = by_length_scale @ weights, noise_variance * weights
    of_signal = z - of_noise - (patch.trend @ weights if patch.has_trend else 0.0)
    turned = np.column_stack([of_length, 2 * of_signal, 2 * of_noise])
    solved, _ = dpotrs(factor, turned, lower=1)
    inverse, _ = dpotri(factor, lower=1, overwrite_c=1)  # the lower triangle of the inverse
    diagonal = np.diagonal(inverse).copy()
    # ½ tr((α αᵀ - K⁻¹) ∂K/∂θ) for noise and signal, whose shares of tr(K⁻¹ K) = n add up with the
    # trend's.
    noise_share = float(diagonal @ noise_variance)
    signal_share = n - noise_share
    if patch.has_trend:
        both = 2 * float(np.vdot(inverse.T, patch.trend))
        signal_share -= both - float(diagonal @ np.diagonal(patch.trend))
    by_noise = float(weights @ of_noise) - noise_share
    by_signal = float(weights @ of_signal) - signal_share
    # The diagonal of ∂K / ∂ log length_scale is zero, so the lower triangle is half of the trace.
    trace = 2 * float(np.vdot(inverse.T, by_length_scale))
    by_length = 0.5 * (float(weights @ of_length) - trace)
    return Likelihood(
        value,
        np.array([by_length, by_signal, by_noise]),
        0.5 * (turned.T @ solved),
        weights / diagonal,
        np.maximum(1 / diagonal - noise_variance, 0.0),
    )


def draw_patches(
    xy: Float[Array, "n 2"],
    count: int,
    radius: float,
    rng: np.random.Generator,
    size: int = PATCH_POINTS,
) -> list[Members]:
    """Draw patches spread over a cloud [m], each a disc seen from above, as indices."""
    if len(xy) <= size:
        return [np.arange(len(xy))]
    count = min(count, int(np.ceil(MOST_OFTEN * len(xy) / size)))
    # Imported here because it loads slowly and only a fit needs it.
    from scipy.spatial import KDTree  # noqa: PLC0415

    xy = OwnAxes.of(xy).along(xy)
    tree = KDTree(xy)
    patches: list[Members] = []
    for centre in _centres(xy, count):
        members = np.asarray(tree.query(centre, size)[1])
        if np.hypot(*(xy[members[-1]] - centre)) < radius:
            within = np.sort(tree.query_ball_point(centre, radius))
            members = rng.choice(within, size, replace=False)
        patches.append(members)
    return patches


def _centres(xy: Float[Array, "n 2"], count: int) -> list[Float[Array, "2"]]:
    """Divide a cloud into compact parts of equal size, and find the point in the middle of each."""
    if count == 1:
        return [xy[np.argmin(((xy - xy.mean(axis=0)) ** 2).sum(axis=1))]]
    first = len(xy) * (count // 2) // count
    order = np.argpartition(xy[:, np.argmax(np.ptp(xy, axis=0))], first)
    one, other = xy[order[:first]], xy[order[first:]]
    return _centres(one, count // 2) + _centres(other, count - count // 2)
