"""Judges detections by the true poses: the function `evaluate`."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import radians
from typing import Literal

import numpy as np
from jaxtyping import Float

from gpgrad_core.detection import DetectionResult
from gpgrad_core.display import card
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.overlap import TruePairs, measure_pairs
from gpgrad_core.evaluation.precision_recall import (
    Interval,
    PrecisionRecall,
    Ranking,
    Resamples,
    average_precision,
    best_f1,
    draw_weights,
    precision_by_inliers,
    precision_recall,
    rank_pairs,
    recall_at_full_precision,
    resample,
)
from gpgrad_core.evaluation.rules import (
    Bin,
    EvaluationParams,
    Labels,
    PoseErrors,
    PoseErrorSummary,
    Rule,
    break_down,
    classify_motions,
    pose_errors,
    summarise_errors,
)
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.reading.paths import file_names
from gpgrad_core.run import Progress, silent
from gpgrad_core.types import Array, Dataset


@dataclass(frozen=True)
class Summary:
    """A figure with its confidence interval."""

    value: float
    interval: Interval | None = None  # over resamples of the submaps; None without resamples

    def text(self, *, sign: Literal["", "+"] = "") -> str:
        """Write the figure, and its interval if there is one; with ``+`` a sign before each.

        >>> Summary(0.5).text(), Summary(0.5, Interval(0.25, 0.75)).text(sign="+")
        ('0.500', '+0.500 [+0.25, +0.75]')
        """
        if self.interval is None:
            return f"{self.value:{sign}.3f}"
        low, high = self.interval.low, self.interval.high
        return f"{self.value:{sign}.3f} [{low:{sign}.2f}, {high:{sign}.2f}]"


@dataclass(frozen=True)
class BestF1(Summary):
    """The largest harmonic mean of precision and recall."""

    threshold: float = 0.0  # the score at which it is reached


@dataclass(frozen=True, eq=False)
class Ranked:
    """How well a method ranks the pairs, if at least one of them is true."""

    average_precision: Summary  # area under `by_score`
    recall_at_full_precision: Summary  # largest recall without a false pair
    f1: BestF1  # largest harmonic mean of precision and recall over all scores
    # the first method's average precision minus this one's, on the same resamples; None for the
    # first method
    lead: Summary | None
    average_precision_by_inliers: float  # average precision of the ranking by inliers alone
    recall_at_full_precision_by_inliers: float  # recall at full precision by inliers alone
    by_score: PrecisionRecall  # precision and recall at every score that occurs
    by_inliers: PrecisionRecall  # precision and recall at n = 1 … 20 inliers


@dataclass(frozen=True, eq=False)
class RuleVerdict:
    """The results of a method under one rule."""

    accepted_true: int  # number of accepted pairs that are true
    accepted_false: int  # number of accepted pairs that are false
    accepted_grey: int  # number of accepted pairs that the rule leaves out as grey
    accepted_grey_near: int  # number of those whose motion is right
    missed: int  # number of true pairs that are not accepted
    # share of all true pairs whose motion is right, accepted or not; None if there is no true pair
    near: float | None
    pose_error: PoseErrorSummary  # errors of the accepted true pairs
    # counts of the touching pairs, by the overlap that the rule measures
    by_overlap: tuple[Bin, ...]
    by_yaw: tuple[Bin, ...]  # counts of the true pairs, by the relative yaw of the submaps [rad]
    ranked: Ranked | None  # results of its ranking; None if the rule calls no pair true


@dataclass(frozen=True)
class Accepted:
    """Counts of the accepted pairs by their motion, without neighbours."""

    right: int  # number of pairs whose surfaces touch and whose motion is right
    wrong_motion: int  # number of pairs whose surfaces touch, but whose motion is wrong
    no_overlap: int  # number of pairs whose surfaces do not touch

    @property
    def count(self) -> int:
        return self.right + self.wrong_motion + self.no_overlap


@dataclass(frozen=True, eq=False)
class MethodVerdict:
    """All results of one method on one dataset."""

    name: str  # name of the method
    ranking: Ranking  # its verdicts on all pairs
    errors: PoseErrors  # the errors of its motions
    accepted: Accepted  # counts of its accepted pairs
    # its results under each rule, in the order of the evaluation's rules
    rules: tuple[RuleVerdict, ...]

    @property
    def in_numbers(self) -> dict[str, float | None]:
        """Its results by the first rule, by their names."""
        verdict = self.rules[0]
        ranked = verdict.ranked
        return {
            "average_precision": None if ranked is None else float(ranked.average_precision.value),
            "recall_at_full_precision": None
            if ranked is None
            else float(ranked.recall_at_full_precision.value),
            "accepted_true": verdict.accepted_true,
            "accepted_false": verdict.accepted_false,
            "missed": verdict.missed,
        }


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All results of all methods on one dataset.

    Attributes:
        dataset: Name of the dataset.
        pairs: What the true poses say about every pair.
        params: Parameters of the evaluation.
        seed: Seed of the resamples.
        rules: When a pair is true; every figure belongs to one of these rules.
        labels: The labels that each rule gives the pairs.
        methods: The results, in the order of the detections; all are compared with the first.
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
        """Names of the methods as parts of file names, all different."""
        return file_names((method.name for method in self.methods), "method")

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out or assumed, one line each."""
        return self.pairs.notes + tuple(
            note for method in self.methods for note in method.ranking.notes
        )

    def _repr_html_(self) -> str:
        head = ["method", "AP", "R100", "accepted true", "accepted false", "missed"]
        rows: list[list[str]] = []
        for method in self.methods:
            verdict, shares = method.rules[0], ["n/a", "n/a"]
            if ranked := verdict.ranked:
                shares = [ranked.average_precision.text(), ranked.recall_at_full_precision.text()]
            counts = (verdict.accepted_true, verdict.accepted_false, verdict.missed)
            rows.append([method.name, *shares, *map(str, counts)])
        return card(
            f"Evaluation on {self.dataset}",
            table=[head, *rows],
            note=self.rules[0].statement,
        )


def evaluate(
    dataset: Dataset,
    detections: Mapping[str, DetectionResult | ClosureReport],
    params: EvaluationParams | None = None,
    *,
    pairs: TruePairs | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Evaluation:
    """Judge the detections of methods on a dataset by its true poses.

    Precision and recall are Eq. (7) of Le Gentil 2020, and the overlap of boxes is Eq. (8).

    Args:
        dataset: A dataset with true poses.
        detections: The detections of each method by its name: results of `detect_loop_closures`,
            or files of any tool, read with `read_closures`.
        params: Parameters of the evaluation.
        pairs: The result of `measure_pairs` for the dataset, if it is known already.
        seed: Seed of the resamples for the intervals.
        progress: Called with the fraction done while overlaps are measured; may raise Cancelled.

    Raises:
        InputError: If the dataset has no true poses, if no detection is given, or if one does not
            fit the dataset; see `rank_pairs`.
    """
    params = params or EvaluationParams()
    if not detections:
        raise InputError("nothing to evaluate: give at least one method or file of closures")
    pairs = pairs or measure_pairs(dataset, progress)
    if pairs.positions_only:
        params = replace(params, max_turn_error=180.0)
    rankings = {
        name: rank_pairs(detection, dataset, pairs, name) for name, detection in detections.items()
    }
    errors = {
        name: pose_errors(
            ranking.T_database_query,
            pairs.T_database_query,
            params.max_offset_error,
            radians(params.max_turn_error),
            centres=pairs.centres[pairs.query],
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
    """Count the accepted pairs by what they would do to a pose graph."""
    accepted = ranking.accepted & (pairs.steps > neighbours)
    classes = classify_motions(errors, pairs.surface_overlap)
    kinds = classes.right, classes.wrong_motion, classes.no_overlap
    return Accepted(*(int(np.sum(accepted & kind)) for kind in kinds))


def _rank_all(
    rankings: Mapping[str, Ranking], labels: Labels, weights: Float[Array, "b p"]
) -> dict[str, Ranked | None]:
    """Rank by one rule; all methods get the same resamples, so that they can be compared."""
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
        f1, threshold = best_f1(curve)
        lead = None
        if first is None:
            first = average, samples
        else:
            behind = first[1].average_precision - samples.average_precision
            lead = Summary(first[0] - average, Interval.of(behind))
        full = recall_at_full_precision(curve)
        ranked[name] = Ranked(
            Summary(average, Interval.of(samples.average_precision)),
            Summary(full, Interval.of(samples.recall_at_full_precision)),
            BestF1(f1, Interval.of(samples.f1), threshold),
            lead,
            average_precision(curve_by_inliers),
            recall_at_full_precision(curve_by_inliers),
            curve,
            precision_by_inliers(inliers, positive),
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
        by_overlap=break_down(
            rule.measured(pairs), (0.0, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0), touching, accepted, errors
        ),
        by_yaw=break_down(
            np.abs(pairs.relative_yaw),
            tuple(np.radians([0.0, 30.0, 60.0, 120.0, 150.0, 180.0]).tolist()),
            positive,
            accepted,
            errors,
        ),
    )
