"""What a map leaves unknown of its elevation, by band of wavelength."""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.scale import noise_density
from gpgrad_core.types import GradientMap

NUM_BANDS = 2
"""Octaves that are compared, from one scale of comparison on. Longer waves are mostly taken out
with the tilt and the bend of a submap, and say little more."""
NUM_DENSITIES, NUM_WAVES = 60, 120
"""Of the table that variances are looked up in, and of the sum over wavenumbers behind it."""


def band_edges(scale: float, band: int) -> tuple[float, float]:
    """Widths of the two Gaussians whose difference lets a band through [m]."""
    return scale * 2**band, scale * 2 ** (band + 1)


@dataclass(frozen=True, eq=False)
class BandNoise:
    """The variance of a map's error in each band, as a function of its posterior variance.

    Noise of density N disturbs the posterior mean of each wave of the terrain, whose power is S,
    by the power W² N with W = S / (S + N): the mean is the data, weighed by W. The variance in a
    band is the integral of that over the wavenumbers k that the band lets through, H(k):

        N_band = ∫ H² W² N k dk / 2π

    The density N comes from the posterior variance, cell by cell (`scale.noise_density`).
    Measured on true pairs of four sets, whole, thinned and noisy, half of the variance of the
    difference of two maps is this to within a quarter, wherever drift does not add to it.
    """

    gradient_map: GradientMap
    log_densities: Float[Array, "d"]
    log_noise: Float[Array, "bands d"]

    @classmethod
    def of(cls, gradient_map: GradientMap) -> "BandNoise":
        """Make the table for a map's kernel and scale."""
        signal, length = gradient_map.signal_std, gradient_map.length_scale
        strongest = 2 * pi * (signal * length) ** 2
        density = np.logspace(-12, 2, NUM_DENSITIES) * strongest
        log_k = np.linspace(np.log(0.02), np.log(12.0), NUM_WAVES)
        k = np.exp(log_k) / gradient_map.scale
        power = strongest * np.exp(-0.5 * (k * length) ** 2)
        passed = power / (power + density[:, None])
        disturbed = passed**2 * density[:, None] * k**2 / (2 * pi)
        rows: list[Array] = []
        for band in range(NUM_BANDS):
            fine, coarse = band_edges(gradient_map.scale, band)
            let_through = np.exp(-0.5 * (k * fine) ** 2) - np.exp(-0.5 * (k * coarse) ** 2)
            step = log_k[1] - log_k[0]
            rows.append(np.log((disturbed * let_through**2).sum(axis=1) * step + 1e-30))
        return cls(gradient_map, np.log(density), np.stack(rows))

    def at(
        self, variance: Float[Array, "rows columns"]
    ) -> Float[NDArray[np.float32], "rows columns bands"]:
        """Look up the variance of each band [m²] by the posterior variance there [m²]."""
        made = self.gradient_map
        wanted = np.log(noise_density(variance, made.signal_std, made.length_scale))
        bands = [np.exp(np.interp(wanted, self.log_densities, row)) for row in self.log_noise]
        return np.stack(bands, axis=-1).astype(np.float32)
