"""Sections of the report: the paper's protocol (Secs. VI, VII) beside ours, and what images say."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Literal, get_args

import numpy as np

from gpgrad_core.detection import DetectionResult
from gpgrad_core.evaluation.judge import Evaluation, evaluate
from gpgrad_core.evaluation.pages import TEMPLATES, cell, render
from gpgrad_core.evaluation.report import Section
from gpgrad_core.evaluation.rules import EvaluationParams
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.types import Dataset, ImageSays

Protocol = Literal["gpgrad", "paper"]

MIN_OVERLAPS = (0.3, 0.1)
"""Smallest overlap of a true pair in the paper: on Etna, and in Morocco (Sec. VII-A)."""
SURE_INLIERS = 5
"""From so many inliers on, all pairs of the paper were right (Sec. VII-C)."""


@dataclass(frozen=True)
class ByInliers:
    """How a method ranks the pairs by their inliers, under one protocol.

    Attributes:
        protocol: The protocol in a few words.
        method: Name of the method.
        true: Number of true pairs.
        false: Number of false pairs.
        left_out: Number of pairs that are not judged.
        average_precision: Of the ranking by n; None if no pair is true.
        recall_at_full_precision: Of the same.
        right_from: The smallest n from which all pairs are true; None if there is none.
        found_from_4: Numbers of true and of false pairs with four inliers or more.
        found_from_5: The same with five inliers or more.
        false_placed_right: Number of the latter false pairs whose motion is right.
    """

    protocol: str
    method: str
    true: int
    false: int
    left_out: int
    average_precision: float | None
    recall_at_full_precision: float | None
    right_from: int | None
    found_from_4: tuple[int, int]
    found_from_5: tuple[int, int]
    false_placed_right: int


def as_in_paper(params: EvaluationParams) -> EvaluationParams:
    """Leave no pair out: neighbours are judged too, and every pair that is not true is false."""
    return replace(params, neighbours=0, count_grey=True)


def paper_rules(params: EvaluationParams) -> tuple[EvaluationParams, ...]:
    """Give the parameters of the paper's protocol: one for each of its overlaps."""
    kept = replace(as_in_paper(params), num_resamples=0)
    return tuple(replace(kept, min_overlap=overlap) for overlap in MIN_OVERLAPS)


def describe_protocol(
    dataset: Dataset,
    detections: Mapping[str, DetectionResult | ClosureReport],
    evaluation: Evaluation,
) -> Section:
    """Judge detections by the paper's protocol too, and set the results beside ours.

    Args:
        dataset: The dataset that was searched.
        detections: The detections of each method by its name.
        evaluation: How they were judged by our protocol.

    Returns:
        The section of the report.
    """
    rows: list[ByInliers] = []
    for params in paper_rules(evaluation.params):
        judged = evaluate(dataset, detections, params, pairs=evaluation.pairs, seed=evaluation.seed)
        rows += _rows(judged, f"paper's, {judged.rules[0].name}", 0)
    for k, rule in enumerate(evaluation.rules):
        rows += _rows(evaluation, f"ours, {rule.name}", k)
    text = render(TEMPLATES / "protocols.md", rows=rows, params=evaluation.params, cell=cell)
    return Section("protocols", {"by_inliers": [asdict(row) for row in rows]}, text)


def _rows(evaluation: Evaluation, protocol: str, rule: int) -> list[ByInliers]:
    labels, rows = evaluation.labels[rule], list[ByInliers]()
    true, false = labels.positive, labels.negative
    for method in evaluation.methods:
        ranked, n = method.rules[rule].ranked, method.ranking.num_inliers
        most = int(n[false].max(initial=0))  # of a false pair
        rows.append(
            ByInliers(
                protocol=protocol,
                method=method.name,
                true=int(np.sum(true)),
                false=int(np.sum(false)),
                left_out=int(np.sum(~labels.judged)),
                average_precision=ranked and ranked.average_precision_by_inliers,
                recall_at_full_precision=ranked and ranked.recall_at_full_precision_by_inliers,
                right_from=most + 1 if (true & (n > most)).any() else None,
                found_from_4=(int(np.sum(true & (n >= 4))), int(np.sum(false & (n >= 4)))),
                found_from_5=(
                    int(np.sum(true & (n >= SURE_INLIERS))),
                    int(np.sum(false & (n >= SURE_INLIERS))),
                ),
                false_placed_right=int(np.sum(false & (n >= SURE_INLIERS) & method.errors.near)),
            )
        )
    return rows


def describe_images(
    reports: Mapping[str, ClosureReport], evaluation: Evaluation
) -> tuple[Section, ...]:
    """Count by the truth what camera images say of the pairs that the terrain accepted.

    Args:
        reports: What each method found, by its name.
        evaluation: How it was judged; its first rule says which pairs are true.

    Returns:
        The section; none if no method asked images.
    """
    labels = evaluation.labels[0]
    content: dict[str, dict[str, dict[str, int]]] = {}
    for name, report in reports.items():
        counts = {word: {"true": 0, "false": 0, "left_out": 0} for word in get_args(ImageSays)}
        for pair in report.pairs:
            row = evaluation.pairs.rows.get(frozenset((pair.query, pair.database)))
            if pair.images is not None and row is not None:
                true, false = labels.positive[row], labels.negative[row]
                truth = "true" if true else "false" if false else "left_out"
                counts[pair.images.verdict][truth] += 1
                content[name] = counts
    if not content:
        return ()
    text = render(TEMPLATES / "images.md", methods=content, rule=evaluation.rules[0], cell=cell)
    return (Section("images", content, text),)
