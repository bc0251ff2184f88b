"""Arrays as text that a browser unpacks by itself: deflated, and in base64."""

import base64
import zlib
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, Mask, NDArray
from gpgrad_core.types import Grid

FINEST = 0.0005
"""Smallest step of a packed height [m]: half a millimetre, far below what points tell."""
LARGEST = 2**15 - 1
"""Number of steps that a height may span."""


@dataclass(frozen=True, eq=False)
class Pack:
    """Arrays one after the other, each with its name; little-endian, as browsers have it."""

    arrays: list[bytes] = field(default_factory=list[bytes])
    # name, type, and number of bytes of each array
    index: list[tuple[str, str, int]] = field(default_factory=list[tuple[str, str, int]])

    def add(self, name: str, array: NDArray[np.generic]) -> None:
        """Add an array: of uint8, uint16, int16, float32 or float64."""
        # Each begins at a multiple of four bytes, as the typed arrays of a browser must.
        raw = array.astype(array.dtype.newbyteorder("<")).tobytes()
        self.arrays.append(raw + bytes(-len(raw) % 4))
        self.index.append((name, array.dtype.name, len(raw)))

    @property
    def text(self) -> str:
        """All of them, in letters."""
        return base64.b64encode(zlib.compress(b"".join(self.arrays), 9)).decode("ascii")


@dataclass(frozen=True, eq=False)
class Packed:
    """The terrain of one submap, fit to be packed.

    Attributes:
        grid: Its cells.
        base: Lowest height [m].
        step: Of a height [m].
        deltas: Differences of the heights along each row, as whole steps; the low bytes of all
            cells, and then the high ones, because these are nearly all alike.
        known: Which cells are trusted, a bit for each.
    """

    grid: Grid
    base: float
    step: float
    deltas: NDArray[np.uint8]
    known: NDArray[np.uint8]


def pack_terrain(
    elevation: Float[Array, "rows columns"], known: Bool[Mask, "rows columns"], grid: Grid
) -> Packed:
    """Make the heights [m] of a submap small: whole steps, and differences from cell to cell."""
    trusted = elevation[known]
    low, high = (float(trusted.min()), float(trusted.max())) if known.any() else (0.0, 0.0)
    step = max(FINEST, (high - low) / LARGEST)
    steps = np.rint((np.clip(elevation, low, high) - low) / step).astype(np.int32)
    # Where nothing is known the last known height goes on, which costs nothing.
    last = np.maximum.accumulate(np.where(known, np.arange(steps.shape[1]), 0), axis=1)
    steps = np.take_along_axis(steps, last, axis=1)
    deltas = np.diff(steps, axis=1, prepend=0).ravel()
    folded = ((deltas << 1) ^ (deltas >> 31)).astype(
        np.uint16
    )  # small ones of both signs are small
    planes = np.concatenate([folded & 0xFF, folded >> 8]).astype(np.uint8)
    return Packed(grid, low, step, planes, np.packbits(known.ravel(), bitorder="little"))
