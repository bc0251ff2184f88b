"""Chooses the model of the sensor's noise and its numbers by a dataset's own likelihood.

Each point of a patch is predicted from the others. What is left of its height is noise, and the
uncertainty of the terrain there. Every model of the noise explains these residuals, those of all
submaps together, and the one that explains them best is taken. Student's t in place of a Gaussian
keeps a few outliers, and ground that is rougher than the rest, from moving the numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, Indices
from gpgrad_core.gp.likelihood import Likelihood
from gpgrad_core.gp.noise import measure_noise
from gpgrad_core.mapping.gradient_map import NOISES, TerrainParams, sample_rows, subsample
from gpgrad_core.types import Submap

FREEDOM = 4.0
"""Degrees of freedom of Student's t, the distribution of the residuals."""
SHRINK = 0.6906
"""Squared scale of the t that fits a Gaussian of variance 1 best: c² in the equation
E[(f + 1) u² / (f c² + u²)] = 1 over the Gaussian u, with f = `FREEDOM`.
"""
SURE = 2.0
"""Noise that grows with range is taken where its gain over constant noise is this many standard
errors of the mean gain of a patch."""
MEASURED_GAIN = 0.15
"""Measured noise is taken where its gain in the log density of a residual is above this."""
MEASURED_GAIN_ALONE = 0.07
"""The same where no ranges are known: measured noise alone can follow those that grow with
range."""

LEAST = 1e-6
"""Smallest noise [m], and smallest of what a number multiplies."""
MOST_MEASURED = 100_000
"""Largest number of points of a submap from which the noise that is shown is measured."""
SHOWN_POINTS = 240
"""Largest number of points of a submap whose noise is shown."""

Chosen = Literal["constant", "range", "measured"]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Points of all patches, each predicted from the other points of its patch."""

    residual: Float[Array, "n"]  # height less the prediction (n,) [m]
    variance: Float[Array, "n"]  # variance of the residual without the point's noise (n,) [m²]
    ranges: Float[Array, "n"]  # distance from the sensor (n,) [m]; NaN if it is not known
    measured: Float[Array, "n"]  # noise measured from other points around (n,) [m]
    patch: Int[Indices, "n"]  # number of the patch that the point is in (n,)

    @classmethod
    def of(
        cls, patches: Sequence[Likelihood], ranges: Float[Array, "n"], measured: Float[Array, "n"]
    ) -> "Residuals":
        return cls(
            np.concatenate([patch.residual for patch in patches]),
            np.concatenate([patch.variance for patch in patches]),
            ranges,
            measured,
            np.repeat(np.arange(len(patches)), [len(patch.residual) for patch in patches]),
        )

    def with_terrain(self, patches: Sequence[Likelihood]) -> "Residuals":
        """The same points with the residuals of another terrain."""
        return Residuals.of(patches, self.ranges, self.measured)

    def terms(self, model: Chosen) -> Float[Array, "k n"]:
        """The terms that a model's numbers multiply at each point; the noise is their sum."""
        return NOISES[model].terms(self.ranges, self.measured)


@dataclass(frozen=True)
class SensorNoise:
    """A model of the noise with its numbers."""

    model: Chosen  # the noise model
    # factors of its terms: the noise [m]; the noise [m] and its growth [1/m]; or the factor on the
    # measured noise
    numbers: tuple[float, ...]
    log_likelihood: float  # mean log density of a residual in metres


def choose_noise(residuals: Residuals) -> SensorNoise:
    """Choose the noise model under which the points left out are most likely."""
    best, best_each = _fit(residuals, "constant")
    has_ranges = bool(np.isfinite(residuals.ranges).all())
    if has_ranges:
        grown, grown_each = _fit(residuals, "range")
        if _surely_above(grown_each - best_each, residuals.patch):
            best = grown
    measured, _ = _fit(residuals, "measured")
    gain = measured.log_likelihood - best.log_likelihood
    return measured if gain > (MEASURED_GAIN if has_ranges else MEASURED_GAIN_ALONE) else best


@dataclass(frozen=True, eq=False)
class NoiseOverRange:
    """The noise of some points of a submap, by their distance from the sensor."""

    # distance of each point, ascending (n,) [m]; NaN if the clouds do not give it
    ranges: Float[Array, "n"]
    modelled: Float[Array, "n"]  # its noise by the noise model (n,) [m]
    measured: Float[Array, "n"]  # its noise by the scatter of the points around (n,) [m]


def noise_over_range(submap: Submap, params: TerrainParams) -> NoiseOverRange:
    """Compare the noise that a model gives with the scatter of the points."""
    submap = subsample(submap, MOST_MEASURED)
    measured = measure_noise(submap.points, params.length_scale, params.noise_std)
    rows = sample_rows(submap, SHOWN_POINTS)
    ranges = np.full(len(rows), np.nan) if submap.ranges is None else submap.ranges[rows]
    rows = rows[np.argsort(ranges)]
    modelled = params.noise.ordinary(submap)[rows]
    there = measured.std_at(submap.points[rows, :2])
    return NoiseOverRange(np.sort(ranges), modelled, there)


def measured_by_others(
    points: Float[Array, "n 3"], rows: Int[Indices, "k"], length_scale: float, prior_std: float
) -> Float[Array, "k"]:
    """Measure the noise at some points (k,) [m] without themselves: each half by the other."""
    odd = np.arange(len(points)) % 2 == 1
    measured = np.full(len(rows), prior_std)
    for half in (odd, ~odd):
        if half.sum() >= FEWEST_MEASURED:
            noise_of_half = measure_noise(points[half], length_scale, prior_std)
            others = ~half[rows]
            measured[others] = noise_of_half.std_at(points[rows[others], :2])
    return measured


FEWEST_MEASURED = 30
"""Smallest number of points that measure the noise of others."""


def _surely_above(gain: Float[Array, "n"], patch: Int[Indices, "n"]) -> bool:
    each = np.bincount(patch, gain) / np.bincount(patch)
    error = (
        each.std(ddof=1) / np.sqrt(len(each)) if len(each) > 1 else gain.std() / np.sqrt(len(gain))
    )
    return float(each.mean()) > SURE * float(error)


def _scale_of(
    residuals: Residuals, model: Chosen, numbers: Float[Array, "k"]
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Compute the squared scale of Student's t at each point [m²], and the noise [m]."""
    noise = numbers @ residuals.terms(model)
    return SHRINK * (residuals.variance + noise**2 + LEAST**2), noise


def _density(residuals: Residuals, model: Chosen, numbers: Float[Array, "k"]) -> Float[Array, "n"]:
    scale, _ = _scale_of(residuals, model, numbers)
    squared = residuals.residual**2
    return -0.5 * np.log(scale) - 0.5 * (FREEDOM + 1) * np.log1p(squared / (FREEDOM * scale))


def _fit(residuals: Residuals, model: Chosen) -> tuple[SensorNoise, Float[Array, "n"]]:
    """Fit the numbers of a model; return it, and the log density of each residual."""
    from scipy.optimize import minimize  # noqa: PLC0415 - loads slowly

    terms, squared = residuals.terms(model), residuals.residual**2
    # The median of a squared Gaussian is 0.455 of its variance.
    usual = float(np.sqrt(np.median(squared) / 0.455)) + LEAST
    start = np.log(usual / (len(terms) * np.maximum(np.median(terms, axis=1), LEAST)))

    def descend(logs: Float[Array, "k"]) -> tuple[float, Float[Array, "k"]]:
        numbers = np.exp(logs)
        scale, noise = _scale_of(residuals, model, numbers)
        by_scale = (-1 + (FREEDOM + 1) * squared / (FREEDOM * scale + squared)) / (2 * scale)
        by_noise = by_scale * 2 * SHRINK * noise
        slope = numbers * (terms @ by_noise) / len(squared)
        return -float(_density(residuals, model, numbers).mean()), -slope

    logs: Array = minimize(
        descend, start, jac=True, method="L-BFGS-B", bounds=[(s - 12, s + 5) for s in start]
    ).x
    each = _density(residuals, model, np.exp(logs))
    numbers = tuple(np.exp(logs).tolist())
    return SensorNoise(model, numbers, float(each.mean())), each
