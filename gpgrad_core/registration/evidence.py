"""The evidence that two maps show one terrain: the score of a registration."""

from dataclasses import dataclass
from math import exp, expm1, log, log1p, pi, sqrt

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.registration.relief import Relief
from gpgrad_core.registration.uncertainty import NUM_BANDS, band_edges
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement

FEWEST_CELLS = 30
"""Fewer common cells are not compared."""
TILT_STD, BEND_STD = 0.03, 0.005
"""How far two submaps may be tilted [rad] and bent [1/m] against each other by the drift of the
odometry that they are made with; the same as the alignment allows."""
WARP_ROUNDS = 3
"""Rounds of weighted least squares that tell the warp apart from rocks."""
WARP_CELLS = 600
"""Cells that the warp is told by: it is smooth."""
DRIFT_SHARE = 0.04
"""Share of a band's relief that drift within a submap, and a motion that is a little off, may
change. On true pairs of dense clouds the differences are 3 to 5 per cent larger than the noise
alone would make them."""
FREEDOM = 3.0
"""Degrees of freedom of Student's t, which the differences follow: ground that only one of the two
views could see, or a rock that was moved, must not decide alone."""
INLIER_WEIGHT = 3.0
"""Weight of log(1 + n) beside what the terrain says."""
BAND_WEIGHTS = (1.0, 0.5)
"""Weights of the bands. Much of the longer waves goes with the warp; what is left counts less."""
UNRELATED_LEVEL, UNRELATED_SPREAD = 0.8, 2.0
"""Gumbel distribution of the most evidence that pairs of unrelated submaps reach. Of 3,017 such
pairs of 20 sets (real and simulated; whole, thinned and noisy; flat and steep) 21 reach a score of
2, and none a score of 3; nor does a slightly wrong motion on steep smooth ground. Fits to the upper
quarter of all sets but one give levels of 1.7 to 2.3 and spreads of 2.0 to 2.2."""

Pair = Float32[NDArray[np.float32], "rows columns 2"]
Mask = Bool[NDArray[np.bool_], "rows columns"]


@dataclass(frozen=True)
class Evidence:
    """What both maps say about one motion.

    Attributes:
        patches: Overlap in patches of 2π scale², over which terrain is alike.
        log_ratios: Of each band, the mean log-likelihood ratio of one terrain against two.
        agreement: How far the heights differ, and how far they might; None if too few cells are
            common.
    """

    patches: float
    log_ratios: tuple[float, ...]
    agreement: Agreement | None = None


def weigh(query: Relief, database: Relief, T_database_query: SE2) -> Evidence:
    """Compare the terrain of two maps, band by band, over what they have in common.

    If both maps show one terrain, the difference of their heights in a band has the variance of
    what the two leave unknown there, N, and of drift. If they show two, it has that of the terrain
    itself, S, too. With w the difference over √2, and t the density of Student's t, the log ratio
    of the two likelihoods of a cell is

        log t(w; N + share² S) - log t(w; S + N)

    Agreement is rewarded by how surprising it is, and disagreement is punished by how impossible
    it is. Where N is as large as S, the ratio is near zero: noise says nothing, nor does flat
    ground. An offset, a tilt and a bend are taken out first, for submaps are warped.

    Args:
        query: Map to be placed.
        database: Map it is placed on.
        T_database_query: Where.
    """
    step = database.grid.resolution
    common, heights, noise = _overlap(query, database, T_database_query)
    count = int(np.count_nonzero(common))
    patches = count * step**2 / (2 * pi * database.scale**2)
    if count < FEWEST_CELLS:
        return Evidence(patches, (0.0,) * NUM_BANDS)
    rows, columns = np.flatnonzero(common.any(axis=1)), np.flatnonzero(common.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    common = common[box]
    unknown = noise[box][common].astype(np.float64)
    pair = _unwarped(heights[box], common, step, database.scale)
    log_ratios: list[float] = []
    difference = possible = relief = 0.0
    for band in range(NUM_BANDS):
        smoother = _smoothed(pair, common, band_edges(database.scale, band), step)
        a, b = (pair - smoother)[common].astype(np.float64).T
        pair = smoother
        squared = 0.5 * np.square(a - b)
        signal = 0.5 * float(a @ a + b @ b) / count
        of_one = unknown[:, band] + DRIFT_SHARE**2 * signal + 1e-8
        of_two = unknown[:, band] + signal + 1e-8
        log_ratios.append(float(np.mean(_log_t(squared, of_one) - _log_t(squared, of_two))))
        difference += 2 * float(np.median(squared)) / 0.455
        possible += 2 * float(np.mean(of_one))
        relief += signal
    told = Agreement(sqrt(difference), sqrt(possible), sqrt(relief))
    return Evidence(patches, tuple(log_ratios), told)


def closure_score(evidence: Evidence, num_inliers: int) -> float:
    """Score a motion: -log10 of the chance that unrelated ground reaches as much evidence.

    Patches of terrain would add up their log ratios if they were independent. But ground varies
    from place to place, and each motion is the best of many: the sum over N patches scatters by
    √N, so that it is the mean ratio times √N which means the same for every overlap. A band has a
    quarter of the patches of the one before.

        evidence = Σ_k weight_k √(N / 4^k) log_ratio_k + weight log(1 + n)

    The most that pairs of unrelated submaps reach over all motions follows a Gumbel distribution.

    Args:
        evidence: Of the terrain.
        num_inliers: n.

    Returns:
        From 0 on; 3 means that one in a thousand unrelated pairs reaches as much.
    """
    if evidence.agreement is None:
        return 0.0
    total = total_evidence(evidence, num_inliers)
    tail = exp(min(-(total - UNRELATED_LEVEL) / UNRELATED_SPREAD, 700.0))
    # log10(1 - exp(-tail)), which is log10(tail) where that is small: without loss of digits.
    chance = -expm1(-tail)
    return max(0.0, -log(chance) / log(10)) if chance > 0 else 300.0


def total_evidence(evidence: Evidence, num_inliers: int) -> float:
    """Add up what `closure_score` turns into a score."""
    total = INLIER_WEIGHT * log1p(num_inliers)
    for band, (weight, ratio) in enumerate(zip(BAND_WEIGHTS, evidence.log_ratios, strict=True)):
        total += weight * sqrt(evidence.patches) / 2**band * ratio
    return total


def _overlap(
    query: Relief, database: Relief, T_database_query: SE2
) -> tuple[Mask, Pair, Float32[NDArray[np.float32], "rows columns bands"]]:
    """Lay the query on the database's cells.

    Returns:
        Which cells both maps trust, the heights of both [m], and half the variance of what both
        leave unknown of each band [m²].
    """
    inverse, step = T_database_query.inverse(), database.grid.resolution
    corner = query.grid.to_pixel(inverse.apply(np.array([database.grid.origin])))[0]
    onto = np.column_stack([inverse.rotation * (step / query.grid.resolution), corner])
    moved = cv2.warpAffine(
        np.dstack([query.elevation, query.trusted.astype(np.float32), query.noise]),
        onto,
        database.grid.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    common = (moved[..., 1] > 0.999) & database.trusted
    heights = np.asarray(np.dstack([moved[..., 0], database.elevation]), np.float32)
    noise = np.float32(0.5) * (moved[..., 2:] + database.noise)
    return common, heights, np.asarray(noise, np.float32)


def _unwarped(heights: Pair, common: Mask, step: float, scale: float) -> Pair:
    """Take offset, tilt and bend of the difference out, half from each, and the mean from both."""
    row, column = np.nonzero(common)
    x, y = (column - column.mean()) * step, (row - row.mean()) * step
    bends = np.stack([x * x, x * y, y * y])
    columns = np.vstack([np.ones((1, len(x))), x, y, bends - bends.mean(axis=1, keepdims=True)])
    precision = np.array([0.0] + 2 * [TILT_STD**-2] + 3 * [BEND_STD**-2])
    both = heights[common].astype(np.float64)
    every = max(1, len(x) // WARP_CELLS)
    some, difference = columns[:, ::every], (both[:, 0] - both[:, 1])[::every]
    left = difference - np.median(difference)
    cells_a_patch = max(1.0, 2 * pi * scale**2 / (every * step**2))
    coefficients = np.zeros(len(precision))
    weight = np.ones_like(difference)
    for _ in range(WARP_ROUNDS):
        variance = float(np.median(left * left)) / 0.455 + 1e-12
        weighed = some * weight
        normal = weighed @ some.T
        normal += np.diag(precision * variance * cells_a_patch + 1e-9 * np.diagonal(normal))
        coefficients = np.linalg.solve(normal, weighed @ difference)
        left = difference - coefficients @ some
        weight = 1 / (1 + left * left / variance)
    warp = coefficients @ columns
    both[:, 0] -= warp / 2
    both[:, 1] += warp / 2
    flat = np.zeros_like(heights)
    flat[common] = both - both.mean(axis=0)
    return flat


def _smoothed(pair: Pair, common: Mask, edges: tuple[float, float], step: float) -> Pair:
    """Smooth from the finer edge of a band to the coarser one: the variances add up."""
    fine, coarse = edges
    weight = common.astype(np.float32)
    blurred = cv2.GaussianBlur(
        np.dstack([pair, weight]),
        (0, 0),
        sqrt(coarse**2 - fine**2) / step,
        borderType=cv2.BORDER_CONSTANT,
    )
    share = np.maximum(blurred[..., 2:], 1e-6)
    return np.where(common[..., None], blurred[..., :2] / share, np.float32(0))


def _log_t(squared: Float[Array, "n"], variance: Float[Array, "n"]) -> Float[Array, "n"]:
    """Log density of Student's t of a squared difference, but for a constant."""
    return -0.5 * np.log(variance) - (FREEDOM + 1) / 2 * np.log1p(squared / (FREEDOM * variance))
