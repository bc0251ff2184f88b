"""Confidence intervals of the figures, from resamples of the submaps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.types import Array


@dataclass(frozen=True)
class Interval:
    """The interval in which 95 % of the resampled figures lie.

    Attributes:
        low: Lower end.
        high: Upper end.
    """

    low: float
    high: float

    @classmethod
    def of(cls, samples: Float[Array, "b"]) -> "Interval | None":
        """Make the interval from samples; NaN samples are ignored. None if all of them are NaN."""
        finite = samples[np.isfinite(samples)]
        if len(finite) == 0:
            return None
        low, high = np.quantile(finite, [0.025, 0.975])
        return cls(float(low), float(high))


@dataclass(frozen=True, eq=False)
class Resamples:
    """The summary figures of a ranking in each resample; NaN if none of its pairs is true.

    Attributes:
        average_precision: Average precision (b,).
        recall_at_full_precision: Recall at full precision (b,).
        f1: Best F1 (b,).
    """

    average_precision: Float[Array, "b"]
    recall_at_full_precision: Float[Array, "b"]
    f1: Float[Array, "b"]


def draw_weights(pairs: TruePairs, count: int, seed: int) -> Float[Array, "b p"]:
    """Draw submaps with replacement, and count how often each pair is drawn.

    Pairs that share a submap are not independent: one poor cloud spoils all of its pairs. So the
    submaps are resampled, not the pairs (Snijders & Borgatti 1999), and a pair counts as often
    as the product of its submaps' counts.

    Args:
        pairs: All pairs of the dataset.
        count: Number b of resamples.
        seed: Seed of the draws. The same seed gives the same draws, so that methods are compared
            on the same resamples.

    Returns:
        The weight of each pair in each resample (b, p).
    """
    rng = np.random.default_rng(seed)
    num = len(pairs.ids)
    drawn = rng.multinomial(num, np.full(num, 1 / num), size=count).astype(np.float64)
    return drawn[:, pairs.query] * drawn[:, pairs.database]


def resample(
    score: Float[Array, "p"], positive: Bool[Mask, "p"], weights: Float[Array, "b p"]
) -> Resamples:
    """Compute the summary figures of a ranking on weighted pairs.

    Args:
        score: Scores of the judged pairs (p,).
        positive: Which of them are true (p,).
        weights: How often each pair counts in each resample (b, p).
    """
    order = np.argsort(-score, kind="stable")
    ranked = score[order]
    last = np.flatnonzero(np.r_[ranked[1:] != ranked[:-1], True])  # equal scores pass together
    weights = weights[:, order]
    named = np.cumsum(weights, axis=1)[:, last]
    found = np.cumsum(weights * positive[order], axis=1)[:, last]
    total = found[:, -1:]
    some = total > 0
    recall = np.divide(found, total, out=np.full_like(found, np.nan), where=some)
    precision = np.divide(found, named, out=np.ones_like(found), where=named > 0)
    steps = np.diff(recall, prepend=0.0, axis=1)
    f1 = np.divide(2 * found, named + total, out=np.full_like(found, np.nan), where=some)
    at_full = np.where(found == named, recall, 0.0)
    return Resamples(
        np.sum(steps * precision, axis=1),
        np.where(some[:, 0], at_full.max(axis=1), np.nan),
        f1.max(axis=1),
    )
