"""How far a figure could have come out differently with other submaps of the same ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.types import Array


@dataclass(frozen=True)
class Interval:
    """Where 95 % of the resampled figures lie."""

    low: float
    high: float

    @classmethod
    def of(cls, samples: Float[Array, "b"]) -> "Interval | None":
        """Percentiles of the samples that are numbers; None where none is."""
        finite = samples[np.isfinite(samples)]
        if len(finite) == 0:
            return None
        low, high = np.quantile(finite, [0.025, 0.975])
        return cls(float(low), float(high))


@dataclass(frozen=True, eq=False)
class Resamples:
    """The summary figures of a ranking, once a resample; NaN where none of its pairs is true."""

    average_precision: Float[Array, "b"]
    recall_at_full_precision: Float[Array, "b"]
    f1: Float[Array, "b"]


def draw_weights(pairs: TruePairs, count: int, seed: int) -> Float[Array, "b p"]:
    """Draw submaps with replacement, and say how often each pair is drawn by it.

    Pairs that share a submap are not independent: one poor cloud spoils all of its pairs. So the
    submaps are resampled, not the pairs (Snijders & Borgatti 1999), and a pair counts as often
    as the product of its submaps' counts.

    Args:
        pairs: All pairs of the dataset.
        count: Number b of resamples.
        seed: Same seed, same draws: methods are then compared on the same resamples.
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
        score: Of the judged pairs.
        positive: Which of them are true.
        weights: How often each counts, a row a resample.
    """
    order = np.argsort(-score, kind="stable")
    ranked = score[order]
    last = np.flatnonzero(np.r_[ranked[1:] != ranked[:-1], True])  # ties pass together
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
