"""A method's ranking of the pairs, its precision and recall, Eq. (7), and their intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import Mask, NDArray
from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, Dataset, LoopClosure, read_only

Counts = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Ranking:
    """A method's verdicts on all pairs that can be judged."""

    # the score by which the method ranks each pair (p,); -inf for a pair that it does not list
    score: Float[Array, "p"]
    num_inliers: Int[NDArray[np.intp], "p"]  # number of inliers of each pair (p,), the paper's n
    accepted: Bool[NDArray[np.bool_], "p"]  # which pairs it accepts as loop closures (p,)
    T_database_query: tuple[SE2 | None, ...]  # the motion of each pair; None if there is none
    # time of each stage [s], as far as it is known
    seconds: dict[str, float] = field(default_factory=dict[str, float])
    notes: tuple[str, ...] = ()  # what had to be assumed, one line each

    def __post_init__(self) -> None:
        read_only(self.score, self.num_inliers, self.accepted)


def rank_pairs(
    detection: DetectionResult | ClosureReport, dataset: Dataset, pairs: TruePairs, name: str
) -> Ranking:
    """Sort a method's verdicts, in either direction, as the true pairs are."""
    ids = {submap.id for submap in dataset.submaps}
    score = np.full(len(pairs), -np.inf)
    num_inliers = np.zeros(len(pairs), dtype=np.intp)
    accepted = np.zeros(len(pairs), dtype=np.bool_)
    motions: list[SE2 | None] = [None] * len(pairs)
    listed: set[frozenset[str]] = set()
    closures = detection.pairs if isinstance(detection, ClosureReport) else detection.closures
    for closure in closures:
        both, registration = frozenset(closure.pair), closure.registration
        _check(closure, both, ids, listed, dataset.name, name)
        listed.add(both)
        row = pairs.rows.get(both)
        if row is None:
            continue  # a submap without a true pose, which the notes of the true pairs name
        score[row], num_inliers[row] = registration.score, registration.num_inliers
        accepted[row] = closure.accepted
        motion = registration.T_database_query
        turned_about = closure.query_id != pairs.ids[pairs.query[row]]
        motions[row] = motion.inverse() if motion and turned_about else motion
    unlisted = int(np.sum(np.isneginf(score)))
    notes = (
        (f"{name} lists {len(pairs) - unlisted} of {len(pairs)} pairs: the others rank last",)
        if unlisted
        else ()
    )
    return Ranking(score, num_inliers, accepted, tuple(motions), dict(detection.seconds), notes)


def _check(
    closure: LoopClosure,
    both: frozenset[str],
    ids: set[str],
    listed: set[frozenset[str]],
    dataset: str,
    name: str,
) -> None:
    pair, score = f"{name}: pair {', '.join(closure.pair)}", closure.registration.score
    for strange in sorted(both - ids):
        raise InputError(
            f"{pair}: {dataset} has no submap {strange!r}; evaluate it on the dataset that it was "
            "made from"
        )
    if len(both) == 1:
        raise InputError(f"{pair}: a submap cannot close a loop with itself; leave the pair out")
    if both in listed:
        raise InputError(f"{pair}: is listed twice; list every pair once")
    if not np.isfinite(score):
        raise InputError(f"{pair}: the score must be a finite number, got {score!r}")


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
        read_only(self.thresholds, self.precision, self.recall)


def precision_recall(
    score: Float[Array, "p"],
    positive: Bool[Mask, "p"],
    thresholds: Sequence[float] | None = None,
) -> PrecisionRecall:
    """Compute precision and recall over the thresholds on a score.

        P = Tp / (Tp + Fp),  R = Tp / (Tp + Fn)    Le Gentil 2020, Eq. (7)

    Pairs of equal score pass or fail together, because any order among them would be arbitrary. A
    higher score is more likely a loop closure; -inf means that the method did not consider the
    pair. Without thresholds, every score that occurs is taken, highest first.

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
    """Find the largest harmonic mean of precision and recall, and its highest threshold."""
    both = np.nan_to_num(curve.precision) + curve.recall
    product = 2 * np.nan_to_num(curve.precision) * curve.recall
    f1 = np.divide(product, both, out=np.zeros_like(product), where=both > 0)
    highest = np.flatnonzero(f1 == f1.max())
    best = highest[np.argmax(curve.thresholds[highest])]
    return float(f1[best]), float(curve.thresholds[best])


@dataclass(frozen=True)
class Interval:
    """The interval in which 95 % of the resampled figures lie."""

    low: float  # lower end
    high: float  # upper end

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
    """The summary figures of a ranking in each resample; NaN if none of its pairs is true."""

    average_precision: Float[Array, "b"]  # average precision (b,)
    recall_at_full_precision: Float[Array, "b"]  # recall at full precision (b,)
    f1: Float[Array, "b"]  # best F1 (b,)


def draw_weights(pairs: TruePairs, count: int, seed: int) -> Float[Array, "b p"]:
    """Draw submaps with replacement, and count how often each pair is drawn.

    Pairs that share a submap are not independent: one poor cloud spoils all of its pairs. So the
    submaps are resampled, not the pairs (Snijders & Borgatti 1999), and a pair counts as often as
    the product of its submaps' counts. The same seed gives the same draws, so that methods are
    compared on the same resamples.
    """
    rng = np.random.default_rng(seed)
    num = len(pairs.ids)
    drawn = rng.multinomial(num, np.full(num, 1 / num), size=count).astype(np.float64)
    return drawn[:, pairs.query] * drawn[:, pairs.database]


def resample(
    score: Float[Array, "p"], positive: Bool[Mask, "p"], weights: Float[Array, "b p"]
) -> Resamples:
    """Compute the summary figures of a ranking; weights are of each pair in each resample."""
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
