"""Precision and recall of several datasets: the paper's Figs. 8 and 9."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from gpgrad_core.evaluation.figures.style import COLOURS, DASHES
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict
from gpgrad_core.evaluation.precision_recall import PrecisionRecall
from gpgrad_core.evaluation.reproduction.style import COLUMN, PAGE, letter, new_figure
from gpgrad_core.types import Array

A_ROW = 3
"""Panels side by side."""
RANDOM = "#777777"
MARKERS = "osD^vPX*"


def new_panels(titles: Sequence[str], height: float) -> tuple[Figure, list[Axes]]:
    """Make a figure of several panels with letters, up to three in a row.

    Args:
        titles: Of the panels.
        height: Of a panel [inches].
    """
    columns = min(A_ROW, len(titles))
    rows = -(-len(titles) // columns)
    figure = new_figure(COLUMN if columns == 1 else PAGE, rows * height + 0.4)
    panels = list(np.ravel(np.array(figure.subplots(rows, columns, squeeze=False))))
    for panel in panels[len(titles) :]:
        panel.set_axis_off()
    for k, (panel, title) in enumerate(zip(panels, titles, strict=False)):
        panel.set_title(title if len(titles) == 1 else f"{letter(k)} {title}")
    return figure, panels[: len(titles)]


def draw_precision_recall(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision over recall of all methods, a panel for each dataset: Fig. 8."""
    figure, panels = new_panels([one.dataset for one in evaluations], height=2.2)
    names = list(dict.fromkeys(one.name for all_of in evaluations for one in all_of.methods))
    for panel, evaluation in zip(panels, evaluations, strict=True):
        labels = evaluation.labels[0]
        for method in evaluation.methods:
            _draw_curve(panel, method, names.index(method.name))
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
    handles = [
        Line2D([], [], label=name, color=_colour(k), linestyle=_dashes(k), linewidth=_width(k))
        for k, name in enumerate(names)
    ]
    handles.append(Line2D([], [], label="random", color=RANDOM, linestyle=":", linewidth=1.0))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def draw_precision_by_inliers(evaluations: Sequence[Evaluation]) -> Figure:
    """Draw precision against the threshold on n, and its mean over all datasets: Fig. 9."""
    figure = new_figure(COLUMN, 2.5)
    panel = figure.subplots()
    curves = [curve for one in evaluations if (curve := inlier_curve(one.methods[0])) is not None]
    named = [one.dataset for one in evaluations if inlier_curve(one.methods[0]) is not None]
    for k, (curve, name) in enumerate(zip(curves, named, strict=True)):
        panel.plot(
            curve.thresholds,
            curve.precision,
            label=name,
            color=COLOURS[k % len(COLOURS)],
            linewidth=1.0,
            marker=MARKERS[k % len(MARKERS)],
            markersize=3.5,
        )
    if len(curves) > 1:
        panel.plot(
            curves[0].thresholds,
            mean_precision(curves),
            label="mean",
            color="black",
            linewidth=2.0,
            zorder=1.5,
        )
    panel.set_xlabel("least number of inliers n")
    panel.set_ylabel("precision")
    panel.set_ylim(0.0, 1.03)
    panel.xaxis.set_major_locator(FixedLocator([1, 5, 10, 15, 20]))
    panel.grid(alpha=0.3, linewidth=0.5)
    panel.legend(loc="lower right", framealpha=0.9)
    return figure


def inlier_curve(method: MethodVerdict) -> PrecisionRecall | None:
    """Give precision and recall at n = 1 … 20; None if no pair is true."""
    ranked = method.rules[0].ranked
    return None if ranked is None else ranked.by_inliers


def mean_precision(curves: Sequence[PrecisionRecall]) -> Float[Array, "t"]:
    """Compute the mean precision of the datasets of which a pair passes (t,); NaN if none does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a mean of nothing
        return np.nanmean([curve.precision for curve in curves], axis=0)


def judged_by_inliers(method: MethodVerdict) -> bool:
    """Tell whether a method ranks by the number of inliers alone, as the paper does."""
    return bool(np.array_equal(method.ranking.score, method.ranking.num_inliers))


def _draw_curve(panel: Axes, method: MethodVerdict, number: int) -> None:
    ranked = method.rules[0].ranked
    if ranked is None:
        return
    by_n = judged_by_inliers(method)
    curve = ranked.by_inliers if by_n else ranked.by_score
    some = np.isfinite(curve.precision)
    panel.plot(
        curve.recall[some],
        curve.precision[some],
        color=_colour(number),
        linestyle=_dashes(number),
        linewidth=_width(number),
        marker="." if by_n else "",
        markersize=4.0,
        zorder=2 if number == 0 else 3,  # it is wider, so it is seen below the others
        clip_on=False,
    )


def _colour(number: int) -> str:
    return COLOURS[number % len(COLOURS)]


def _dashes(number: int) -> Any:
    return DASHES[number % len(DASHES)]


def _width(number: int) -> float:
    return 2.0 if number == 0 else 1.1
