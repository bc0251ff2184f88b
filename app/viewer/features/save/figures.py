"""What matplotlib draws: the figure of a report, and the exported picture of the canvas."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure, FigureBase
from matplotlib.font_manager import fontManager

from app.viewer.charts import round_marks
from app.viewer.features.pair import PairDrawing, compose
from app.viewer.features.work import GROUND_AND_INK, view_of_page
from app.viewer.scene.associations import Kind, inlier_color, mark_of, shown_counts
from app.viewer.scene.cameras import ScaleBar, length_text, scale_bar, view_of
from app.viewer.scene.colors import DATABASE, INLIER, QUERY, Rgb, lookup_table
from app.viewer.scene.layers import Paint, Scale
from app.viewer.scene.placement import Canvas, z_offset_of
from app.viewer.scene.raster import rasterise
from app.viewer.session.layers import COMPARED, LAYERS, OWN_LEVEL, HeightFrame
from app.viewer.session.news import PairShown
from app.viewer.session.state import Camera, ViewState
from app.viewer.widgets.legend import KIND_NAMES
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.evaluation.plots.style import new_figure
from gpgrad_core.run.memo import Memo

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
    for panel, layer in zip(panels, COMPARED, strict=False):  # there is room for two
        panel.set_title(LAYERS[layer].label)
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
FAMILIES = ("Inter", "Helvetica", "Arial", "Liberation Sans", "DejaVu Sans")
"""As the pages have them; the first that this machine has is taken."""
UNITS = 178.0
"""Of letters, in the larger side of a sheet: 7.2 pixels of a film's 1280."""
RIM, BAND, LEGEND = 3.0, 19.0, 44.0
"""The rim round a picture, the band below it, and the width of the legend [units]."""


@dataclass(frozen=True)
class Sheet:
    """Where a picture and the band of its words lie [pixels]."""

    width: int
    height: int

    @classmethod
    def around(cls, columns: int, rows: int) -> "Sheet":
        """Lay the band below a picture of a size, and a rim round it."""
        unit = max(columns / (UNITS - 2 * RIM), rows / (UNITS - RIM - BAND))
        return cls(round(columns + 2 * RIM * unit), round(rows + (RIM + BAND) * unit))

    @property
    def unit(self) -> float:
        return max(self.width, self.height) / UNITS

    @property
    def area(self) -> tuple[int, int, int, int]:
        """Left, top, width and height of the picture."""
        rim, band = round(RIM * self.unit), round(BAND * self.unit)
        return rim, rim, self.width - 2 * rim, self.height - rim - band


@dataclass(frozen=True, eq=False)
class Written:
    """What is written below the view."""

    title: str
    line: str  # below the title
    bar: ScaleBar  # in pixels of the view
    scale: Scale | None  # what the colours mean; None if nothing is coloured
    dark: bool  # whether the background is
    counts: Mapping[Kind, int] = field(default_factory=dict[Kind, int])  # of keypoints, marked so
    inliers: Rgb = INLIER


def draw_picture(
    view: UInt8[NDArray[np.uint8], "rows columns _"] | None, written: Written, sheet: Sheet
) -> Figure:
    """Draw a view of the scene on a sheet, and write below it what it shows.

    Words stand at the left, scale bar and legend at the right, as they do while a page presents.
    """
    background, ink = GROUND_AND_INK[written.dark]
    unit, left, right = sheet.unit, RIM * sheet.unit, sheet.width - RIM * sheet.unit
    figure = Figure((sheet.width / DPI, sheet.height / DPI), dpi=DPI, facecolor=background)
    axes = figure.add_axes((0, 0, 1, 1))
    x, y, width, height = sheet.area
    if view is not None:
        axes.imshow(view, extent=(x, x + width, y + height, y), interpolation="none")
    axes.set(xlim=(0, sheet.width), ylim=(sheet.height, 0), aspect="auto")
    axes.set_axis_off()
    family = _family()

    def write(text: str, x: float, y: float, units: float, **look: Any) -> None:
        points = 72.0 / DPI * units * unit
        axes.text(x, y, text, color=ink, family=family, fontsize=points, **look)

    has_legend = written.scale is not None
    room = (right - left) / unit - (LEGEND + 4.0 if has_legend else 24.0)
    for text, units, up, look in (
        (written.title, 4.4, 12.6, {"fontweight": "bold"}),
        (written.line, 2.4, 7.4, {"alpha": 0.8}),
    ):
        fits = min(units, room / (0.56 * max(len(text), 1)))
        write(text, left, sheet.height - up * unit, fits, va="center", **look)

    bar, foot = written.bar, sheet.height - 3.4 * unit
    ends = right - np.array([bar.pixels, bar.pixels, 0, 0])
    ticks = foot - unit * np.array([0.9, 0, 0, 0.9])
    axes.plot(ends, ticks, color=ink, linewidth=72 / DPI * 0.25 * unit, solid_joinstyle="miter")
    write(length_text(bar.metres), right - bar.pixels / 2, foot - 0.7 * unit, 1.8, ha="center")
    if written.scale is not None:
        _draw_legend(axes, written, sheet, write)
    return figure


def _draw_legend(axes: Axes, written: Written, sheet: Sheet, write: Callable[..., None]) -> None:
    """Draw what the colours mean, and the marks above it."""
    scale, unit = written.scale, sheet.unit
    assert scale is not None
    right, top = sheet.width - RIM * unit, sheet.height - 11.6 * unit
    left = right - LEGEND * unit
    extent = (left, right, top + 1.8 * unit, top)
    axes.imshow(scale.bars, extent=extent, aspect="auto", interpolation="nearest")
    name = f"{scale.label} [{scale.unit}]" if scale.unit else scale.label
    if scale.tints:
        name += " · query blue, database orange"
    write(
        name,
        (left + right) / 2,
        top - 0.6 * unit,
        min(2.0, LEGEND / (0.5 * len(name))),
        ha="center",
    )
    span = max(scale.high - scale.low, 1e-9)
    for value in round_marks(scale.low, scale.high):
        at = left + (right - left) * (value - scale.low) / span
        write(f"{value:g}", at, top + 2.2 * unit, 1.7, ha="center", va="top")
    marks = [
        (mark_of(kind, written.inliers), f"{written.counts[kind]:,} {name}")
        for kind, name in KIND_NAMES
        if kind in written.counts
    ]
    long = 0.5 * max(sum(len(text) for _, text in marks), 1)
    letters = min(1.7, (LEGEND - 3.5 * len(marks)) / long)
    at, up = left, top - 4.2 * unit
    for mark, text in marks:
        for color, width in ((mark.rim, mark.rim_width), (mark.core, mark.core_width)):
            size = (72 / DPI * 0.3 * width * unit) ** 2
            axes.scatter([at + 0.7 * unit], [up], size, color=_hex(color), linewidths=0)
        write(text, at + 1.9 * unit, up, letters, va="center")
        at += (3.5 + 0.5 * letters * len(text)) * unit


@cache
def _family() -> str:
    known = {font.name for font in fontManager.ttflist}
    return next((name for name in FAMILIES if name in known), "sans-serif")


def crop(
    view: UInt8[NDArray[np.uint8], "rows columns 3"], ground: Rgb
) -> UInt8[NDArray[np.uint8], "_rows _columns 3"]:
    """Cut away what shows nothing but the ground round a view."""
    seen = (view != np.array(ground, np.uint8)).any(axis=-1)
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if not len(rows):
        return view
    return view[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def pixels_of(figure: Figure) -> UInt8[NDArray[np.uint8], "rows columns 3"]:
    """Draw a figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


LETTERS_STAY = partial(rc_context, {"svg.fonttype": "path", "pdf.fonttype": 42})


def save_picture(figure: Figure, path: Path) -> None:
    """Write a picture in the format of the path's ending; letters stay letters, where they can.

    An SVG has them as outlines, because another machine may lack the font.
    """
    with LETTERS_STAY():
        figure.savefig(path)


View = UInt8[NDArray[np.uint8], "rows columns 3"]
Words = tuple[str, str]


def ground_of(dark: bool) -> Rgb:
    """The background of a picture."""
    red, green, blue = (round(255 * part) for part in to_rgb(GROUND_AND_INK[dark][0]))
    return red, green, blue


def pair_view(
    shown: PairShown,
    memo: Memo,
    camera: Camera,
    canvas: Canvas,
    words: Words,
    dark: bool,
    times: float,
) -> tuple[View, Written]:
    """Draw the pair without its page; marks and lines are so many times as wide as there."""
    state, result = shown
    drawing = PairDrawing(
        compose(state, result.maps, result.registration, memo, result=result), result
    )
    view = rasterise(drawing.at(), camera, canvas, ground_of(dark), times)
    return view, written_of(drawing, result, camera, canvas, words, dark)


def rendered_view(
    page: viser.ClientHandle, canvas: Canvas, words: Words, scale: Scale | None, dark: bool
) -> tuple[View, Written]:
    """What a page shows, drawn by it."""
    view = view_of_page(page, round(canvas.width), round(canvas.height))
    share = view[..., 3:] / 255.0
    mixed = view[..., :3] * share + np.array(ground_of(dark)) * (1.0 - share)
    written = Written(*words, scale_bar(view_of(page), canvas), scale, dark)
    return mixed.round().astype(np.uint8), written


def written_of(
    drawing: PairDrawing,
    result: PairResult,
    camera: Camera,
    canvas: Canvas,
    words: Words,
    dark: bool,
) -> Written:
    """What stands beside a view of the pair: title, line, scale bar, legend and marks."""
    picture, bar = drawing.picture, scale_bar(camera, canvas)
    counts = shown_counts(result, picture.state.options)
    return Written(*words, bar, picture.scale, dark, counts, inlier_color(result))
