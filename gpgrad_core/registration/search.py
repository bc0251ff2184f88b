"""Exhaustive search over all yaws and shifts: candidate motions that need no keypoints."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, cos, sin

import cv2
import numpy as np
from jaxtyping import Complex64, Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.registration.relief import Image, Relief, level_octaves
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array

NUM_YAWS = 36
"""Number of yaws tried. The alignment that follows converges from more than half of the 10 degrees
between them."""
CELL = 2.0
"""Side of a cell [scales of comparison]."""
MOST_CELLS = 64
"""Largest number of cells across a map. On larger maps the cells double in size, so that the time
of a pair stays bounded."""
SIZES = (32, 48, 64, 80, 96, 128, 160)
"""Sizes of the spectra [cells]. They are fast to transform, and few, so that two maps mostly have
the same."""
LEAST_PATCHES = 4.0
"""Smallest overlap that is considered, in patches of 2π cell²/4, over which terrain is alike."""
APART = 2
"""A shift within this many cells of a better one is the same candidate."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Fourier transforms of one map at some yaws, for the search.

    Attributes:
        cell: Side of a cell [m].
        middle: Point (x, y) about which the map is rotated [m].
        half: Number of cells from that point to the edge of the rotated images.
        values: Transforms of the terrain, the mask and the squared terrain at each yaw
            (yaws, 3, size, half_size).
    """

    cell: float
    middle: Float[Array, "2"]
    half: int
    values: Complex64[NDArray[np.complex64], "yaws 3 size half_size"]

    @property
    def size(self) -> int:
        """Side of the transformed images [cells]."""
        return self.values.shape[2]


@lru_cache(maxsize=16)
def make_spectra(
    relief: Relief, num_yaws: int, cell: float | None = None, size: int | None = None
) -> Spectra:
    """Rotate a map by the first yaws and transform it.

    The last results are kept, because a query is compared with many databases in a row. They are
    too large to be kept with each map.

    Args:
        relief: The map.
        num_yaws: `NUM_YAWS` for the query; 1 for the database, which is not rotated.
        cell: Side of a cell [m]; None chooses it by the map's extent.
        size: Side of the images [cells]; None chooses the smallest that serves two maps of this
            extent.
    """
    import scipy.fft  # noqa: PLC0415 - loads slowly

    rows, columns = np.nonzero(relief.trusted)
    cells = np.column_stack([columns, rows]).astype(np.float64)
    middle = relief.grid.to_position(cells.mean(axis=0)[None])[0] if len(cells) else np.zeros(2)
    xy = relief.grid.to_position(cells) - middle
    radius = float(np.hypot(*xy.T).max(initial=0.0))
    finest = CELL * relief.scale
    if cell is None:
        cell = finest
        while 2 * radius / cell > MOST_CELLS:
            cell *= 2
    half = ceil(radius / cell) + 1
    if size is None:
        # Shifts with fewer than 4 cells of overlap may wrap around; they are not used.
        size = next((one for one in SIZES if one >= 4 * half - 3), SIZES[-1])
    terrain = relief.terrain if cell == finest else level_octaves(relief, cell / 2)
    images = np.dstack([terrain, relief.trusted.astype(np.float32)])
    yaws = _yaws()[:num_yaws]
    turned = np.stack([_turn(images, relief, middle, yaw, cell, half) for yaw in yaws])
    mask = (turned[..., 1] > 0.99).astype(np.float32)
    masked = turned[..., 0] * mask
    fields = np.stack([masked, mask, masked * masked], axis=1)
    values = scipy.fft.rfft2(fields, s=(size, size), workers=1)
    return Spectra(cell, middle, half, values.astype(np.complex64, copy=False))


def search_motions(query: Relief, database: Relief, wanted: int) -> list[SE2]:
    """Find the distinct motions under which the terrain of two maps correlates best.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        wanted: Number of motions to find.

    Returns:
        Up to so many motions ``T_database_query``, the best first. They may be a few cells off.
    """
    import scipy.fft  # noqa: PLC0415 - loads slowly

    if wanted == 0 or not query.trusted.any() or not database.trusted.any():
        return []
    of_query, of_database = _comparable(query, database)
    size, cell = of_query.size, of_query.cell
    # The conjugate of the other factor gives the mirrored correlation, but it is the larger one.
    fixed = np.conj(of_database.values[0])
    terrain, mask, squared = (of_query.values[:, k] for k in range(3))
    common, product, energy, energy_database = (
        scipy.fft.irfft2(spectrum, s=(size, size), workers=1, overwrite_x=True)
        for spectrum in (mask * fixed[1], terrain * fixed[0], squared * fixed[1], mask * fixed[2])
    )
    score = _score(common, product, np.multiply(energy, energy_database, out=energy))
    best = score.max(axis=0)
    motions: list[SE2] = []
    around = np.arange(-APART, APART + 1)
    while len(motions) < wanted:
        row, column = divmod(int(best.argmax()), size)
        if best[row, column] <= 0:
            break
        shift = -np.array([column, row])
        shift = (shift + size // 2) % size - size // 2 + of_query.half - of_database.half
        yaw = float(_yaws()[score[:, row, column].argmax()])
        offset = of_database.middle + cell * shift - SE2(yaw=yaw).rotation @ of_query.middle
        motions.append(SE2(float(offset[0]), float(offset[1]), yaw))
        best[np.ix_((row + around) % size, (column + around) % size)] = 0.0
    return motions


def _score(
    common: Float[Image, "yaws size size"],
    product: Float[Image, "yaws size size"],
    energy: Float[Image, "yaws size size"],
) -> Float[Image, "yaws size size"]:
    """Score every shift at every yaw.

    The score is ``-log(1 - correlation²) √common``. It is computed in place, because passes over
    these arrays take most of the search's time.

    Args:
        common: Number of common cells.
        product: Sum of the products of both maps' terrain over the common cells.
        energy: Product of the sums of their squares.
    """
    np.maximum(common, 0.0, out=common)
    # The small addition keeps flat ground and rounding errors from correlating.
    np.maximum(energy, 0.0, out=energy)
    floor = np.multiply(common, common)
    floor *= np.float32(1e-3)
    floor += np.float32(1e-6)
    energy += floor
    np.maximum(product, 0.0, out=product)
    product *= product
    product /= energy
    np.subtract(1.0, np.minimum(product, 0.998, out=product), out=product)
    score = np.log(product, out=product)
    enough = common >= LEAST_PATCHES * np.pi / 2
    score *= -np.sqrt(common, out=common) * enough
    return score


def _yaws() -> Float[Array, "yaws"]:
    return 2 * np.pi / NUM_YAWS * np.arange(NUM_YAWS, dtype=np.float64)


def _comparable(query: Relief, database: Relief) -> tuple[Spectra, Spectra]:
    """Transform two maps with the same cell and size; mostly they have these already."""
    wanted = (query, NUM_YAWS), (database, 1)
    both = [make_spectra(*one) for one in wanted]
    cell, size = max(one.cell for one in both), max(one.size for one in both)
    of_query, of_database = (
        one if (one.cell, one.size) == (cell, size) else make_spectra(*again, cell, size)
        for again, one in zip(wanted, both, strict=True)
    )
    return of_query, of_database


def _turn(
    images: Image, relief: Relief, middle: Array, yaw: float, cell: float, half: int
) -> Image:
    """Rotate images about a point, and resample them to cells of another size."""
    step = cell / relief.grid.resolution
    c, s = step * cos(yaw), step * sin(yaw)
    column, row = relief.grid.to_pixel(middle[None])[0]
    onto = np.array([[c, s, column - half * (c + s)], [-s, c, row - half * (c - s)]])
    side = 2 * half + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(images, onto, (side, side), flags=flags), np.float32)
