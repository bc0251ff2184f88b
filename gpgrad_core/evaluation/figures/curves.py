"""Precision and recall of all methods, like the paper's Figs. 8 and 9."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from gpgrad_core.arrays import NDArray
from gpgrad_core.evaluation.figures.style import COLOURS, new_figure, style_of
from gpgrad_core.evaluation.judge import Evaluation, Ranked, RuleVerdict, Summary
from gpgrad_core.evaluation.rules import Labels, Rule
from gpgrad_core.types import Array

GUESSING = "#777777"


def draw_precision_recall(evaluation: Evaluation, *, by_inliers: bool = False) -> Figure:
    """Draw precision over recall of all methods, one panel per rule: the paper's Fig. 8.

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
    panels = _panels(figure.subplots(1, len(evaluation.rules)))
    for k, (panel, rule, labels) in enumerate(
        zip(panels, evaluation.rules, evaluation.labels, strict=True)
    ):
        for number, method in enumerate(evaluation.methods):
            verdict = method.rules[k]
            ranked = verdict.ranked
            if ranked is None:
                continue
            curve = ranked.by_inliers if by_inliers else ranked.by_score
            name = f"{method.name}: {_figures_of(ranked, by_inliers=by_inliers)}"
            recall, precision = _points(curve.recall, curve.precision, from_zero=not by_inliers)
            panel.plot(
                recall,
                precision,
                label=name,
                marker="o" if by_inliers else "",
                markersize=4,
                **style_of(number),
            )
            if not by_inliers:
                _mark_own_decision(panel, verdict, number)
        _describe(panel, rule, labels)
        _add_legend(panel, stars=not by_inliers)
        panel.set_xlabel("recall: share of the true pairs that is found")
        panel.set_ylabel("precision: share of the found pairs that is true")
        panel.set_xlim(-0.02, 1.02)
    return figure


def draw_against_inliers(evaluation: Evaluation) -> Figure:
    """Draw precision, and recall below it, against the threshold on n: the paper's Fig. 9."""
    figure = new_figure(
        13.0,
        _height(evaluation, 7.8),
        f"{evaluation.dataset}: if the number of inliers n alone decided",
    )
    grid = np.atleast_2d(figure.subplots(2, len(evaluation.rules), sharex=True))
    upper, lower = _panels(grid[0]), _panels(grid[1])
    for k, (rule, labels) in enumerate(zip(evaluation.rules, evaluation.labels, strict=True)):
        above, below = upper[k], lower[k]
        for number, method in enumerate(evaluation.methods):
            ranked = method.rules[k].ranked
            if ranked is None:
                continue
            curve = ranked.by_inliers
            for panel, values in ((above, curve.precision), (below, curve.recall)):
                panel.plot(
                    curve.thresholds,
                    values,
                    label=method.name,
                    marker="o",
                    markersize=4,
                    **style_of(number),
                )
        _describe(above, rule, labels)
        above.set_ylabel("precision (no mark: nothing passes)")
        below.set_ylabel("recall")
        below.set_ylim(-0.02, 1.04)
        below.grid(alpha=0.3)
        below.set_xlabel("fewest inliers n that a loop closure needs")
        below.xaxis.set_major_locator(FixedLocator([1, 5, 10, 15, 20]))
    # The legend is that of the panel with the most lines; some rules may have nothing to rank.
    handles, names = max(
        (one.get_legend_handles_labels() for one in upper), key=lambda x: len(x[0])
    )
    names = ["guessing" if name.startswith("guessing: ") else name for name in names]
    figure.legend(handles, names, fontsize=8, loc="outside lower center", ncols=4)
    return figure


def _height(evaluation: Evaluation, panels: float) -> float:
    """Compute the height of the panels and of the legend below them [inches]."""
    return panels + 0.2 * (len(evaluation.methods) // 2 + 2)


def _panels(axes: Any) -> list[Axes]:
    return list(np.ravel(axes))


def _points(
    recall: Float[Array, "t"], precision: Float[Array, "t"], *, from_zero: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """List the points to join; a curve over every score starts at recall 0."""
    some = np.isfinite(precision)
    recall, precision = recall[some], precision[some]
    if not from_zero:
        return recall, precision
    return np.r_[0.0, recall], np.r_[precision[:1], precision]


def _figures_of(ranked: Ranked, *, by_inliers: bool) -> str:
    if by_inliers:
        average = f"{ranked.average_precision_by_inliers:.3f}"
        at_full = ranked.recall_at_full_precision_by_inliers
    else:
        average = _with_interval(ranked.average_precision)
        at_full = ranked.recall_at_full_precision.value
    return f"AP {average}, R100 {at_full:.3f}"


def _with_interval(summary: Summary) -> str:
    if summary.interval is None:
        return f"{summary.value:.3f}"
    return f"{summary.value:.3f} [{summary.interval.low:.2f}, {summary.interval.high:.2f}]"


def _mark_own_decision(panel: Axes, verdict: RuleVerdict, number: int) -> None:
    """Mark the precision and recall of the pairs that the method accepts."""
    named = verdict.accepted_true + verdict.accepted_false
    if named:
        panel.plot(
            [verdict.accepted_true / (verdict.accepted_true + verdict.missed)],
            [verdict.accepted_true / named],
            marker="*",
            color=COLOURS[number % len(COLOURS)],
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
        panel.axhline(share, color=GUESSING, linewidth=1, label=f"guessing: {share:.3f}")
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
