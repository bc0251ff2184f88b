"""The scale of comparison: the finest detail that the points of a submap resolve.

Keypoints, variance mask, search, alignment and score all work at this length. It follows from the
points: a kernel that explains them well may be much longer than the detail that they resolve.
"""

from math import e, log, pi, sqrt

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array

RESOLVED = 2.0
"""The scale of comparison is this many times the length at which terrain and noise are equally
strong."""
CELLS_ACROSS = 60.0
"""Largest number of scales of comparison across a submap."""
FEWEST_ACROSS = 8.0
"""Smallest number of scales of comparison across a submap."""
STEPS_A_DOUBLING = 2
"""Steps in each doubling to which a scale of a single map is rounded."""


def resolved_scale(noise_density: float, slope_std: float, area: float) -> float:
    """Compute the best scale of comparison [m]: 1/60 to 1/8 of the side of a square of the area.

    Natural ground is self-similar: its power falls with about the fourth power of the wavenumber k,
    as slope_std² / k⁴, with slope_std [m/m] along any direction. Noise is white; its power is
    noise_density at every wavenumber: the variance of a point's height divided by the number of
    points per area [m⁴]. They are equal at a length that grows with the fourth root of their ratio:

        scale ~ (noise_density / slope_std²)^(1/4)
    """
    across = sqrt(area)
    noisy = RESOLVED * (noise_density / max(slope_std, 1e-9) ** 2) ** 0.25
    return min(max(noisy, across / CELLS_ACROSS), across / FEWEST_ACROSS)


def finest_of_kernel(noise_density: float, signal_std: float, length_scale: float) -> float:
    """Compute the scale [m] below which noise of density N [m⁴] exceeds a fitted terrain.

    The power of the squared exponential, S₀ exp(-k² l² / 2) with S₀ = 2π σ² l², falls below N at k
    = √(2 log(S₀ / N)) / l. σ and l [m] are fitted to the points.
    """
    ratio = 2 * pi * (signal_std * length_scale) ** 2 / max(noise_density, 1e-300)
    return length_scale / sqrt(2 * log(max(ratio, e)))


def rounded_scale(scale: float) -> float:
    """Round a scale to one of `STEPS_A_DOUBLING` steps in each doubling [m].

    >>> round(rounded_scale(0.3), 3)
    0.354
    """
    return float(2.0 ** (round(STEPS_A_DOUBLING * log(scale, 2)) / STEPS_A_DOUBLING))


def std_at_scale(signal_std: float, length_scale: float, scale: float) -> float:
    """Compute how much heights typically change over a scale [m]."""
    return signal_std * min(1.0, scale / length_scale)


def noise_density(
    variance: Float[Array, "*shape"], signal_std: float, length_scale: float
) -> Float[Array, "*shape"]:
    """Compute the density of the points' noise from the posterior variance [m⁴].

    Many points with noise density N leave the share N / (S + N) of each wave of a terrain with
    power S unknown. S₀ = 2π σ² l² is the power of the longest waves of the squared exponential.
    Summed over all waves, the variance [m²] is

        v = N / (2π l²) · log(1 + S₀ / N)

    It grows with N, and a table solves it for N.
    """
    strongest = 2 * pi * (signal_std * length_scale) ** 2
    density = np.logspace(-12, 4, 321) * strongest
    left = density / (2 * pi * length_scale**2) * np.log1p(strongest / density)
    least = 1e-12 * signal_std**2
    solved = np.interp(np.log(np.maximum(variance, least)), np.log(left), np.log(density))
    return np.exp(solved)
