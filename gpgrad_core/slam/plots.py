"""Plots of the traverse before and after."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from gpgrad_core.evaluation.plots.style import COLOURS, FALSE, colour_of, new_figure
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.errors import align_points, positions
from gpgrad_core.slam.optimise import OptimisedGraph

TRUE_PATH = "#999999"
MOST_NAMES = 60
"""Submaps are named in a figure up to this number; more names would hide the path."""


def draw_trajectories(
    name: str,
    traverses: Sequence[Sequence[str]],
    before: Mapping[str, Pose],
    result: OptimisedGraph,
    true: Mapping[str, Pose],
) -> Figure:
    """Draw traverses from above, before and after, with closures by score and aligned truth."""
    figure = new_figure(14.0, 6.5, f"{name}: the traverse before and after")
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    scores = [fit.edge.score or 0.0 for fit in result.loops if fit.weight >= 0.5]
    shade = ScalarMappable(Normalize(min(scores, default=0.0), max(scores, default=1.0)), "viridis")
    for panel, poses, title in (
        (panels[0], before, "before: odometry"),
        (panels[1], result.poses, "after: with loop closures"),
    ):
        for number, names in enumerate(traverses):
            _draw_truth(panel, [name for name in names if name in true], true, result.poses)
            _draw_path(panel, names, poses, colour_of(number))
        _draw_loops(panel, poses, result, shade)
        panel.set_title(title)
        panel.set_aspect("equal")
        panel.set_xlabel("x in the world [m]")
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("y in the world [m]")
    handles = [Line2D([], [], color=COLOURS[0], marker="o", markersize=4)]
    labels = ["submaps in their order"]
    if true:
        handles.append(Line2D([], [], color=TRUE_PATH, linewidth=3, alpha=0.6))
        labels.append("where they truly are")
    if result.refused:
        handles.append(Line2D([], [], color=FALSE, linestyle=":"))
        labels.append(f"closures refused as wrong: {len(result.refused)}")
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    if scores:
        bar = figure.colorbar(shade, ax=panels, shrink=0.8)
        bar.set_label(f"score of the {len(scores)} closures used")
    return figure


def draw_errors(name: str, before: Mapping[str, float], after: Mapping[str, float]) -> Figure:
    """Draw each submap's distance from its true position [m], before and after."""
    figure = new_figure(11.0, 5.0, f"{name}: distance from the truth")
    panel = figure.subplots()
    places = np.arange(len(before))
    panel.plot(places, list(before.values()), "o-", color=COLOURS[1], label="before: odometry")
    panel.plot(places, list(after.values()), "o-", color=COLOURS[0], label="after")
    if len(before) <= MOST_NAMES:
        panel.set_xticks(places, list(before), rotation=90, fontsize=7)
    panel.set_xlabel("submap")
    panel.set_ylabel("distance after alignment [m]")
    panel.set_ylim(bottom=0)
    panel.grid(alpha=0.3)
    panel.legend(frameon=False)
    return figure


def _draw_truth(
    panel: Axes, names: Sequence[str], true: Mapping[str, Pose], corrected: Mapping[str, Pose]
) -> None:
    if len(names) < 2:
        return
    x, y, _ = align_points(positions(names, true), positions(names, corrected)).T
    panel.plot(x, y, "-", color=TRUE_PATH, linewidth=3, alpha=0.6, zorder=1)


def _draw_path(panel: Axes, names: Sequence[str], poses: Mapping[str, Pose], colour: str) -> None:
    x, y, _ = positions(names, poses).T
    panel.plot(x, y, "o-", color=colour, linewidth=1.0, markersize=3, zorder=3)
    if len(poses) <= MOST_NAMES:
        for k, name in enumerate(names):
            panel.annotate(name, (x[k], y[k]), (3, 3), textcoords="offset points", fontsize=6)


def _draw_loops(
    panel: Axes, poses: Mapping[str, Pose], result: OptimisedGraph, shade: ScalarMappable
) -> None:
    for is_used, dashes in ((True, "-"), (False, ":")):
        fits = [fit for fit in result.loops if (fit.weight >= 0.5) == is_used]
        lines = [positions([fit.edge.start, fit.edge.end], poses)[:, :2] for fit in fits]
        colours = [
            shade.to_rgba(np.array(fit.edge.score or 0.0)) if is_used else FALSE for fit in fits
        ]
        panel.add_collection(
            LineCollection(lines, colors=colours, linestyles=dashes, linewidths=1.2, zorder=2)
        )
