"""How exact a fit is to be: both fast solvers stop at the same place."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """What a fast solver may leave out.

    Attributes:
        residual: The heights are solved for until their residual is this, in units of the noise
            (rms). The mean at the points is then no further off, for K (K + D)⁻¹ shrinks; but
            between the points, beside them, and where the noise differs from point to point, it
            can be off by more. At 0.01 it was, by up to 0.016 of the noise. At 0.003, over 300
            random clouds with a noise of its own for each point, it is off by at most 0.004,
            for one more step at the most (tests/quality/test_accuracy.py).
        ripple: Of the kernel that the lattice of the variance stands for, times the information
            of the data: the standard deviation is within 2 % (measured: half of this) of 0.03.
        lattice_halo: Length-scales of neighbouring points that a strip of the lattice sees beside
            its own, for the variance.
        tile_halo: The same for a tile: the standard deviation is within 1 % where it is trusted,
            and within 2 % elsewhere, at 3.
    """

    residual: float = 0.003
    ripple: float = 0.03
    lattice_halo: float = 4.0
    tile_halo: float = 3.0


EXACT = Accuracy()
"""What all results are made with."""
ROUGH = Accuracy(residual=0.1, ripple=0.3, lattice_halo=2.5, tile_halo=2.0)
"""For a picture that a better one follows: deviations within 10 %, at half the time or less."""
