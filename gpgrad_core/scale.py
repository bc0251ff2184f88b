"""The scale of comparison: the finest detail that the points of a submap resolve.

Everything that compares maps works at this length: the keypoints, the variance mask, the search,
the alignment and the evidence. It follows from the points, and never from the kernel: a kernel
that explains the points well may be much longer than the detail that they resolve.
"""

from math import e, log, pi, sqrt

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array

RESOLVED = 2.0
"""How many times the length at which terrain and noise are equally strong. Measured on four sets
of real terrain, whole, thinned and noisy: at half of it noise spoils the keypoints of sparse
clouds, at twice of it few details are left to tell places apart."""
CELLS_ACROSS = 60.0
"""Lengths of this scale across a submap at the most. It bounds the time of a pair; on dense clouds
nothing was gained beyond it."""
FEWEST_ACROSS = 8.0
"""Lengths of this scale across a submap at the least: fewer hold no place."""
STEPS_A_DOUBLING = 2
"""A map that is measured by itself rounds its scale to this many steps, so that the maps of one
place mostly agree on it."""


def resolved_scale(noise_density: float, slope_std: float, area: float) -> float:
    """Tell the scale at which maps are best compared [m].

    Natural ground is self-similar: its power falls about with the fourth power of the wavenumber
    k, as slope_std² / k⁴. Noise is white, with the power noise_density. They are equal at a
    length that grows with the fourth root of their ratio:

        scale ~ (noise_density / slope_std²)^(1/4)

    Args:
        noise_density: Variance of a point's height over the number of points per area [m⁴].
        slope_std: Standard deviation of the terrain's slope along any direction [m/m].
        area: Area of a submap [m²].
    """
    across = sqrt(area)
    noisy = RESOLVED * (noise_density / max(slope_std, 1e-9) ** 2) ** 0.25
    return min(max(noisy, across / CELLS_ACROSS), across / FEWEST_ACROSS)


def finest_of_kernel(noise_density: float, signal_std: float, length_scale: float) -> float:
    """Tell the scale below which a fitted terrain holds less than the noise [m].

    The power of the squared exponential, S₀ exp(-k² l² / 2), falls below the noise density N at
    k = √(2 log(S₀ / N)) / l. Ground that is smoother than self-similar ground has nothing to
    compare beyond that.

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
    """Tell how far heights typically change over a scale [m].

    The squared exponential has slopes of standard deviation signal_std / length_scale; over more
    than a length-scale heights change by signal_std.

    Args:
        signal_std: Standard deviation of the terrain's height [m].
        length_scale: Of the kernel [m].
        scale: The scale of comparison [m].
    """
    return signal_std * min(1.0, scale / length_scale)


def noise_density(
    variance: Float[Array, "*shape"], signal_std: float, length_scale: float
) -> Float[Array, "*shape"]:
    """Tell the density of the points' noise from the posterior variance that it leaves [m⁴].

    Many points of noise density N per area leave of each wave of a terrain with the power S the
    share N / (S + N). Summed over all waves of the squared exponential, S₀ = 2π σ² l² being the
    power of its longest, the variance is

        v = N / (2π l²) · log(1 + S₀ / N)

    which grows with N, and is solved for N here.

    Args:
        variance: Posterior variance of the elevation [m²].
        signal_std: σ [m].
        length_scale: l [m].
    """
    strongest = 2 * pi * (signal_std * length_scale) ** 2
    density = np.logspace(-12, 4, 321) * strongest
    left = density / (2 * pi * length_scale**2) * np.log1p(strongest / density)
    least = 1e-12 * signal_std**2
    solved = np.interp(np.log(np.maximum(variance, least)), np.log(left), np.log(density))
    return np.exp(solved)
