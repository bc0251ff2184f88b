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
from gpgrad_core.evaluation.judge import Evaluation, MethodVerdict
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.evaluation.plots.curves import draw_against_inliers, draw_precision_recall
from gpgrad_core.evaluation.plots.style import FALSE, GREY, MISSED, TRUE, new_figure
from gpgrad_core.evaluation.rules import Labels
from gpgrad_core.types import Array

MOST_NAMES = 15
"""Largest number of submaps' names along an axis; more would overlap."""
PATH, STOP = "#BBBBBB", "#444444"
LEFT_OUT = "#F6DFC8"  # a tint, because the scores are grey and the rings have full colours


def draw_report(evaluation: Evaluation) -> dict[str, Figure]:
    """Draw all pictures of an evaluation's report.

    Returns:
        The pictures by file name, without the ending.
    """
    pictures: dict[str, Figure] = {}
    if any(labels.positive.any() for labels in evaluation.labels):
        pictures["precision_recall"] = draw_precision_recall(evaluation)
        pictures["precision_recall_by_inliers"] = draw_precision_recall(evaluation, by_inliers=True)
        pictures["precision_by_inliers"] = draw_against_inliers(evaluation)
    for name, method in zip(evaluation.file_names, evaluation.methods, strict=True):
        pictures[f"affinity_{name}"] = draw_affinity(evaluation, method)
        pictures[f"loops_{name}"] = draw_loops(evaluation, method)
    return pictures


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
        panel.set_facecolor(LEFT_OUT)
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
    """Draw rings around pairs in both halves of the matrix."""
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
