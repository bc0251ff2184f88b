"""How far a fast fit is from the dense one."""

from dataclasses import dataclass

import numpy as np

from gpgrad_core.arrays import Array
from gpgrad_core.gp.inference import SolverName as Name
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.solution import Posterior
from gpgrad_core.types import Grid
from tests.support.dense import (
    fit_dense,
    infer_elevation,
    infer_slope,
    infer_slope_variance,
    infer_variance,
)


@dataclass(frozen=True)
class Fields:
    elevation: Array
    std: Array
    slope: Array
    slope_std: Array

    @classmethod
    def fast(cls, posterior: Posterior, grid: Grid) -> "Fields":
        elevation, variance, slope = posterior.sample(grid)
        slope_variance = posterior.sample_slope_variance(grid)
        return cls(elevation, np.sqrt(variance), slope, np.sqrt(slope_variance))

    @classmethod
    def dense(
        cls, points: Array, kernel: SquaredExponential, noise: float | Array, grid: Grid
    ) -> "Fields":
        posterior = fit_dense(points, kernel, noise)
        elevation, variance, slope, slope_variance = (
            infer(posterior, grid.positions)
            for infer in (infer_elevation, infer_variance, infer_slope, infer_slope_variance)
        )
        std = np.sqrt(np.maximum(variance, 1e-12 * kernel.signal_std**2))
        slope_std = np.sqrt(np.maximum(slope_variance, 1e-12 * kernel.slope_std**2))
        return cls(
            *(field.reshape(grid.shape) for field in (elevation, std)),
            *(field.reshape(*grid.shape, 2) for field in (slope, slope_std)),
        )


@dataclass(frozen=True)
class Errors:
    """Of the fast path to the oracle."""

    elevation: float  # rms, in units of the noise
    slope: float  # rms, relative to the slopes' rms
    std: float  # largest relative one of a trusted cell
    slope_std: float  # the same of the slopes'
    std_anywhere: float  # largest relative one of any cell
    num_trusted: int


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def compare(
    points: Array,
    kernel: SquaredExponential,
    noise: float | Array,
    grid: Grid,
    solver: Name = "lattice",
    exact: Fields | None = None,
) -> Errors:
    exact = Fields.dense(points, kernel, noise, grid) if exact is None else exact
    posterior = fit_gp(points, kernel, noise, solver=solver)
    fast = Fields.fast(posterior, grid)
    trusted = exact.std <= 0.3 * kernel.signal_std
    std = np.abs(fast.std / exact.std - 1)
    slope_std = np.abs(fast.slope_std / exact.slope_std - 1)[trusted]
    return Errors(
        rms(fast.elevation - exact.elevation) / float(np.median(noise)),
        rms(fast.slope - exact.slope) / rms(exact.slope),
        float(std[trusted].max(initial=0.0)),
        float(slope_std.max(initial=0.0)),
        float(std.max()),
        int(trusted.sum()),
    )


def grid_beyond(points: Array, beyond: float, resolution: float) -> Grid:
    """Lay a grid that goes on past the points."""
    low, high = points[:, :2].min(axis=0) - beyond, points[:, :2].max(axis=0) + beyond
    return Grid.covering(np.array([low, high]), resolution)
