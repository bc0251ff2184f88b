"""How exact the solution of a fit has to be; both fast solvers use the same limits."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """The limits at which a fast solver stops.

    Attributes:
        residual: The residual of the heights (rms, in units of the noise) at which the solver
            stops. At the points the mean is then no further off, because K (K + D)⁻¹ shrinks
            errors. Between and beside the points, and where the noise differs from point to
            point, the error can be larger: at 0.01 it was up to 0.016 of the noise. At 0.003,
            over 300 random clouds with different noise for each point, it is at most 0.004, for
            one more step at most (tests/quality/test_accuracy.py).
        ripple: Limit on the ripple of the kernel that the lattice for the variance stands for,
            times the information of the data. At 0.03 the standard deviation is within 2 % (half
            of that was measured).
        lattice_halo: Width of the neighbouring points that a strip of the lattice sees, for the
            variance [length-scales].
        tile_halo: The same for a tile. At 3 the standard deviation is within 1 % where it is
            trusted, and within 2 % elsewhere.
    """

    residual: float = 0.003
    ripple: float = 0.03
    lattice_halo: float = 4.0
    tile_halo: float = 3.0


EXACT = Accuracy()
"""The accuracy of all results."""
ROUGH = Accuracy(residual=0.1, ripple=0.3, lattice_halo=2.5, tile_halo=2.0)
"""For a picture that a better one soon replaces: within 10 %, in half the time or less."""
