"""The uncertainty of a map's elevation, by band of wavelengths."""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.scale import noise_density
from gpgrad_core.types import GradientMap

NUM_BANDS = 2
"""Number of octaves that are compared, from the scale of comparison on. Removing the tilt and the
bend of a submap removes most of the longer waves."""
NUM_DENSITIES, NUM_WAVES = 60, 120
"""Number of entries of the lookup table, and of wavenumbers in the sum behind each entry."""


def band_edges(scale: float, band: int) -> tuple[float, float]:
    """Widths of the two Gaussians whose difference passes the band [m]."""
    return scale * 2**band, scale * 2 ** (band + 1)


@dataclass(frozen=True, eq=False)
class BandNoise:
    """The variance of a map's error in each band, as a function of its posterior variance.

    For each wave of the terrain with power S, noise of density N disturbs the posterior mean by
    the power W² N with the gain W = S / (S + N). The variance in a band is the integral of that
    over the wavenumbers k, with H(k) the gain of the band's filter:

        N_band = ∫ H² W² N k dk / 2π

    The density N comes from the posterior variance, cell by cell (`scale.noise_density`).
    On true pairs of four datasets, whole, thinned and noisy, half of the variance of the
    difference of two maps agrees with this to within a quarter, wherever drift does not add to it.

    Attributes:
        gradient_map: The map; its kernel and its scale give the table.
        log_densities: Logarithms of the noise densities in the table (d,) [log m⁴].
        log_noise: Logarithm of the variance in each band at these (bands, d) [log m²].
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
        """Look up the variance in each band [m²] by the posterior variance [m²]."""
        made = self.gradient_map
        wanted = np.log(noise_density(variance, made.signal_std, made.length_scale))
        bands = [np.exp(np.interp(wanted, self.log_densities, row)) for row in self.log_noise]
        return np.stack(bands, axis=-1).astype(np.float32)
