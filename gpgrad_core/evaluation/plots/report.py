"""The pictures of a report: curves, the affinity matrix, and the loop closures from above."""

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict, Ranked, RuleVerdict
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.evaluation.plots.style import (
    FALSE,
    GREY,
    INLIER_TICKS,
    MISSED,
    RANDOM,
    TRUE,
    colour_of,
    line_of,
    new_figure,
)
from gpgrad_core.evaluation.precision_recall import PrecisionRecall
from gpgrad_core.evaluation.rules import Labels, Rule
from gpgrad_core.types import Array

MOST_NAMES = 15
"""Largest number of submaps' names along an axis; more would overlap."""
PATH, STOP = "#BBBBBB", "#444444"


def draw_report(evaluation: Evaluation) -> dict[str, Figure]:
    """Draw all pictures of an evaluation's report, by file name without the ending."""
    pictures: dict[str, Figure] = {}
    if any(labels.positive.any() for labels in evaluation.labels):
        pictures["precision_recall"] = draw_precision_recall(evaluation)
        pictures["precision_recall_by_inliers"] = draw_precision_recall(evaluation, by_inliers=True)
        pictures["precision_by_inliers"] = draw_against_inliers(evaluation)
    for name, method in zip(evaluation.file_names, evaluation.methods, strict=True):
        pictures[f"affinity_{name}"] = draw_affinity(evaluation, method)
        pictures[f"loops_{name}"] = draw_loops(evaluation, method)
    return pictures


def draw_precision_recall(evaluation: Evaluation, *, by_inliers: bool = False) -> Figure:
    """Draw precision over recall of all methods, one panel per rule, as in the paper's Fig. 8."""
    swept = "the number of inliers, n = 1 to 20" if by_inliers else "each method's score"
    figure = new_figure(
        13.0,
        _height(evaluation, 5.4),
        f"{evaluation.dataset}: precision and recall as the threshold moves on {swept}",
    )
    (panels,) = figure.subplots(1, len(evaluation.rules), squeeze=False)
    for k, (panel, rule, labels) in enumerate(
        zip(panels, evaluation.rules, evaluation.labels, strict=True)
    ):
        for number, method in enumerate(evaluation.methods):
            verdict = method.rules[k]
            ranked = verdict.ranked
            if ranked is None:
                continue
            curve = ranked.by_inliers if by_inliers else ranked.by_score
            some = np.isfinite(curve.precision)
            recall, precision = curve.recall[some], curve.precision[some]
            if not by_inliers:  # a curve over every score starts at recall 0
                recall, precision = np.r_[0.0, recall], np.r_[precision[:1], precision]
                _mark_own_decision(panel, verdict, number)
            panel.plot(
                recall,
                precision,
                label=f"{method.name}: {_summary(ranked, by_inliers=by_inliers)}",
                marker="o" if by_inliers else "",
                markersize=4,
                **line_of(number),
            )
        _describe(panel, rule, labels)
        _add_legend(panel, stars=not by_inliers)
        panel.set_xlabel("recall: share of the true pairs that is found")
        panel.set_ylabel("precision: share of the found pairs that is true")
        panel.set_xlim(-0.02, 1.02)
    return figure


def draw_against_inliers(evaluation: Evaluation) -> Figure:
    """Draw precision, and recall below it, against the threshold on n, as in the paper's Fig. 9."""
    figure = new_figure(
        13.0,
        _height(evaluation, 7.8),
        f"{evaluation.dataset}: if the number of inliers n alone decided",
    )
    upper, lower = figure.subplots(2, len(evaluation.rules), sharex=True, squeeze=False)
    for k, (rule, labels) in enumerate(zip(evaluation.rules, evaluation.labels, strict=True)):
        above, below = upper[k], lower[k]
        for number, method in enumerate(evaluation.methods):
            curve = inlier_curve(method, k)
            if curve is None:
                continue
            for panel, values in ((above, curve.precision), (below, curve.recall)):
                panel.plot(
                    curve.thresholds,
                    values,
                    label=method.name,
                    marker="o",
                    markersize=4,
                    **line_of(number),
                )
        _describe(above, rule, labels)
        above.set_ylabel("precision (no mark: nothing passes)")
        below.set_ylabel("recall")
        below.set_ylim(-0.02, 1.04)
        below.grid(alpha=0.3)
        below.set_xlabel("fewest inliers n that a loop closure needs")
        below.xaxis.set_major_locator(FixedLocator(INLIER_TICKS))
    # The legend is that of the panel with the most lines; some rules may have nothing to rank.
    legends = (panel.get_legend_handles_labels() for panel in upper)
    handles, names = max(legends, key=lambda legend: len(legend[0]))
    names = ["guessing" if name.startswith("guessing: ") else name for name in names]
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=4)
    return figure


def inlier_curve(method: MethodVerdict, rule: int = 0) -> PrecisionRecall | None:
    """Precision and recall at n = 1 … 20; None if the rule calls no pair true."""
    ranked = method.rules[rule].ranked
    return None if ranked is None else ranked.by_inliers


def _height(evaluation: Evaluation, panels: float) -> float:
    """Compute the height of the panels and of the legend below them [inches]."""
    return panels + 0.2 * (len(evaluation.methods) // 2 + 2)


def _summary(ranked: Ranked, *, by_inliers: bool) -> str:
    if by_inliers:
        average = f"{ranked.average_precision_by_inliers:.3f}"
        at_full = ranked.recall_at_full_precision_by_inliers
    else:
        average = ranked.average_precision.text()
        at_full = ranked.recall_at_full_precision.value
    return f"AP {average}, R100 {at_full:.3f}"


def _mark_own_decision(panel: Axes, verdict: RuleVerdict, number: int) -> None:
    accepted = verdict.accepted_true + verdict.accepted_false
    if accepted:
        panel.plot(
            [verdict.accepted_true / (verdict.accepted_true + verdict.missed)],
            [verdict.accepted_true / accepted],
            marker="*",
            color=colour_of(number),
            markeredgecolor="black",
            markersize=20 if number == 0 else 11,
            markeredgewidth=0.7,
            zorder=4,
        )


def _describe(panel: Axes, rule: Rule, labels: Labels) -> None:
    """Describe what counts as true, how many pairs are true, and the precision of guessing."""
    positives, judged = int(np.sum(labels.positive)), int(np.sum(labels.judged))
    left_out: list[str] = []
    if not rule.count_grey:
        left_out.append(f"{int(np.sum(labels.grey))} grey pairs")
    if rule.neighbours:
        left_out.append(f"neighbours |i - j| <= {rule.neighbours}")
    panel.set_title(
        f"true: {rule.name}; {positives} true, {judged - positives} false pairs"
        + (f"\nleft out: {', '.join(left_out)}" if left_out else ""),
        fontsize=10,
    )
    panel.set_ylim(-0.02, 1.04)
    panel.grid(alpha=0.3)
    if positives:
        share = positives / judged
        panel.axhline(share, color=RANDOM, linewidth=1, label=f"guessing: {share:.3f}")
    else:
        panel.text(0.5, 0.5, "no pair is true by this rule", transform=panel.transAxes)


def _add_legend(panel: Axes, *, stars: bool) -> None:
    handles, names = panel.get_legend_handles_labels()
    if not handles:
        return
    if stars:
        handles.append(
            Line2D([], [], linestyle="", marker="*", color="white", markeredgecolor="black")
        )
        names.append("what the method itself accepts")
    # The legend is below the panel, because inside it would hide curves.
    panel.legend(
        handles, names, fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2
    )


def draw_affinity(evaluation: Evaluation, method: MethodVerdict) -> Figure:
    """Draw the true overlap of all pairs beside their scores; rings show the verdicts."""
    pairs, rule, labels = evaluation.pairs, evaluation.rules[0], evaluation.labels[0]
    figure = new_figure(
        13.0,
        6.2,
        f"{evaluation.dataset}, {method.name}: true overlap, and scores",
        layout="compressed",
    )
    truth, scores = figure.subplots(1, 2)
    neighbours = pairs.steps <= rule.neighbours
    listed = np.isfinite(method.ranking.score)
    score = np.where(listed, method.ranking.score, np.nan)
    band = f" (tinted: |i - j| <= {rule.neighbours}, left out)" if rule.neighbours else ""

    # Neighbouring submaps overlap so much that other pairs would look black beside them.
    image = truth.imshow(
        _matrix(pairs, pairs.box_iou, ~neighbours), cmap="viridis", vmin=0.0, origin="lower"
    )
    figure.colorbar(image, ax=truth, label="box IoU (Eq. 8)", shrink=0.8)
    _ring(truth, pairs, labels.positive, "white", f"true: {rule.name}")
    truth.set_title(f"truth: overlap of the boxes{band}", fontsize=10)

    # The colour goes by the root of the score, or a few high scores would leave all others black.
    shown = score[listed & ~neighbours]
    low, high = (float(shown.min()), float(shown.max())) if len(shown) else (0.0, 1.0)
    image = scores.imshow(
        _matrix(pairs, score, ~neighbours),
        cmap="gray",
        norm=PowerNorm(0.5, low, high if high > low else low + 1.0),
        origin="lower",
    )
    figure.colorbar(image, ax=scores, label="score (colour goes by its root)", shrink=0.8)
    for label, chosen, colour in _verdicts(method, labels):
        _ring(scores, pairs, chosen, colour, f"{label}: {int(np.sum(chosen))}")
    scores.set_title(f"score of {method.name}{band}", fontsize=10)

    for panel in (truth, scores):
        # A tint, because the scores are grey and the rings have full colours.
        panel.set_facecolor("#F6DFC8")
        _name_submaps(panel, pairs)
        panel.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.12),
            ncols=4,
            fontsize=8,
            facecolor="#888888",
            labelcolor="white",
        )
    return figure


def draw_loops(evaluation: Evaluation, method: MethodVerdict) -> Figure:
    """Draw the true positions of the submaps, and a line for every pair accepted or missed."""
    pairs, rule, labels = evaluation.pairs, evaluation.rules[0], evaluation.labels[0]
    figure = new_figure(
        9.0,
        9.0,
        f"{evaluation.dataset}, {method.name}: loop closures on the true traverse\n"
        f"true: {rule.name}"
        + (f"; neighbours |i - j| <= {rule.neighbours} left out" if rule.neighbours else ""),
    )
    panel = figure.subplots()
    x, y = pairs.world_xy.T
    panel.plot(x, y, "-", color=PATH, linewidth=1.0, zorder=1)
    panel.plot(x, y, "o", color=STOP, markersize=4, zorder=3)
    for k, name in enumerate(pairs.ids):
        panel.annotate(name, (x[k], y[k]), (4, 4), textcoords="offset points", fontsize=7)
    handles = [Line2D([], [], color=PATH, marker="o", markerfacecolor=STOP, markersize=4)]
    names = ["submaps in their order"]
    for label, chosen, colour in _verdicts(method, labels):
        dashes = ":" if colour == MISSED else "-"
        width = 3.0 if colour == FALSE else 1.4
        ends = zip(pairs.query[chosen], pairs.database[chosen], strict=True)
        lines = [pairs.world_xy[[query, database]] for query, database in ends]
        panel.add_collection(
            LineCollection(lines, colors=colour, linestyles=dashes, linewidths=width, zorder=2)
        )
        handles.append(Line2D([], [], color=colour, linestyle=dashes, linewidth=width))
        names.append(f"{label}: {len(lines)}")
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("x in the world [m]")
    panel.set_ylabel("y in the world [m]")
    panel.grid(alpha=0.3)
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _verdicts(
    method: MethodVerdict, labels: Labels
) -> tuple[tuple[str, Bool[Mask, "p"], str], ...]:
    """List the verdicts as (name, which pairs, colour); the gravest is last, drawn on top."""
    accepted = method.ranking.accepted
    return (
        ("true, missed", labels.positive & ~accepted, MISSED),
        ("accepted, grey", accepted & labels.grey, GREY),
        ("accepted, true", accepted & labels.positive, TRUE),
        ("accepted, FALSE", accepted & labels.negative, FALSE),
    )


def _matrix(
    pairs: TruePairs, values: Float[Array, "p"], shown: Bool[Mask, "p"]
) -> Float[Array, "n n"]:
    """Make the symmetric matrix; NaN on the diagonal and for pairs that are not shown."""
    matrix = np.full((len(pairs.ids), len(pairs.ids)), np.nan)
    values = np.where(shown, values, np.nan)
    matrix[pairs.query, pairs.database] = values
    matrix[pairs.database, pairs.query] = values
    return matrix


def _ring(panel: Axes, pairs: TruePairs, chosen: Bool[Mask, "p"], colour: str, label: str) -> None:
    query, database = pairs.query[chosen], pairs.database[chosen]
    panel.plot(
        np.r_[query, database],
        np.r_[database, query],
        "o",
        markersize=max(2.0, 180 / len(pairs.ids)),
        markerfacecolor="none",
        markeredgecolor=colour,
        label=label,
    )


def _name_submaps(panel: Axes, pairs: TruePairs) -> None:
    every = -(-len(pairs.ids) // MOST_NAMES)
    places = list(range(0, len(pairs.ids), every))
    names = [pairs.ids[place] for place in places]
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(FixedLocator(places))
        axis.set_ticklabels(names)
        axis.set_tick_params(labelsize=7)
    panel.set_xlabel("submap")
    panel.set_ylabel("submap")
