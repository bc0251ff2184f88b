"""Precision and recall: the curves of a report, and the paper's Figs. 8 and 9."""

import warnings
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict, Ranked, RuleVerdict
from gpgrad_core.evaluation.plots.style import (
    COLUMN,
    PAGE,
    RANDOM,
    colour_of,
    letter,
    line_of,
    new_figure,
    printed_line_of,
)
from gpgrad_core.evaluation.precision_recall import PrecisionRecall
from gpgrad_core.evaluation.rules import Labels, Rule
from gpgrad_core.types import Array

A_ROW = 3
"""Panels of a printed figure side by side."""
MARKERS = "osD^vPX*"
INLIER_TICKS = (1, 5, 10, 15, 20)


def draw_precision_recall(evaluation: Evaluation, *, by_inliers: bool = False) -> Figure:
    """Draw precision over recall of all methods, one panel per rule, as in the paper's Fig. 8.

    Args:
        evaluation: The results to draw.
        by_inliers: Whether the threshold is the number of inliers 1 … 20, as in the paper,
            instead of the score.
    """
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
    handles, names = max((panel.get_legend_handles_labels() for panel in upper), key=_num_lines)
    names = ["guessing" if name.startswith("guessing: ") else name for name in names]
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=4)
    return figure


def draw_figure_8(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision over recall of all methods, a panel for each dataset: the paper's Fig. 8."""
    figure, panels = new_panels([evaluation.dataset for evaluation in evaluations], height=2.2)
    names = list(
        dict.fromkeys(method.name for evaluation in evaluations for method in evaluation.methods)
    )
    for panel, evaluation in zip(panels, evaluations, strict=True):
        labels = evaluation.labels[0]
        for method in evaluation.methods:
            _draw_printed(panel, method, names.index(method.name))
        if labels.positive.any():
            share = float(np.mean(labels.positive[labels.judged]))
            panel.axhline(share, color=RANDOM, linestyle=":", linewidth=1.0)
        else:
            panel.text(0.5, 0.5, "no pair is true", ha="center", transform=panel.transAxes)
        panel.set_xlim(0.0, 1.02)
        panel.set_ylim(0.0, 1.03)
        panel.grid(alpha=0.3, linewidth=0.5)
        panel.set_xlabel("recall")
        panel.set_ylabel("precision")
    handles = [Line2D([], [], label=name, **printed_line_of(k)) for k, name in enumerate(names)]
    handles.append(Line2D([], [], label="random", color=RANDOM, linestyle=":", linewidth=1.0))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def draw_figure_9(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision against the threshold on n, and its mean over all datasets: Fig. 9."""
    figure = new_figure(COLUMN, 2.5)
    panel = figure.subplots()
    ranked = [
        (evaluation.dataset, curve)
        for evaluation in evaluations
        if (curve := inlier_curve(evaluation.methods[0])) is not None
    ]
    for k, (dataset, curve) in enumerate(ranked):
        panel.plot(
            curve.thresholds,
            curve.precision,
            label=dataset,
            color=colour_of(k),
            linewidth=1.0,
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.5,
        )
    if len(ranked) > 1:
        panel.plot(
            ranked[0][1].thresholds,
            mean_precision([curve for _, curve in ranked]),
            label="mean",
            color="black",
            linewidth=2.0,
            zorder=1.5,
        )
    panel.set_xlabel("least number of inliers n")
    panel.set_ylabel("precision")
    panel.set_ylim(0.0, 1.03)
    panel.xaxis.set_major_locator(FixedLocator(INLIER_TICKS))
    panel.grid(alpha=0.3, linewidth=0.5)
    panel.legend(loc="lower right", framealpha=0.9)
    return figure


def new_panels(titles: Sequence[str], height: float) -> tuple[Figure, list[Axes]]:
    """Make a printed figure of several panels with letters, up to three in a row.

    Args:
        titles: Of the panels.
        height: Of a panel [inches].
    """
    columns = min(A_ROW, len(titles))
    rows = -(-len(titles) // columns)
    figure = new_figure(COLUMN if columns == 1 else PAGE, rows * height + 0.4)
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for panel in panels[len(titles) :]:
        panel.set_axis_off()
    for k, (panel, title) in enumerate(zip(panels, titles, strict=False)):
        panel.set_title(title if len(titles) == 1 else f"{letter(k)} {title}")
    return figure, panels[: len(titles)]


def inlier_curve(method: MethodVerdict, rule: int = 0) -> PrecisionRecall | None:
    """Give precision and recall at n = 1 … 20; None if the rule calls no pair true."""
    ranked = method.rules[rule].ranked
    return None if ranked is None else ranked.by_inliers


def mean_precision(curves: Sequence[PrecisionRecall]) -> Float[Array, "t"]:
    """Compute the mean precision of the datasets of which a pair passes (t,); NaN if none does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a mean of nothing
        return np.nanmean([curve.precision for curve in curves], axis=0)


def _draw_printed(panel: Axes, method: MethodVerdict, number: int) -> None:
    ranked = method.rules[0].ranked
    if ranked is None:
        return
    # The paper's ranking is by the number of inliers alone: then n goes from 1 to 20.
    by_inliers = np.array_equal(method.ranking.score, method.ranking.num_inliers)
    curve = ranked.by_inliers if by_inliers else ranked.by_score
    some = np.isfinite(curve.precision)
    panel.plot(
        curve.recall[some],
        curve.precision[some],
        marker="." if by_inliers else "",
        markersize=4.0,
        zorder=2 if number == 0 else 3,  # it is wider, so it is seen below the others
        clip_on=False,
        **printed_line_of(number),
    )


def _num_lines(legend: tuple[list[object], list[str]]) -> int:
    return len(legend[0])


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
    """Mark the precision and recall of the pairs that the method accepts."""
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
