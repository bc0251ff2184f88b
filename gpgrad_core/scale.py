"""The scale of comparison: the finest detail that the points of a submap resolve.

Keypoints, variance mask, search, alignment and score all work at this length. It follows from the
points and not from the kernel: a kernel that explains the points well may be much longer than the
detail that the points resolve.
"""

from math import e, log, pi, sqrt

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array

RESOLVED = 2.0
"""The scale of comparison is this many times the length at which terrain and noise are equally
strong. On four datasets of real terrain, whole, thinned and noisy: at half of that, noise spoils
the keypoints of sparse clouds; at twice that, few details are left to distinguish places. In the
mean of five noisy draws, 0.84 of that raises average precision from .981 to .987 on apollo15, and
lowers it from .997 to .956 on hillside (tests/long/benchmarks/ablation.py)."""
CELLS_ACROSS = 60.0
"""Largest number of scales of comparison across a submap. It bounds the time of a pair; on dense
clouds more brought nothing."""
FEWEST_ACROSS = 8.0
"""Smallest number of scales of comparison across a submap; fewer do not describe a place."""
STEPS_A_DOUBLING = 2
"""A scale that is measured on a single map is rounded to this many steps in each doubling, so that
two maps of one place mostly have the same scale."""


def resolved_scale(noise_density: float, slope_std: float, area: float) -> float:
    """Compute the best scale of comparison [m].

    Natural ground is self-similar: its power falls with about the fourth power of the wavenumber
    k, as slope_std² / k⁴. Noise is white; its power is noise_density at every wavenumber. They
    are equal at a length that grows with the fourth root of their ratio:

        scale ~ (noise_density / slope_std²)^(1/4)

    Args:
        noise_density: Variance of a point's height divided by the number of points per area [m⁴].
        slope_std: Standard deviation of the terrain's slope along any direction [m/m].
        area: Area of a submap [m²].

    Returns:
        The scale [m], between 1/60 and 1/8 of the side of a square of that area.
    """
    across = sqrt(area)
    noisy = RESOLVED * (noise_density / max(slope_std, 1e-9) ** 2) ** 0.25
    return min(max(noisy, across / CELLS_ACROSS), across / FEWEST_ACROSS)


def finest_of_kernel(noise_density: float, signal_std: float, length_scale: float) -> float:
    """Compute the scale below which the noise is stronger than a fitted terrain [m].

    The power of the squared exponential, S₀ exp(-k² l² / 2), falls below the noise density N at
    k = √(2 log(S₀ / N)) / l. Ground that is smoother than self-similar ground has no detail
    beyond that.

    Args:
        noise_density: N [m⁴].
        signal_std: σ, fitted to the points [m]; S₀ = 2π σ² l².
        length_scale: l, fitted to the points [m].
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
    """Compute how much heights typically change over a scale [m].

    The slopes of the squared exponential have the standard deviation signal_std / length_scale.
    Over more than a length-scale heights change by signal_std.

    Args:
        signal_std: Standard deviation of the terrain's height [m].
        length_scale: Length-scale of the kernel [m].
        scale: The scale of comparison [m].
    """
    return signal_std * min(1.0, scale / length_scale)


def noise_density(
    variance: Float[Array, "*shape"], signal_std: float, length_scale: float
) -> Float[Array, "*shape"]:
    """Compute the density of the points' noise from the posterior variance [m⁴].

    Many points with noise density N leave the share N / (S + N) of each wave of a terrain with
    power S unknown. S₀ = 2π σ² l² is the power of the longest waves of the squared exponential.
    Summed over all waves, the variance is

        v = N / (2π l²) · log(1 + S₀ / N)

    It grows with N, and is solved for N by a table.

    Args:
        variance: Posterior variance v of the elevation [m²], of any shape.
        signal_std: σ [m].
        length_scale: l [m].

    Returns:
        N [m⁴], in the shape of the variance.
    """
    strongest = 2 * pi * (signal_std * length_scale) ** 2
    density = np.logspace(-12, 4, 321) * strongest
    left = density / (2 * pi * length_scale**2) * np.log1p(strongest / density)
    least = 1e-12 * signal_std**2
    solved = np.interp(np.log(np.maximum(variance, least)), np.log(left), np.log(density))
    return np.exp(solved)
