"""The figure of a report: both maps, their height difference, and where they agree."""

import math
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, FigureBase

from app.viewer.scene.associations import inlier_color
from app.viewer.scene.colors import DATABASE, QUERY, Rgb, lookup_table
from app.viewer.scene.comparison import compare
from app.viewer.scene.layers import STYLES, Scale, shared_scale
from app.viewer.scene.placement import z_offset_of
from app.viewer.session.state import COMPARED, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.evaluation.plots.style import new_figure
from gpgrad_core.types import GradientMap

Field: TypeAlias = Float[NDArray[np.floating], "rows columns"]

WIDTH, HEIGHT, LINE, RIM = 12.0, 10.4, 0.2, 0.3
"""Of the panels, of a line of text below them, and of the rim below it [inches of 110 pixels]."""
MASKED = "#d9d9d9"
DOTS = 9.0


def draw_report(state: ViewState, result: PairResult, headline: str, below: str = "") -> Figure:
    """Draw the pair.

    Args:
        state: What was judged.
        result: What was found.
        headline: The verdict.
        below: Lines that stand below the panels, such as parameters and command.
    """
    text_height = LINE * len(below.splitlines()) + RIM if below else 0.0
    title = f"{state.dataset.name}: query {state.query_id}, database {state.database_id}"
    figure = new_figure(WIDTH, HEIGHT + text_height, f"{title}\n{headline}")
    figure.set_facecolor("white")
    upper: FigureBase = figure
    if below:
        parts: Any = figure.subfigures(2, 1, height_ratios=(HEIGHT, text_height))
        upper = parts[0]
        parts[1].text(0.02, 1.0, below, va="top", family="monospace", fontsize=8.5, linespacing=1.4)
    panels = upper.subplots(2, 2)
    _draw_maps(panels[0], state, result)
    _draw_comparisons(panels[1], state, result)
    return figure


def _draw_maps(panels: NDArray[np.object_], state: ViewState, result: PairResult) -> None:
    """Draw the elevation of both maps with one scale, and the inliers on them."""
    ratio = state.params.features.max_std_ratio
    maps = result.query_map, result.database_map
    lifts = z_offset_of(result.registration, maps, ratio), 0.0
    scale = shared_scale(maps, "elevation", "automatic", ratio, lifts)
    matches, inliers = result.matches, result.registration.inliers
    for panel, role, submap_id, a_map, lift, places, color in (
        (panels[0], "query", state.query_id, maps[0], lifts[0], matches.query_xy, QUERY),
        (
            panels[1],
            "database",
            state.database_id,
            maps[1],
            lifts[1],
            matches.database_xy,
            DATABASE,
        ),
    ):
        _draw_field(panel, a_map, a_map.elevation + lift, scale, ratio)
        panel.set_title(f"{role} {submap_id}", color=_hex(color), fontweight="bold")
        panel.scatter(
            *places[inliers].T,
            s=DOTS,
            color=_hex(inlier_color(result)),
            edgecolors="black",
            linewidths=0.4,
        )


def _draw_comparisons(panels: NDArray[np.object_], state: ViewState, result: PairResult) -> None:
    """Draw what compares the maps at the database's cells, or say that there is no motion."""
    ratio = state.params.features.max_std_ratio
    maps, motion = (result.query_map, result.database_map), result.registration.T_database_query
    for panel, layer in zip(panels, COMPARED, strict=True):
        panel.set_title(STYLES[layer].label)
        if motion is None:
            panel.text(0.5, 0.5, "no motion was found", ha="center", transform=panel.transAxes)
            panel.set_axis_off()
            continue
        fields = compare(layer, maps, motion, z_offset_of(result.registration, maps, ratio), ratio)
        scale = shared_scale(maps, layer, "automatic", ratio, (0.0, 0.0), fields)
        _draw_field(panel, maps[1], fields[1], scale, ratio)


def _draw_field(
    panel: Axes, gradient_map: GradientMap, field: Field, scale: Scale, ratio: float
) -> None:
    grid, half = gradient_map.grid, gradient_map.grid.resolution / 2
    shown = np.where(gradient_map.trusted(ratio), field, np.nan)
    image = panel.imshow(
        shown,
        origin="lower",
        extent=(grid.x[0] - half, grid.x[-1] + half, grid.y[0] - half, grid.y[-1] + half),
        cmap=ListedColormap(lookup_table(scale.color_map) / 255.0),
        vmin=scale.low,
        vmax=max(scale.high, math.nextafter(scale.low, math.inf)),
        interpolation="nearest",
    )
    panel.set_facecolor(MASKED)
    panel.set_xlabel("x [m]")
    panel.set_ylabel("y [m]")
    figure = panel.get_figure()
    assert figure is not None
    figure.colorbar(image, ax=panel, shrink=0.85).set_label(f"{scale.label} [{scale.unit}]")


def _hex(color: Rgb) -> str:
    """Write a colour as matplotlib reads it."""
    return "#" + "".join(f"{channel:02x}" for channel in color)
