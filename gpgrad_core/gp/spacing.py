"""How fine a lattice must be to stand for the kernel, and what is too fine to be solved."""

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.gp.kernel import SquaredExponential

SPACINGS = (0.4, 0.8)
"""Least and largest spacing, in length-scales; at the least the ripple is 8e-14."""
MOST_INFORMATION = 1e10
"""Beyond this, rounding errors of the solution are no longer far below the noise."""
MOST_NODES = 16_000_000
"""Of the finest lattice; each array of as many takes 128 MB."""


def information(
    xy: Float[Array, "n 2"], noise_variance: Float[Array, "n"], kernel: SquaredExponential
) -> float:
    """Largest precision that the data bring to one bump, relative to its prior: s² max G."""
    cells = np.floor((xy - xy.min(axis=0)) / kernel.length_scale).astype(np.int64)
    _, owner = np.unique(cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1], return_inverse=True)
    densest = np.bincount(owner, weights=1 / noise_variance).max()
    return max(float(kernel.signal_std**2 * densest * np.pi / 2), 1.0)


def lattice_spacing(length_scale: float, information: float, ripple: float) -> float:
    """Find the spacing at which the lattice kernel's ripple, times the information, is this [m].

    The ripple of spacing h is 2 exp(-π² l² / (2 h²)) of the kernel's height.
    """
    ratio = np.pi / np.sqrt(2 * np.log(2 * information / ripple))
    return length_scale * float(np.clip(ratio, *SPACINGS))


def gaussian_reach(information: float, error: float) -> float:
    """Widths beyond which a Gaussian exp(-d²), times the information, is below an error."""
    return float(np.sqrt(np.log(information / error)))


def check_solvable(xy: Float[Array, "n 2"], kernel: SquaredExponential, information: float) -> None:
    """Refuse what would run out of digits or of memory.

    Raises:
        InputError: Says which parameter to change, and to what.
    """
    excess = information / MOST_INFORMATION
    if excess > 1:
        raise InputError(
            f"noise_std is too small beside signal_std {kernel.signal_std:.2g} m with so many "
            f"points in a length-scale of {kernel.length_scale:g} m: raise it "
            f"{np.ceil(np.sqrt(excess) * 10) / 10:g}-fold or more, or lower the length-scale"
        )
    sides = xy.max(axis=0) - xy.min(axis=0)
    nodes = float(np.prod(sides / (SPACINGS[0] * kernel.length_scale) + 1))
    if nodes > MOST_NODES:
        least = kernel.length_scale * np.sqrt(nodes / MOST_NODES)
        raise InputError(
            f"length-scale {kernel.length_scale:g} m is too short for a cloud of "
            f"{sides[0]:,.0f} m x {sides[1]:,.0f} m: the GP would need {nodes:,.0f} nodes, more "
            f"than the {MOST_NODES:,} allowed; raise the length-scale to "
            f"{np.ceil(least * 100) / 100:g} m or more, or cut the cloud into submaps"
        )
