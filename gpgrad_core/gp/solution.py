"""A GP to be fitted, what solves it, and its posterior at every cell of a grid."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.gp.accuracy import EXACT, Accuracy, Cost
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.spacing import check_solvable, information
from gpgrad_core.run.progress import Progress
from gpgrad_core.types import Grid


class TerrainFields(NamedTuple):
    """Posterior of the terrain on a grid, Eqs. (2)-(5)."""

    elevation: Float[Array, "rows columns"]  # mean of the height (rows, columns) [m]
    variance: Float[Array, "rows columns"]  # variance of the height (rows, columns) [m²]
    slope: Float[Array, "rows columns 2"]  # slope along x and along y (rows, columns, 2) [m/m]

    @classmethod
    def prior(cls, grid: Grid, kernel: SquaredExponential, mean: float) -> "TerrainFields":
        """Make the fields of the prior, in arrays that can be changed."""
        return cls(
            np.full(grid.shape, mean),
            np.full(grid.shape, kernel.signal_std**2),
            np.zeros((*grid.shape, 2)),
        )


def clip_variance(variance: Float[Array, "*shape"], prior: float) -> Float[Array, "*shape"]:
    """Clip a variance in place; rounding may leave it slightly below zero or above the prior."""
    return np.clip(variance, 1e-12 * prior, prior, out=variance)


@dataclass(frozen=True, eq=False)
class Problem:
    """The GP of Eq. (1) with its points."""

    cloud: Cloud  # the points, with their noise and their heights relative to the mean
    kernel: SquaredExponential  # covariance of the terrain
    mean: float  # height that was subtracted [m]
    information: float  # see `spacing.information`
    accuracy: Accuracy  # how exact the solution has to be

    @classmethod
    def of(
        cls,
        points: Float[Array, "n 3"],
        kernel: SquaredExponential,
        noise_std: float | Float[Array, "n"],
        mean: float | None = None,
        accuracy: Accuracy = EXACT,
    ) -> "Problem":
        """Sort the points; see `inference.fit_gp`."""
        offset = float(points[:, 2].mean()) if mean is None else mean
        cloud = Cloud.of(points, noise_std, offset)
        bits = information(cloud.xy, cloud.noise_variance, kernel)
        check_solvable(cloud.xy, kernel, bits)
        return cls(cloud, kernel, offset, bits, accuracy)


@dataclass(frozen=True, eq=False)
class Posterior(ABC):
    """A fitted GP that can be sampled on any grid."""

    kernel: SquaredExponential  # covariance of the terrain
    mean: float  # height that was subtracted before the fit [m]

    @abstractmethod
    def sample(self, grid: Grid) -> TerrainFields:
        """Infer elevation [m], its variance and slope [m/m] at every cell, Eqs. (2)-(5)."""

    @abstractmethod
    def sample_slope_variance(self, grid: Grid) -> Float[Array, "rows columns 2"]:
        """Infer the variance of both slopes [m²/m²] at every cell."""


class Solver(ABC):
    """An exact method to fit a GP; without digits lost up to so much information."""

    most_information: float = float("inf")

    @abstractmethod
    def fit(self, problem: Problem, progress: Progress) -> Posterior | None:
        """Fit the GP; None if it does not converge, and the lattice has to take over."""

    @abstractmethod
    def cost(
        self,
        xy: Float[Array, "n 2"],
        kernel: SquaredExponential,
        information: float,
        accuracy: Accuracy = EXACT,
    ) -> Cost:
        """Estimate what a fit to points at positions (n, 2) [m] and its samples cost."""
