"""What matplotlib draws: the figure of a report, and the exported picture of the canvas."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure, FigureBase

from app.viewer.features.work import GROUND_AND_INK
from app.viewer.scene.associations import inlier_color
from app.viewer.scene.cameras import ScaleBar, length_text
from app.viewer.scene.colors import DATABASE, QUERY, Rgb, lookup_table
from app.viewer.scene.layers import OWN_LEVEL, STYLES, Paint, Scale
from app.viewer.scene.placement import HeightFrame, z_offset_of
from app.viewer.session.state import COMPARED, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.evaluation.plots.style import new_figure

FieldValues: TypeAlias = Float[NDArray[np.floating], "rows columns"]

WIDTH, HEIGHT, LINE, EDGE = 12.0, 10.4, 0.2, 0.3
"""Of the panels, of a line of text below them, and of the rim below it [inches of 110 pixels]."""


def draw_report(state: ViewState, result: PairResult, headline: str, below: str = "") -> Figure:
    """Draw the pair below the verdict, and lines such as the parameters below it."""
    text_height = LINE * len(below.splitlines()) + EDGE if below else 0.0
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
    ratio = state.params.features.max_std_ratio
    dz = z_offset_of(result.registration, result.maps, ratio)
    paint = Paint(result.maps, "elevation", ratio, levels=(HeightFrame(dz), OWN_LEVEL))
    matches, inliers = result.matches, result.registration.inliers
    ink = _hex(inlier_color(result))
    for index, (name, places, color) in enumerate(
        (
            (f"query {state.query_id}", matches.query_xy, QUERY),
            (f"database {state.database_id}", matches.database_xy, DATABASE),
        )
    ):
        _draw_field(panels[index], paint, index)
        panels[index].set_title(name, color=_hex(color), fontweight="bold")
        dots = places[inliers].T
        panels[index].scatter(*dots, s=9.0, color=ink, edgecolors="black", linewidths=0.4)


def _draw_comparisons(panels: NDArray[np.object_], state: ViewState, result: PairResult) -> None:
    """Draw what compares the maps at the database's cells, or say that there is no motion."""
    ratio = state.params.features.max_std_ratio
    motion, dz = (
        result.registration.T_database_query,
        z_offset_of(result.registration, result.maps, ratio),
    )
    for panel, layer in zip(panels, COMPARED, strict=True):
        panel.set_title(STYLES[layer].label)
        if motion is None:
            panel.text(0.5, 0.5, "no motion was found", ha="center", transform=panel.transAxes)
            panel.set_axis_off()
            continue
        _draw_field(panel, Paint(result.maps, layer, ratio, motion=motion, z_offset=dz), 1)


def _draw_field(panel: Axes, paint: Paint, index: int) -> None:
    gradient_map, scale = paint.maps[index], paint.scale
    grid, half = gradient_map.grid, gradient_map.grid.resolution / 2
    shown = np.where(gradient_map.trusted(paint.max_std_ratio), paint.fields[index], np.nan)
    image = panel.imshow(
        shown,
        origin="lower",
        extent=(grid.x[0] - half, grid.x[-1] + half, grid.y[0] - half, grid.y[-1] + half),
        cmap=ListedColormap(lookup_table(scale.color_map) / 255.0),
        vmin=scale.low,
        vmax=max(scale.high, math.nextafter(scale.low, math.inf)),
        interpolation="nearest",
    )
    panel.set_facecolor("#d9d9d9")  # of masked ground
    panel.set_xlabel("x [m]")
    panel.set_ylabel("y [m]")
    figure = panel.get_figure()
    assert figure is not None
    figure.colorbar(image, ax=panel, shrink=0.85).set_label(f"{scale.label} [{scale.unit}]")


def _hex(color: Rgb) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in color)


DPI = 100.0
HEAD, FOOT, SIDE, RIM = 0.09, 0.07, 0.17, 0.02
"""Room for the title, the scale bar, the colour bar and the rim, as shares of the larger side of
the view."""
LETTERS = 0.022
"""Height of the letters, as a share of the same."""


@dataclass(frozen=True, eq=False)
class Written:
    """What is written round the view."""

    title: str
    line: str  # below the title
    bar: ScaleBar  # in pixels of the view
    scale: Scale | None  # what the colours mean; None if nothing is coloured
    dark: bool  # whether the background is


def draw_picture(view: UInt8[NDArray[np.uint8], "rows columns 4"], written: Written) -> Figure:
    """Put a view of the scene, RGBA, onto a background, and write round it what it shows."""
    rows, columns = view.shape[:2]
    unit = max(rows, columns)
    background, ink = GROUND_AND_INK[written.dark]
    head, foot, rim = HEAD * unit, FOOT * unit, RIM * unit
    side = SIDE * unit if written.scale is not None else rim
    width, height = rim + columns + side, head + rows + foot
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor=background)
    points = 72.0 / DPI * LETTERS * unit

    axes = figure.add_axes((rim / width, foot / height, columns / width, rows / height))
    axes.set_axis_off()
    axes.imshow(view, aspect="auto", interpolation="none")
    figure.text(
        rim / width, 1 - 0.3 * head / height, written.title, color=ink, va="center",
        fontsize=1.25 * points, fontweight="bold",
    )  # fmt: skip
    figure.text(
        rim / width, 1 - 0.72 * head / height, written.line, color=ink, va="center", fontsize=points
    )

    below = figure.add_axes((rim / width, 0.0, columns / width, foot / height))
    below.set(xlim=(0, columns), ylim=(0, 1))
    below.set_axis_off()
    below.plot((0, 0, written.bar.pixels, written.bar.pixels), (0.8, 0.65, 0.65, 0.8), color=ink)
    below.text(0, 0.35, length_text(written.bar.metres), color=ink, va="center", fontsize=points)

    if written.scale is not None:
        _draw_colour_bar(figure, written.scale, ink, unit)
    return figure


def save_picture(figure: Figure, path: Path) -> None:
    """Write a picture in the format of the path's ending; letters stay letters, where they can.

    An SVG has them as outlines, because another machine may lack the font.
    """
    with rc_context({"svg.fonttype": "path", "pdf.fonttype": 42}):
        figure.savefig(path)


def _draw_colour_bar(figure: Figure, scale: Scale, ink: str, unit: float) -> None:
    width = float(figure.get_figwidth()) * DPI
    points = 72.0 / DPI * LETTERS * unit
    axes = figure.add_axes((1 - (SIDE - RIM) * unit / width, 0.3, 0.022 * unit / width, 0.4))
    axes.imshow(
        scale.bars.swapaxes(0, 1),
        origin="lower",
        aspect="auto",
        extent=(0, 1, scale.low, scale.high),
    )
    axes.set_xticks([])
    axes.yaxis.tick_right()
    axes.tick_params(colors=ink, labelsize=0.9 * points)
    axes.yaxis.set_label_position("right")
    name = f"{scale.label} [{scale.unit}]" if scale.unit else scale.label
    axes.set_ylabel(name, color=ink, fontsize=points)
    axes.spines[:].set_visible(False)
