"""Precision and recall, Eq. (7), and figures that summarise their curve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Mask, NDArray
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
    found = total - np.searchsorted(np.sort(score[positive]), at, side="left")
    precision = np.full(len(at), np.nan)
    np.divide(found, named, out=precision, where=named > 0)
    return PrecisionRecall(at, precision, found / total)


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
