"""Candidate motions: Algorithm 1's RANSAC, and an exhaustive search that needs no keypoints."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, cos, sin

import cv2
import numpy as np
from jaxtyping import Bool, Complex64, Complex128, Float, Int

from gpgrad_core.arrays import Array, Indices, Mask, NDArray, Singles
from gpgrad_core.registration.params import RegistrationParams
from gpgrad_core.registration.surface import Surface, level_octaves
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Matches

ComplexArray = NDArray[np.complex128]

TRIALS_AT_ONCE = 256
"""Number of motions whose errors are computed together, in a processor's cache."""
X_IY: ComplexArray = np.array([1, 1j])
"""Makes x + iy of rows of x and y: complex points turn by a product."""
SAME_TURN = 0.1
"""Motions whose yaw differs by less than this are the same candidate [rad]."""
NUM_YAWS = 30
"""Number of yaws; the alignment converges from more than half of what lies between them."""
CELL = 2.0
"""Side of a cell [scales of comparison]."""
MOST_CELLS = 64
"""Largest number of cells across a map; cells of larger maps double."""
SIZES = (32, 48, 64, 80, 96, 128, 160)
"""Sizes of the spectra [cells]: fast to transform, and few, so that maps mostly share one."""
LEAST_PATCHES = 4.0
"""Smallest overlap that is considered, in patches of 2π cell²/4."""
APART = 2
"""A shift within this many cells of a better one is the same candidate."""


def find_motions(matches: Matches, params: RegistrationParams, radius: float) -> list[SE2]:
    """Find the ``T_database_query`` with most inliers, best first: Algorithm 1's RANSAC."""
    num = len(matches)
    if num < 2:
        return []
    every = num * (num - 1) // 2 <= params.trials
    pairs = np.triu_indices(num, 1) if every else draw_pairs(num, params.trials, params.seed)
    first, second = pairs
    query, database = matches.query_xy @ X_IY, matches.database_xy @ X_IY
    a, b = query[second] - query[first], database[second] - database[first]
    # Two associations of one rigid motion have the same distance in both maps. Two that are too
    # close to each other say nothing about the yaw.
    span_a, span_b = np.abs(a), np.abs(b)
    rigid = (np.abs(span_a - span_b) <= 2 * radius) & (np.minimum(span_a, span_b) >= 2 * radius)
    if not rigid.any():
        return []
    first, second = first[rigid], second[rigid]
    # GetSE2Transform of each two associations, in closed form.
    turn = a[rigid].conj() * b[rigid]
    turn /= np.abs(turn)  # cos yaw + i sin yaw
    # Where each motion moves the middle of the query's keypoints.
    middle = complex(query.mean())
    placed = (database[first] + database[second]) / 2
    placed -= turn * ((query[first] + query[second]) / 2 - middle)
    counts = _count_inliers(turn, placed, query - middle, database, radius)
    order = np.argsort(-counts, kind="stable")
    return _distinct(turn[order], placed[order], middle, radius, params.hypotheses)


def draw_pairs(num: int, trials: int, seed: int) -> tuple[Int[Indices, "t"], Int[Indices, "t"]]:
    """SelectRandomAsso: draw pairs of different associations."""
    generator = np.random.default_rng(seed)
    first = generator.integers(num, size=trials)
    second = generator.integers(num - 1, size=trials)
    return first, second + (second >= first)


def _count_inliers(
    turn: Complex128[ComplexArray, "t"],
    placed: Complex128[ComplexArray, "t"],
    query: Complex128[ComplexArray, "m"],
    database: Complex128[ComplexArray, "m"],
    radius: float,
) -> Int[Indices, "t"]:
    """GetInliers for all trials; associations that share a position may count twice here.

    The squared error of association (q, d) under rotation R and offset t is

        |Rq + t - d|² = |q|² + |d|² + |t|² + 2 Rᵀt·q - 2 t·d - 2 (q·d cos yaw + q×d sin yaw)

    so one matrix product gives all errors. Turns are cos yaw + i sin yaw; positions are x + iy [m],
    of the query relative to its keypoints' middle, which each motion moves to where it is
    ``placed``.
    """
    # Relative to its middle no digits are lost, however far the frame's origin lies.
    middle = database.mean()
    database, offset = database - middle, placed - middle
    lengths, ones = np.abs(query) ** 2 + np.abs(database) ** 2, np.ones(len(query))
    both = query.conj() * database  # q·d + i q×d
    points = (query, database, both)
    match_factors = np.stack([lengths, ones, *(part for p in points for part in (p.real, p.imag))])
    far, back = np.abs(offset) ** 2, 2 * turn.conj() * offset
    motions = (back, -2 * offset, -2 * turn)
    alone = [np.ones(len(turn)), far]
    trial_factors = np.stack([*alone, *(part for p in motions for part in (p.real, p.imag))], 1)
    counts = np.empty(len(turn), np.intp)
    for first in range(0, len(turn), TRIALS_AT_ONCE):
        some = slice(first, first + TRIALS_AT_ONCE)
        inside = trial_factors[some] @ match_factors <= radius**2
        with np.errstate(invalid="ignore"):  # zeros and ones are valid; some BLAS still complains
            counts[some] = inside.astype(np.float32) @ ones.astype(np.float32)
    return counts


def _distinct(
    turn: Complex128[ComplexArray, "t"],
    placed: Complex128[ComplexArray, "t"],
    middle: complex,
    radius: float,
    count: int,
) -> list[SE2]:
    """The first motions that differ in where they place the middle, or in their yaw."""
    left = np.arange(len(turn))
    motions: list[SE2] = []
    while len(motions) < count and len(left):
        k = int(left[0])
        offset = complex(placed[k] - turn[k] * middle)
        motions.append(SE2(offset.real, offset.imag, float(np.angle(turn[k]))))
        far = np.abs(placed[left] - placed[k]) > 2 * radius
        turned = (turn[left] * turn[k].conj()).real < cos(SAME_TURN)
        left = left[far | turned]
    return motions


def one_to_one(motion: SE2, matches: Matches, radius: float) -> Bool[Mask, "m"]:
    """Find the inliers of a motion within a radius [m]; of those that share a keypoint the best."""
    errors = np.hypot(*(motion.apply(matches.query_xy) - matches.database_xy).T)
    near = np.flatnonzero(errors <= radius)
    order = near[np.argsort(errors[near], kind="stable")]
    places = (map(tuple, xy[order].tolist()) for xy in (matches.query_xy, matches.database_xy))
    inliers = np.zeros(len(matches), bool)
    taken_query: set[tuple[float, ...]] = set()
    taken_database: set[tuple[float, ...]] = set()
    for k, in_query, in_database in zip(order.tolist(), *places, strict=True):
        if in_query not in taken_query and in_database not in taken_database:
            taken_query.add(in_query)
            taken_database.add(in_database)
            inliers[k] = True
    return inliers


@dataclass(frozen=True, eq=False)
class Spectra:
    """Fourier transforms of one map at some yaws, for the search."""

    cell: float  # side of a cell [m]
    middle: Float[Array, "2"]  # point (x, y) about which the map is rotated [m]
    half: int  # number of cells from that point to the edge of the rotated images
    # transforms of the terrain, the mask and the squared terrain at each yaw (yaws, 3, size,
    # half_size)
    values: Complex64[NDArray[np.complex64], "yaws 3 size half_size"]


@lru_cache(maxsize=16)
def make_spectra(surface: Surface, num_yaws: int, cell: float, size: int) -> Spectra:
    """Rotate a map by its first yaws, and transform images of ``size`` cells of a side [m]."""
    import scipy.fft  # noqa: PLC0415 - loads slowly

    middle, radius = surface.disc
    half = _half(radius, cell)
    is_finest = cell == CELL * surface.scale
    terrain = surface.terrain if is_finest else level_octaves(surface, cell / 2)
    images = np.dstack([terrain, surface.trusted.astype(np.float32)])
    yaws = _yaws()[:num_yaws]
    turned = np.stack([_turn(images, surface, middle, yaw, cell, half) for yaw in yaws])
    mask = (turned[..., 1] > 0.99).astype(np.float32)
    masked = turned[..., 0] * mask
    fields = np.stack([masked, mask, masked * masked], axis=1)
    values = scipy.fft.rfft2(fields, s=(size, size), workers=1)
    return Spectra(cell, middle, half, values.astype(np.complex64, copy=False))


def cells_for(*surfaces: Surface) -> tuple[float, int]:
    """Choose the side of a cell [m] and of the images [cells] that serve all of these maps."""
    cell = max(CELL * surface.scale for surface in surfaces)
    radius = max(surface.disc[1] for surface in surfaces)
    while 2 * radius / cell > MOST_CELLS:
        cell *= 2
    # Shifts with fewer than 4 cells of overlap may wrap around; they are not used.
    needed = 4 * _half(radius, cell) - 3
    return cell, next((size for size in SIZES if size >= needed), SIZES[-1])


def _half(radius: float, cell: float) -> int:
    return ceil(radius / cell) + 1


def search_motions(query: Surface, database: Surface, count: int) -> list[SE2]:
    """Find the distinct ``T_database_query`` of highest correlation, best first, to a few cells."""
    import scipy.fft  # noqa: PLC0415 - loads slowly

    if count == 0 or not query.trusted.any() or not database.trusted.any():
        return []
    cell, size = cells_for(query, database)
    query_spectra = make_spectra(query, NUM_YAWS, cell, size)
    database_spectra = make_spectra(database, 1, cell, size)
    # The conjugate of the other factor gives the mirrored correlation, but it is the larger one.
    fixed = np.conj(database_spectra.values[0])
    terrain, mask, squared = (query_spectra.values[:, k] for k in range(3))
    energy = squared * fixed[1]
    energy += mask * fixed[2]
    score = _score(
        *(
            scipy.fft.irfft2(spectrum, s=(size, size), workers=1, overwrite_x=True)
            for spectrum in (mask * fixed[1], terrain * fixed[0], energy)
        )
    )
    best = score.max(axis=0)
    motions: list[SE2] = []
    around = np.arange(-APART, APART + 1)
    while len(motions) < count:
        row, column = divmod(int(best.argmax()), size)
        if best[row, column] <= 0:
            break
        shift = -np.array([column, row])
        shift = (shift + size // 2) % size - size // 2 + query_spectra.half - database_spectra.half
        yaw = float(_yaws()[score[:, row, column].argmax()])
        offset = (
            database_spectra.middle + cell * shift - SE2(yaw=yaw).rotation @ query_spectra.middle
        )
        motions.append(SE2(float(offset[0]), float(offset[1]), yaw))
        best[np.ix_((row + around) % size, (column + around) % size)] = 0.0
    return motions


def _score(
    common: Float[Singles, "yaws size size"],
    product: Float[Singles, "yaws size size"],
    energy: Float[Singles, "yaws size size"],
) -> Float[Singles, "yaws size size"]:
    """Score every shift at every yaw, in place, by ``-log(1 - likeness²) √common``."""
    np.maximum(common, 0.0, out=common)
    # The small addition keeps flat ground and rounding errors from correlating.
    np.maximum(energy, 0.0, out=energy)
    energy += np.float32(0.06) * common
    energy += np.float32(2e-3)
    np.maximum(product, 0.0, out=product)
    product /= energy
    product *= product
    product *= 4
    np.subtract(1.0, np.minimum(product, 0.998, out=product), out=product)
    score = np.log(product, out=product)
    enough = common >= LEAST_PATCHES * np.pi / 2
    score *= -np.sqrt(common, out=common) * enough
    return score


def _yaws() -> Float[Array, "yaws"]:
    return 2 * np.pi / NUM_YAWS * np.arange(NUM_YAWS, dtype=np.float64)


def _turn(
    images: Singles, surface: Surface, middle: Array, yaw: float, cell: float, half: int
) -> Singles:
    """Rotate images about a point, and resample them to cells of another size."""
    step = cell / surface.grid.resolution
    c, s = step * cos(yaw), step * sin(yaw)
    column, row = surface.grid.to_pixel(middle[None])[0]
    onto = np.array([[c, s, column - half * (c + s)], [-s, c, row - half * (c - s)]])
    side = 2 * half + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(images, onto, (side, side), flags=flags), np.float32)
