"""The evidence that two maps show one terrain: the score of a registration."""

from dataclasses import dataclass
from math import exp, expm1, log, log1p, pi, sqrt

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.registration.overlay import overlay, smooth_between, take_warp_out
from gpgrad_core.registration.relief import Relief
from gpgrad_core.registration.uncertainty import NUM_BANDS, band_edges
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement

FEWEST_CELLS = 30
"""Fewer common cells are not compared."""
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
    laid = overlay(query, database, T_database_query)
    count, common = laid.count, laid.common
    patches = count * laid.step**2 / (2 * pi * laid.scale**2)
    if count < FEWEST_CELLS:
        return Evidence(patches, (0.0,) * NUM_BANDS)
    unknown = laid.noise[common].astype(np.float64)
    pair = take_warp_out(laid)
    log_ratios: list[float] = []
    difference = possible = relief = 0.0
    for band in range(NUM_BANDS):
        smoother = smooth_between(pair, common, band_edges(laid.scale, band), laid.step)
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


def _log_t(squared: Float[Array, "n"], variance: Float[Array, "n"]) -> Float[Array, "n"]:
    """Log density of Student's t of a squared difference, but for a constant."""
    return -0.5 * np.log(variance) - (FREEDOM + 1) / 2 * np.log1p(squared / (FREEDOM * variance))
