"""Precision and recall, Eq. (7), figures that summarise their curve, and their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Mask, NDArray
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.types import Array, read_only

Counts = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class PrecisionRecall:
    """Precision and recall for each threshold; a pair passes if its score reaches the threshold.

    Attributes:
        thresholds: The thresholds (t,).
        precision: Share of the passing pairs that are true (t,); NaN if no pair passes.
        recall: Share of the true pairs that pass (t,).
    """

    thresholds: Float[Array, "t"]
    precision: Float[Array, "t"]
    recall: Float[Array, "t"]

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.thresholds, self.precision, self.recall):
            read_only(array)


def precision_recall(
    score: Float[Array, "p"],
    positive: Bool[Mask, "p"],
    thresholds: Sequence[float] | None = None,
) -> PrecisionRecall:
    """Compute precision and recall over the thresholds on a score.

        P = Tp / (Tp + Fp),  R = Tp / (Tp + Fn)    Le Gentil 2020, Eq. (7)

    Pairs of equal score pass or fail together, because any order among them would be arbitrary.

    Args:
        score: Scores of the judged pairs (p,); higher is more likely a loop closure. -inf means
            that the method did not consider the pair.
        positive: Which of them are true (p,).
        thresholds: The thresholds; None takes every score that occurs, highest first.

    Raises:
        ValueError: If no pair is true, because recall is then not defined.
    """
    total = int(np.sum(positive))
    if total == 0:
        raise ValueError("recall needs at least one positive pair")
    at = np.unique(score)[::-1] if thresholds is None else np.array(thresholds, dtype=np.float64)
    ascending = np.sort(score)
    named = len(score) - np.searchsorted(ascending, at, side="left")
    hits = total - np.searchsorted(np.sort(score[positive]), at, side="left")
    precision = np.full(len(at), np.nan)
    np.divide(hits, named, out=precision, where=named > 0)
    return PrecisionRecall(at, precision, hits / total)


def precision_by_inliers(
    num_inliers: Int[Counts, "p"], positive: Bool[Mask, "p"], most: int = 20
) -> PrecisionRecall:
    """Compute precision and recall over the paper's threshold n = 1 … most (its Fig. 9)."""
    return precision_recall(
        num_inliers.astype(np.float64), positive, [float(n) for n in range(1, most + 1)]
    )


def average_precision(curve: PrecisionRecall) -> float:
    """Compute the area under the steps of a curve over every score: Σ (R_k - R_k-1) P_k."""
    return float(np.sum(np.diff(curve.recall, prepend=0.0) * curve.precision))


def recall_at_full_precision(curve: PrecisionRecall) -> float:
    """Find the largest recall that a threshold reaches without a false pair."""
    return float(curve.recall[curve.precision == 1.0].max(initial=0.0))


def best_f1(curve: PrecisionRecall) -> tuple[float, float]:
    """Find the largest harmonic mean of precision and recall, and its threshold.

    If several thresholds reach it, the highest is taken: the fewest pairs pass it.
    """
    both = np.nan_to_num(curve.precision) + curve.recall
    product = 2 * np.nan_to_num(curve.precision) * curve.recall
    f1 = np.divide(product, both, out=np.zeros_like(product), where=both > 0)
    highest = np.flatnonzero(f1 == f1.max())
    best = highest[np.argmax(curve.thresholds[highest])]
    return float(f1[best]), float(curve.thresholds[best])


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
    hits = np.cumsum(weights * positive[order], axis=1)[:, last]
    total = hits[:, -1:]
    some = total > 0
    recall = np.divide(hits, total, out=np.full_like(hits, np.nan), where=some)
    precision = np.divide(hits, named, out=np.ones_like(hits), where=named > 0)
    steps = np.diff(recall, prepend=0.0, axis=1)
    f1 = np.divide(2 * hits, named + total, out=np.full_like(hits, np.nan), where=some)
    at_full = np.where(hits == named, recall, 0.0)
    return Resamples(
        np.sum(steps * precision, axis=1),
        np.where(some[:, 0], at_full.max(axis=1), np.nan),
        f1.max(axis=1),
    )
