"""How all plots look: the colours, those of a report, and those of a paper's columns."""

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypedDict

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import Grid

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31")
DASHES: tuple[Literal["-", "--", "-.", ":"], ...] = ("-", "--", "-.", ":")
TRUE, FALSE, GREY, MISSED = "#009E73", "#D7191C", "#E69F00", "#0072B2"
RANDOM = "#777777"
INLIER_TICKS = (1, 5, 10, 15, 20)

COLUMN, PAGE = 3.5, 7.16
"""Width of a column, and of both columns and the gap between them [inches]: IEEE's."""
QUERY, DATABASE = "#d7191c", "#0072b2"
"""Red and blue, as in the paper; this blue and this red differ in brightness too."""
INLIER, OUTLIER, REST = "#e69f00", "#56b4e9", "#bdbdbd"
HEIGHT_COLOURS, VARIANCE_COLOURS, SLOPE_COLOURS, GRADIENT_COLOURS = (
    "viridis",
    "cividis",
    "RdBu_r",
    "inferno",
)
RULES: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.titlepad": 3.0,
    "axes.labelsize": 7.5,
    "axes.labelpad": 2.0,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "legend.fontsize": 7.0,
    "lines.linewidth": 1.2,
    "svg.hashsalt": "gpgrad",  # the same figure is the same file
}


class LineStyle(TypedDict):
    """The style of one method's line."""

    color: str
    linestyle: Literal["-", "--", "-.", ":"]
    linewidth: float


def colour_of(number: int) -> str:
    """The colour of a method or dataset; after the last colour follows the first again."""
    return COLOURS[number % len(COLOURS)]


def line_of(number: int, *, printed: bool = False) -> LineStyle:
    """The line style of a method; its dashes change when the colours are used up."""
    dashes = DASHES[(number if printed else number // len(COLOURS)) % len(DASHES)]
    first, others = (2.0, 1.1) if printed else (4.0, 1.6)
    width = others if number else first
    return {"color": colour_of(number), "linestyle": dashes, "linewidth": width}


def new_figure(
    width: float,
    height: float,
    title: str = "",
    *,
    layout: Literal["constrained", "compressed"] | None = "constrained",
) -> Figure:
    """Make a figure that draws itself without a screen, in inches of 110 pixels."""
    figure = Figure(figsize=(width, height), dpi=110, layout=layout)
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=13)
    return figure


def new_panels(titles: Sequence[str], height: float) -> tuple[Figure, list[Axes]]:
    """Make a printed figure of lettered panels of a height [inches], up to three in a row."""
    columns = min(3, len(titles))
    rows = -(-len(titles) // columns)
    figure = new_figure(COLUMN if columns == 1 else PAGE, rows * height + 0.4)
    panels = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for panel in panels[len(titles) :]:
        panel.set_axis_off()
    for k, (panel, title) in enumerate(zip(panels, titles, strict=False)):
        panel.set_title(title if len(titles) == 1 else f"{letter(k)} {title}")
    return figure, panels[: len(titles)]


@contextmanager
def in_print() -> Generator[None]:
    """Let figures that are drawn and saved in the block look the same on every machine."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(RULES)
        yield


def save_printed(figure: Figure, path: Path) -> None:
    """Save a figure as fine as print needs; the ending of the path chooses the format."""
    metadata = {"Date": None} if path.suffix == ".svg" else None
    figure.savefig(path, dpi=300, metadata=metadata)


def add_panel(
    figure: Figure,
    left: float,
    top: float,
    width: float,
    height: float,
    projection: Literal["3d"] | None = None,
) -> Axes:
    """Add a panel by the edges of its room, from the upper left corner of the figure [inches]."""
    full_width, full_height = figure.get_size_inches()
    low = 1 - (top + height) / full_height
    room = (left / full_width, low, width / full_width, height / full_height)
    return figure.add_axes(room, projection=projection)


def shape_of(*grids: Grid) -> float:
    """The height of a panel for grids, for a width of 1; not more than a page has room for."""
    sizes = np.array([[np.ptp(grid.y), np.ptp(grid.x)] for grid in grids]) + 1e-9
    return float(np.clip((sizes[:, 0] / sizes[:, 1]).max(), 0.4, 1.4))


def show_field(
    panel: Axes,
    grid: Grid,
    field: Float[NDArray[np.floating], "rows columns ..."],
    **options: Any,
) -> AxesImage:
    """Draw a field of a map in metres; ``options`` are those of `imshow`."""
    image = panel.imshow(
        field, origin="lower", extent=extent_of(grid), interpolation="nearest", **options
    )
    in_metres(panel)
    return image


def extent_of(grid: Grid) -> tuple[float, float, float, float]:
    """The outer edges of a grid: left, right, bottom and top [m]."""
    half = grid.resolution / 2
    x, y = grid.x, grid.y
    return float(x[0] - half), float(x[-1] + half), float(y[0] - half), float(y[-1] + half)


def in_metres(panel: Axes) -> None:
    """Label the axes of a panel that is seen from above, with one scale for both."""
    panel.set_aspect("equal")
    panel.set_xlabel("x [m]")
    panel.set_ylabel("y [m]")


def add_bar(image: ScalarMappable, panel: Axes, label: str) -> None:
    """Add a colour bar beside a panel, as high as it is."""
    figure = panel.get_figure()
    assert figure is not None
    bar = figure.colorbar(image, cax=panel.inset_axes((1.03, 0.0, 0.06, 1.0)))
    bar.set_label(label, fontsize=7.0)
    bar.ax.tick_params(labelsize=6.5, pad=1.5)


def letter(k: int) -> str:
    """The letter of a panel: (a), (b) …; after (z) comes (aa).

    >>> letter(0), letter(25), letter(26)
    ('(a)', '(z)', '(aa)')
    """
    name = ""
    k += 1
    while k:
        k, rest = divmod(k - 1, 26)
        name = chr(ord("a") + rest) + name
    return f"({name})"
