"""The exported picture: what the canvas shows, with its title, scale bar and colour bar."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from app.viewer.scene.colors import lookup_table
from app.viewer.scene.layers import Scale
from app.viewer.scene.overlay import ScaleBar, length_text
from gpgrad_core.arrays import NDArray

DPI = 100.0
HEAD, FOOT, SIDE, RIM = 0.09, 0.07, 0.17, 0.02
"""Room for the title, the scale bar, the colour bar and the rim, as shares of the larger side of
the view."""
LETTERS = 0.022
"""Height of the letters, as a share of the same."""
BAR_WIDTH = 0.022
LIGHT, DARK = ("white", "black"), ("#1a1b1e", "#e9ecef")
"""Background, and what is written on it, as in the page's two themes."""


@dataclass(frozen=True, eq=False)
class Written:
    """What is written round the view.

    Attributes:
        title: First line.
        line: Second line.
        bar: The scale bar, in pixels of the view.
        scale: What the colours mean; None if nothing is coloured.
        dark: Whether the background is dark.
    """

    title: str
    line: str
    bar: ScaleBar
    scale: Scale | None
    dark: bool


def draw_picture(view: UInt8[NDArray[np.uint8], "rows columns 4"], written: Written) -> Figure:
    """Put a view of the scene onto a background, and write round it what it shows.

    Args:
        view: Red, green, blue and opacity, as a page renders the scene.
        written: What is written.
    """
    rows, columns = view.shape[:2]
    unit = max(rows, columns)
    background, ink = DARK if written.dark else LIGHT
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


def _draw_colour_bar(figure: Figure, scale: Scale, ink: str, unit: float) -> None:
    """Draw the colours at the right, with ticks, name and unit."""
    width = float(figure.get_figwidth()) * DPI
    points = 72.0 / DPI * LETTERS * unit
    axes = figure.add_axes((1 - (SIDE - RIM) * unit / width, 0.3, BAR_WIDTH * unit / width, 0.4))
    colors = lookup_table(scale.color_map) / 255.0
    axes.imshow(
        np.linspace(0, 1, len(colors))[:, None],
        cmap=ListedColormap(colors),
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
