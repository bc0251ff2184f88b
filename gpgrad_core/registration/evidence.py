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
"""Smallest number of common cells that are compared."""
TILT_STD, BEND_STD = 0.03, 0.005
"""Standard deviations of the tilt [rad] and the bend [1/m] between two submaps, which drift brings
about while they are built. They are the same as in the alignment."""
WARP_ROUNDS = 3
"""Rounds of weighted least squares, which separate the warp from rocks."""
WARP_CELLS = 600
"""Number of cells that the warp is fitted to; it is smooth, so a few are enough."""
DRIFT_SHARE = 0.04
"""Share of a band's relief that drift within a submap and a slightly wrong motion may change. On
true pairs of dense clouds the differences are 3 to 5 per cent larger than noise alone makes
them."""
FREEDOM = 3.0
"""Degrees of freedom of Student's t, the distribution of the differences. Its long tails keep a
rock that was moved, or ground that only one of the views saw, from deciding alone."""
INLIER_WEIGHT = 3.0
"""Weight of log(1 + n), for n inliers, relative to the terrain's evidence."""
BAND_WEIGHTS = (1.0, 0.5)
"""Weights of the bands. The second counts less, because the warp absorbs much of its waves."""
UNRELATED_LEVEL, UNRELATED_SPREAD = 0.8, 2.0
"""Level and spread of the Gumbel distribution of the highest evidence of unrelated pairs. Of 3,017
such pairs of 20 datasets (real and simulated; whole, thinned and noisy; flat and steep) 21 reach a
score of 2 and none reaches 3. Slightly wrong motions on steep smooth ground do not reach 3 either.
Fits to the upper quarter of all datasets but one give levels of 1.7 to 2.3 and spreads of 2.0 to
2.2."""

Pair = Float32[NDArray[np.float32], "rows columns 2"]
Mask = Bool[NDArray[np.bool_], "rows columns"]


@dataclass(frozen=True)
class Evidence:
    """What both maps say about one motion.

    Attributes:
        patches: Area of the overlap in patches of 2π scale². Within a patch terrain is alike.
        log_ratios: For each band, the mean log-likelihood ratio of one terrain against two.
        agreement: How well the heights agree; None if too few cells are common.
    """

    patches: float
    log_ratios: tuple[float, ...]
    agreement: Agreement | None = None


def weigh(query: Relief, database: Relief, T_database_query: SE2) -> Evidence:
    """Compare the terrain of two maps over their overlap, band by band.

    If both maps show one terrain, the difference of their heights in a band has the variance of
    the uncertainty of both, N, and of drift. If they show two terrains, the variance S of the
    terrain itself is added. With w the difference divided by √2, and t the density of Student's
    t, the log ratio of the two likelihoods of a cell is

        log t(w; N + share² S) - log t(w; S + N)

    So agreement counts by how surprising it is, and disagreement by how impossible it is. Where
    N is as large as S, the ratio is near zero: neither noise nor flat ground says anything. An
    offset, a tilt and a bend are removed first, because submaps are warped.

    Args:
        query: The map to be placed.
        database: The map on which it is placed.
        T_database_query: The motion to judge.

    Returns:
        The evidence; its log ratios are 0 if fewer than `FEWEST_CELLS` cells are common.
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
    agreement = Agreement(sqrt(difference), sqrt(possible), sqrt(relief))
    return Evidence(patches, tuple(log_ratios), agreement)


def closure_score(evidence: Evidence, num_inliers: int) -> float:
    """Score a motion: -log10 of the probability that unrelated ground reaches as much evidence.

    If patches of terrain were independent, their log ratios would add up. But ground varies from
    place to place, and each motion is the best of many, so the sum over N patches scatters by √N.
    Therefore the mean ratio times √N means the same for every overlap. Each band has a quarter
    of the patches of the band before.

        evidence = Σ_k weight_k √(N / 4^k) log_ratio_k + weight log(1 + n)

    The highest evidence that a pair of unrelated submaps reaches over all motions follows a
    Gumbel distribution.

    Args:
        evidence: The evidence of the terrain.
        num_inliers: Number of inliers n.

    Returns:
        The score, at least 0. One in 1000 unrelated pairs reaches a score of 3.
    """
    if evidence.agreement is None:
        return 0.0
    total = total_evidence(evidence, num_inliers)
    tail = exp(min(-(total - UNRELATED_LEVEL) / UNRELATED_SPREAD, 700.0))
    # log10(1 - exp(-tail)) without a loss of digits where the tail is small.
    chance = -expm1(-tail)
    return max(0.0, -log(chance) / log(10)) if chance > 0 else 300.0


def total_evidence(evidence: Evidence, num_inliers: int) -> float:
    """Add up the evidence that `closure_score` converts to a score."""
    total = INLIER_WEIGHT * log1p(num_inliers)
    for band, (weight, ratio) in enumerate(zip(BAND_WEIGHTS, evidence.log_ratios, strict=True)):
        total += weight * sqrt(evidence.patches) / 2**band * ratio
    return total


def _overlap(
    query: Relief, database: Relief, T_database_query: SE2
) -> tuple[Mask, Pair, Float32[NDArray[np.float32], "rows columns bands"]]:
    """Resample the query on the database's cells.

    Returns:
        Which cells both maps trust; the heights of both [m]; and half the variance of the
        uncertainty of both in each band [m²].
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
    """Remove the offset, tilt and bend of the difference, half from each map, and the mean."""
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
    """Smooth from the finer edge of a band to the coarser one; variances of Gaussians add up."""
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
    """Log density of Student's t of a squared difference, without the constant."""
    return -0.5 * np.log(variance) - (FREEDOM + 1) / 2 * np.log1p(squared / (FREEDOM * variance))
