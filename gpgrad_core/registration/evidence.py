"""How surprising the agreement of two reliefs is: the score of a registration."""

from dataclasses import dataclass
from math import exp, expm1, log, log1p, pi, sqrt

import cv2
import numpy as np

from gpgrad_core.registration.relief import Relief
from gpgrad_core.se2 import SE2

NUM_OCTAVES = 2
FEWEST_CELLS = 30
INLIER_WEIGHT = 2.0
"""Of log(1 + n) beside what the terrain says."""
UNRELATED_LEVEL, UNRELATED_SPREAD = 9.0, 2.6
"""Gumbel distribution of the best evidence that pairs of unrelated submaps reach."""


@dataclass(frozen=True)
class Evidence:
    """What both maps say about one motion.

    Attributes:
        patches: Overlap in patches of 2π length_scale², over which terrain is alike.
        coherences: Agreement of the terrain, an octave each from one length-scale on.
    """

    patches: float
    coherences: tuple[float, ...]


def weigh(query: Relief, database: Relief, T_database_query: SE2) -> Evidence:
    """Compare the terrain of two maps octave by octave over what they have in common.

    Both are split in the same way over the same cells, so that the edge of the overlap, which
    is not the ground's, treats them alike. The coherence ``2 Σ ab / Σ (a² + b²)`` is a
    correlation that also asks for the same height: 1 where both are the same, 0 where they
    have nothing in common.

    Args:
        query: Map to be placed.
        database: Map it is placed on.
        T_database_query: Where.
    """
    inverse, step = T_database_query.inverse(), database.grid.resolution
    corner = query.grid.to_pixel(inverse.apply(np.array([database.grid.origin])))[0]
    onto = np.column_stack([inverse.rotation * (step / query.grid.resolution), corner])
    moved = cv2.warpAffine(
        np.dstack([query.elevation, query.trusted.astype(np.float32)]),
        onto,
        database.grid.shape[::-1],
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )
    common = (moved[..., 1] > 0.999) & database.trusted
    count = int(np.count_nonzero(common))
    patches = count * step**2 / (2 * pi * database.length_scale**2)
    if count < FEWEST_CELLS:
        return Evidence(patches, (0.0,) * NUM_OCTAVES)
    rows, columns = np.flatnonzero(common.any(axis=1)), np.flatnonzero(common.any(axis=0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    common = common[box]
    pair = np.dstack([moved[..., 0][box], database.elevation[box]])
    pair = np.where(common[..., None], pair - pair[common].mean(axis=0), np.float32(0))
    weight = common.astype(np.float32)
    coherences: list[float] = []
    for octave in range(NUM_OCTAVES):
        # From 2^k to 2^(k+1) length-scales: Gaussians' variances add up.
        sigma = sqrt(3) * 2**octave * database.length_scale / step
        blurred = cv2.GaussianBlur(
            np.dstack([pair, weight]), (0, 0), sigma, borderType=cv2.BORDER_CONSTANT
        )
        share = np.maximum(blurred[..., 2:], 1e-6)
        smoother = np.where(common[..., None], blurred[..., :2] / share, np.float32(0))
        a, b = (pair - smoother)[common].astype(np.float64).T
        energy = float(a @ a + b @ b)
        coherences.append(2 * float(a @ b) / energy if energy > 0 else 0.0)
        pair = smoother
    return Evidence(patches, tuple(coherences))


def closure_score(evidence: Evidence, num_inliers: int) -> float:
    """Score a motion: -log10 of the chance that unrelated ground reaches as much.

    Over N independent patches, -N/2 log(1 - c²) is the log-likelihood ratio of Gaussian terrain
    that is coherent to c against terrain that is not. Real ground varies from place to place
    and is searched for its best fit, so that the evidence of more patches adds up as its
    scatter does: by √N. Octaves have a quarter of the patches each of the one before. So

        evidence = Σ_k √(N / 4^k) · (-log(1 - c_k²)) + w log(1 + n)

    The best that pairs of unrelated submaps reach over all motions follows a Gumbel
    distribution, alike on rough and smooth, steep and level ground: all terms are pure numbers.

    Args:
        evidence: Of the terrain.
        num_inliers: n.

    Returns:
        From 0 on; 3 means that one in a thousand unrelated pairs reaches as much.
    """
    total = INLIER_WEIGHT * log1p(num_inliers)
    for octave, coherence in enumerate(evidence.coherences):
        squared = min(max(coherence, 0.0), 0.9999) ** 2
        total += -sqrt(evidence.patches) / 2**octave * log1p(-squared)
    if evidence.patches == 0:
        return 0.0
    tail = exp(-(total - UNRELATED_LEVEL) / UNRELATED_SPREAD)
    # log10(1 - exp(-tail)), which is log10(tail) where that is small: without loss of digits.
    chance = -expm1(-tail)
    return max(0.0, -log(chance) / log(10)) if chance > 0 else 300.0
