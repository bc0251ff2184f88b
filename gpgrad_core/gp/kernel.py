"""The paper's kernel, Eq. (6), and how fine a lattice must be to represent it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError


@dataclass(frozen=True)
class SquaredExponential:
    """``k(d) = signal_std² exp(-d² / (2 length_scale²))``, Eq. (6)."""

    signal_std: float  # standard deviation of the terrain's height [m]
    length_scale: float  # distance over which the height changes little [m]

    @property
    def slope_std(self) -> float:
        """Standard deviation of the terrain's slope along any direction [m/m]."""
        return self.signal_std / self.length_scale


SPACINGS = (0.4, 0.8)
"""Smallest and largest spacing [length-scales]."""
MOST_INFORMATION = 1e10
"""Largest information that is allowed; beyond it, rounding errors show."""
MOST_EMPTY = 4
"""Largest number of cells that are summed over, in points."""
MOST_NODES = 16_000_000
"""Largest number of nodes of the finest lattice."""


def information(
    xy: Float[Array, "n 2"], noise_variance: Float[Array, "n"], kernel: SquaredExponential
) -> float:
    """Compute the largest precision that the data bring to one bump, relative to its prior.

    It is s² max G in the terms of `weight_space`: how many digits a solution needs. Cells of a
    length-scale begin in four places, lest a cluster at their corners count for a quarter.
    """
    scaled, precision = (xy - xy.min(axis=0)) / kernel.length_scale, 1 / noise_variance
    densest = max(
        np.bincount(group(np.floor(scaled + begin).astype(np.int64)), weights=precision).max()
        for begin in ((0.0, 0.0), (0.0, 0.5), (0.5, 0.0), (0.5, 0.5))
    )
    return max(float(kernel.signal_std**2 * densest * np.pi / 2), 1.0)


def group(cells: Int[NDArray[np.int64], "n 2"]) -> Int[NDArray[np.int64], "n"]:
    """Number the cells (column, row) of points, ascending; some numbers may belong to no point."""
    flat = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    if flat.max() < MOST_EMPTY * len(flat):  # sorting takes ten times as long
        return flat
    return np.unique(flat, return_inverse=True)[1]


def lattice_spacing(length_scale: float, information: float, ripple: float) -> float:
    """Find the spacing [m] at which the ripple of the lattice kernel, times the information, is so.

    With spacing h, the ripple is 2 exp(-π² l² / (2 h²)) of the kernel's height.
    """
    ratio = np.pi / np.sqrt(2 * np.log(2 * information / ripple))
    return length_scale * float(np.clip(ratio, *SPACINGS))


def gaussian_reach(information: float, error: float) -> float:
    """Find the distance beyond which exp(-d²), times the information, is below an error."""
    return float(np.sqrt(np.log(information / error)))


def check_solvable(xy: Float[Array, "n 2"], kernel: SquaredExponential, information: float) -> None:
    """Refuse a GP that cannot be solved within the digits and memory; say what to change."""
    excess = information / MOST_INFORMATION
    if excess > 1:
        raise InputError(
            f"noise_std is too small for signal_std {kernel.signal_std:.2g} m and so many "
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
