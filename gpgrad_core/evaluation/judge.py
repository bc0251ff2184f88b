"""Judge detections by the truth: the verb `evaluate`."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from math import radians

import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.bootstrap import Interval, Resamples, draw_weights, resample
from gpgrad_core.evaluation.overlap import TruePairs, measure_pairs
from gpgrad_core.evaluation.pose_error import (
    Bin,
    PoseErrors,
    PoseErrorSummary,
    break_down,
    pose_errors,
    summarise_errors,
)
from gpgrad_core.evaluation.precision_recall import (
    PrecisionRecall,
    average_precision,
    best_f1,
    precision_by_inliers,
    precision_recall,
    recall_at_full_precision,
)
from gpgrad_core.evaluation.ranking import Ranking, rank_pairs
from gpgrad_core.evaluation.rules import EvaluationParams, Labels, Rule
from gpgrad_core.outputs import ClosureReport
from gpgrad_core.pipeline import DetectionResult
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import Array, Dataset

OVERLAP_EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0)
YAW_EDGES = tuple(np.radians([0.0, 30.0, 60.0, 120.0, 150.0, 180.0]).tolist())


@dataclass(frozen=True)
class Summary:
    """A figure with what resampling the submaps makes of it; None without resamples."""

    value: float
    interval: Interval | None = None


@dataclass(frozen=True, eq=False)
class Ranked:
    """How well a method ranks the pairs; needs at least one true pair.

    Attributes:
        by_score: Precision and recall at every score that occurs.
        by_inliers: The same at n = 1 … 20 inliers.
        average_precision: Area under `by_score`.
        recall_at_full_precision: Most that is found before the first wrong match.
        f1: Best harmonic mean of precision and recall, over the score.
        f1_threshold: The score at which it is reached.
        average_precision_by_inliers: As `average_precision`, ranked by inliers alone.
        recall_at_full_precision_by_inliers: As `recall_at_full_precision`, by inliers alone.
        lead: By how much the first method's average precision is above this one's, on the same
            resamples; None for the first.
    """

    by_score: PrecisionRecall
    by_inliers: PrecisionRecall
    average_precision: Summary
    recall_at_full_precision: Summary
    f1: Summary
    f1_threshold: float
    average_precision_by_inliers: float
    recall_at_full_precision_by_inliers: float
    lead: Summary | None = None


@dataclass(frozen=True, eq=False)
class RuleVerdict:
    """How a method does by one rule.

    Attributes:
        ranked: Of its ranking; None where the rule calls no pair true.
        accepted_true: Accepted pairs that are true.
        accepted_false: Accepted pairs that are false.
        accepted_grey: Accepted pairs that the rule leaves between.
        accepted_grey_near: Of these, how many are placed right all the same.
        missed: True pairs that are not accepted.
        near: Share of all true pairs whose motion is right, accepted or not; None without any.
        pose_error: Of the accepted true pairs.
        by_overlap: What became of the touching pairs, by the overlap that the rule looks at.
        by_yaw: What became of the true pairs, by how far the submaps are turned [rad].
    """

    ranked: Ranked | None
    accepted_true: int
    accepted_false: int
    accepted_grey: int
    accepted_grey_near: int
    missed: int
    near: float | None
    pose_error: PoseErrorSummary
    by_overlap: tuple[Bin, ...]
    by_yaw: tuple[Bin, ...]


@dataclass(frozen=True)
class Accepted:
    """What became of the accepted pairs, neighbours left out: a closure is its motion.

    Attributes:
        right: The motion is right, as far as the submaps touch.
        wrong_motion: The surfaces touch, but the motion is not right.
        no_overlap: The surfaces have nothing in common.
    """

    right: int
    wrong_motion: int
    no_overlap: int

    @property
    def count(self) -> int:
        """All of them."""
        return self.right + self.wrong_motion + self.no_overlap


@dataclass(frozen=True, eq=False)
class MethodVerdict:
    """All that is known of one method on one dataset."""

    name: str
    ranking: Ranking
    errors: PoseErrors
    accepted: Accepted
    rules: tuple[RuleVerdict, ...]  # as the evaluation's rules


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All methods on one dataset.

    Attributes:
        dataset: Its name.
        pairs: The truth.
        params: What was judged by.
        seed: Of the resamples.
        rules: When a pair is true; every figure holds for one of them.
        labels: What each rule says of the pairs.
        methods: The verdicts, in the order given; the first is what the others are set against.
    """

    dataset: str
    pairs: TruePairs
    params: EvaluationParams
    seed: int
    rules: tuple[Rule, ...]
    labels: tuple[Labels, ...]
    methods: tuple[MethodVerdict, ...]

    @property
    def file_names(self) -> tuple[str, ...]:
        """Names of the methods that are fit for files, each only once."""
        names: list[str] = []
        for method in self.methods:
            plain = re.sub(r"[^\w-]+", "_", method.name).strip("_") or "method"
            name = next(one for one in _numbered(plain) if one not in names)
            names.append(name)
        return tuple(names)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or assumed, a line each."""
        return self.pairs.notes + tuple(note for one in self.methods for note in one.ranking.notes)


def evaluate(
    dataset: Dataset,
    detections: Mapping[str, DetectionResult | ClosureReport],
    params: EvaluationParams | None = None,
    *,
    pairs: TruePairs | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Evaluation:
    """Judge what methods found on a dataset by its true poses.

    Args:
        dataset: With true poses.
        detections: What each method found, by its name: results of `detect_loop_closures`, or
            what `read_closures` read from any tool's file.
        params: What to judge by.
        pairs: What `measure_pairs` says of the dataset, if it is known already.
        seed: Of the resamples that the intervals are made from.
        progress: Called as the overlaps are measured; may raise Cancelled.

    Raises:
        InputError: If the dataset has no true poses, no detection is given, or one does not fit
            the dataset; see `rank_pairs`.
    """
    params = params or EvaluationParams()
    if not detections:
        raise InputError("nothing to evaluate: give at least one method or file of closures")
    pairs = pairs or measure_pairs(dataset, progress)
    rankings = {
        name: rank_pairs(detection, dataset, pairs, name) for name, detection in detections.items()
    }
    errors = {
        name: pose_errors(
            ranking.T_database_query,
            pairs.T_database_query,
            params.max_offset_error,
            radians(params.max_turn_error),
        )
        for name, ranking in rankings.items()
    }
    weights = draw_weights(pairs, params.num_resamples, seed)
    labels = tuple(rule.label(pairs) for rule in params.rules)
    by_rule = [_rank_all(rankings, label, weights) for label in labels]
    methods = tuple(
        MethodVerdict(
            name,
            ranking,
            errors[name],
            _accepted(ranking, errors[name], pairs, params.neighbours),
            tuple(
                _judge(ranked[name], ranking, errors[name], rule, label, pairs)
                for ranked, rule, label in zip(by_rule, params.rules, labels, strict=True)
            ),
        )
        for name, ranking in rankings.items()
    )
    return Evaluation(dataset.name, pairs, params, seed, params.rules, labels, methods)


def _accepted(ranking: Ranking, errors: PoseErrors, pairs: TruePairs, neighbours: int) -> Accepted:
    """Sort what a method accepts by what a pose graph would make of it."""
    accepted = ranking.accepted & (pairs.steps > neighbours)
    touching = pairs.surface_overlap > 0
    return Accepted(
        right=int(np.sum(accepted & touching & errors.near)),
        wrong_motion=int(np.sum(accepted & touching & ~errors.near)),
        no_overlap=int(np.sum(accepted & ~touching)),
    )


def _rank_all(
    rankings: Mapping[str, Ranking], labels: Labels, weights: Float[Array, "b p"]
) -> dict[str, Ranked | None]:
    """Rank by one rule; all methods on the same resamples, so that they can be compared."""
    ranked: dict[str, Ranked | None] = dict.fromkeys(rankings)
    if not labels.positive.any():
        return ranked
    judged = labels.judged
    positive = labels.positive[judged]
    first: tuple[float, Resamples] | None = None
    for name, ranking in rankings.items():
        curve = precision_recall(ranking.score[judged], positive)
        inliers = ranking.num_inliers[judged]
        curve_by_inliers = precision_recall(inliers.astype(np.float64), positive)
        samples = resample(ranking.score[judged], positive, weights[:, judged])
        average = average_precision(curve)
        f1, f1_threshold = best_f1(curve)
        lead = None
        if first is None:
            first = average, samples
        else:
            behind = first[1].average_precision - samples.average_precision
            lead = Summary(first[0] - average, Interval.of(behind))
        ranked[name] = Ranked(
            curve,
            precision_by_inliers(inliers, positive),
            Summary(average, Interval.of(samples.average_precision)),
            Summary(recall_at_full_precision(curve), Interval.of(samples.recall_at_full_precision)),
            Summary(f1, Interval.of(samples.f1)),
            f1_threshold,
            average_precision(curve_by_inliers),
            recall_at_full_precision(curve_by_inliers),
            lead,
        )
    return ranked


def _judge(
    ranked: Ranked | None,
    ranking: Ranking,
    errors: PoseErrors,
    rule: Rule,
    labels: Labels,
    pairs: TruePairs,
) -> RuleVerdict:
    accepted, positive = ranking.accepted, labels.positive
    touching = (pairs.box_iou > 0) & (pairs.steps > rule.neighbours)
    return RuleVerdict(
        ranked=ranked,
        accepted_true=int(np.sum(accepted & positive)),
        accepted_false=int(np.sum(accepted & labels.negative)),
        accepted_grey=int(np.sum(accepted & labels.grey)),
        accepted_grey_near=int(np.sum(accepted & labels.grey & errors.near)),
        missed=int(np.sum(positive & ~accepted)),
        near=float(np.mean(errors.near[positive])) if positive.any() else None,
        pose_error=summarise_errors(errors, accepted & positive),
        by_overlap=break_down(rule.measured(pairs), OVERLAP_EDGES, touching, accepted, errors),
        by_yaw=break_down(np.abs(pairs.relative_yaw), YAW_EDGES, positive, accepted, errors),
    )


def _numbered(name: str) -> Iterator[str]:
    yield name
    yield from (f"{name}_{k}" for k in count(2))
