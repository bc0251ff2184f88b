"""A GP to be fitted, how exactly and at what cost, what solves it, and its posterior on a grid."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import log10
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import told_apart
from gpgrad_core.gp.cloud import Cloud
from gpgrad_core.gp.kernel import SquaredExponential, check_solvable, information
from gpgrad_core.run import Progress
from gpgrad_core.types import Grid

MOST_SECONDS = 30.0
"""Longest time that a fit may be estimated to take, on two cores of 2.8 GHz."""
MOST_BYTES = 1.35e9
"""Largest memory that a fit may be estimated to take."""
INFORMATION_LEFT = 1e4
"""Up to this information the residual need not be smaller."""
MIN_SIGNAL_TO_NOISE = 2.0
"""From this ratio of signal to noise on the residual need not be smaller."""
MUCH_INFORMATION = 1e6
"""Up to this information the ripple need not be smaller, nor need `MORE_A_DECADE` be seen."""
INFORMATION_NEAR, WIDER_A_DECADE, MOST_WIDER = 1e3, 0.7, 4.0
"""How much farther a tile sees with each tenfold of the information above the first, and at the
most [length-scales]."""
MORE_A_DECADE = 0.7
"""What is added to that from `MUCH_INFORMATION` on."""


@dataclass(frozen=True)
class Accuracy:
    """The limits at which a fast solver stops; the guide has how they were measured.

    Attributes:
        residual: The residual of the heights (rms, in units of the noise). Between and beside the
            points, and where the noise differs from point to point, the error can be larger.
        ripple: Limit on the ripple of the kernel that the lattice for the variance stands for,
            times the information of the data; the standard deviation is off by up to two thirds.
        lattice_halo: Width of the neighbouring points that a strip of the lattice sees, for the
            variance [length-scales].
        tile_halo: The same for a tile.
    """

    residual: float = 0.003
    ripple: float = 0.022
    lattice_halo: float = 4.0
    tile_halo: float = 3.0

    def lattice_halo_of(self, information: float) -> float:
        """How far a strip sees [length-scales]: farther where the points know much."""
        return self.lattice_halo + 0.5 * _wider(information)

    def tile_halo_of(self, information: float) -> float:
        return self.tile_halo + _wider(information)

    def ripple_of(self, information: float) -> float:
        return self.ripple if information <= MUCH_INFORMATION else self.ripple / 5

    def residual_of(self, information: float, signal_to_noise: float) -> float:
        """The residual at which to stop, by the information and the signal in noises."""
        left = (INFORMATION_LEFT / information) ** 0.5
        return self.residual * min(1.0, left, signal_to_noise / MIN_SIGNAL_TO_NOISE)


def _wider(information: float) -> float:
    more = WIDER_A_DECADE * log10(max(information / INFORMATION_NEAR, 1.0))
    more += MORE_A_DECADE * log10(max(information / MUCH_INFORMATION, 1.0))
    return min(more, MOST_WIDER)


EXACT = Accuracy()
"""The accuracy of all results."""
ROUGH = Accuracy(residual=0.1, ripple=0.3, lattice_halo=2.5, tile_halo=2.0)
"""For a picture that a better one soon replaces: within 10 %."""


@dataclass(frozen=True)
class Cost:
    """The estimated cost of a fit and its samples."""

    seconds: float  # time on two cores of 2.8 GHz [s]
    num_bytes: float  # largest memory at a time [bytes]

    @property
    def excess(self) -> float:
        return max(self.seconds / MOST_SECONDS, self.num_bytes / MOST_BYTES)

    def __str__(self) -> str:
        if self.seconds / MOST_SECONDS >= self.num_bytes / MOST_BYTES:
            most, needs = told_apart(MOST_SECONDS, self.seconds, "g", ",.0f")
            return f"about {needs} s (at most {most} s)"
        most, needs = told_apart(MOST_BYTES / 1e9, self.num_bytes / 1e9, "g", ",.2f")
        return f"about {needs} GB (at most {most} GB)"


class TerrainFields(NamedTuple):
    """Posterior of the terrain on a grid, Eqs. (2)-(5)."""

    elevation: Float[Array, "rows columns"]  # mean of the height (rows, columns) [m]
    variance: Float[Array, "rows columns"]  # variance of the height (rows, columns) [m²]
    slope: Float[Array, "rows columns 2"]  # slope along x and along y (rows, columns, 2) [m/m]

    @classmethod
    def prior(cls, grid: Grid, kernel: SquaredExponential, mean: float) -> "TerrainFields":
        return cls(
            np.full(grid.shape, mean),
            np.full(grid.shape, kernel.signal_std**2),
            np.zeros((*grid.shape, 2)),
        )


def clip_variance(variance: Float[Array, "*shape"], prior: float) -> Float[Array, "*shape"]:
    """Clip a variance in place; rounding may leave it slightly below zero or above the prior."""
    return np.clip(variance, 1e-12 * prior, prior, out=variance)


@dataclass(frozen=True, eq=False)
class GPProblem:
    """The GP of Eq. (1) with its points."""

    cloud: Cloud  # the points, with their noise and their heights relative to the mean
    kernel: SquaredExponential  # covariance of the terrain
    mean: float  # height that was subtracted [m]
    information: float  # see `kernel.information`
    accuracy: Accuracy  # how exact the solution has to be

    @classmethod
    def of(
        cls,
        points: Float[Array, "n 3"],
        kernel: SquaredExponential,
        noise_std: float | Float[Array, "n"],
        mean: float | None = None,
        accuracy: Accuracy = EXACT,
    ) -> "GPProblem":
        offset = float(points[:, 2].mean()) if mean is None else mean
        return cls.over(Cloud.of(points, noise_std, offset), kernel, offset, accuracy)

    @classmethod
    def over(
        cls, cloud: Cloud, kernel: SquaredExponential, mean: float, accuracy: Accuracy
    ) -> "GPProblem":
        """Check that the problem can be solved; raises InputError if it cannot."""
        bits = information(cloud.xy, cloud.noise_variance, kernel)
        check_solvable(cloud.xy, kernel, bits)
        return cls(cloud, kernel, mean, bits, accuracy)


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
    def fit(self, problem: GPProblem, progress: Progress) -> Posterior | None:
        """Fit the GP; None if it does not converge, and the lattice has to take over."""

    @abstractmethod
    def cost(self, problem: GPProblem) -> Cost:
        """Estimate what a fit and its samples cost."""
