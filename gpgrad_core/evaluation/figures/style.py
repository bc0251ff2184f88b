"""The style that all figures share."""

from typing import TypedDict

from jaxtyping import Bool
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.judge import MethodVerdict
from gpgrad_core.evaluation.rules import Labels

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8C6D31")
DASHES = ("-", "--", "-.", ":")
TRUE, FALSE, GREY, MISSED = "#009E73", "#D7191C", "#E69F00", "#0072B2"


class Style(TypedDict):
    """The style of one method's line in every figure."""

    color: str
    linestyle: str
    linewidth: float


def style_of(number: int) -> Style:
    """Give each method a colour, and different dashes when the colours are used up.

    The first method's line is wider, so that it can be seen below another.
    """
    dashes = DASHES[number // len(COLOURS) % len(DASHES)]
    return {
        "color": COLOURS[number % len(COLOURS)],
        "linestyle": dashes,
        "linewidth": 4.0 if number == 0 else 1.6,
    }


def new_figure(width: float, height: float, title: str, *, squares: bool = False) -> Figure:
    """Make an empty figure that draws itself without a screen.

    Args:
        width: Width [inches of 110 pixels].
        height: Height [inches of 110 pixels].
        title: Title above all panels.
        squares: Whether the panels keep their shape; they are then moved close together.
    """
    layout = "compressed" if squares else "constrained"
    figure = Figure(figsize=(width, height), dpi=110, layout=layout)
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13)
    return figure


def verdicts(method: MethodVerdict, labels: Labels) -> tuple[tuple[str, Bool[Mask, "p"], str], ...]:
    """List the verdicts as (name, which pairs, colour); the gravest is last, drawn on top."""
    accepted = method.ranking.accepted
    return (
        ("true, missed", labels.positive & ~accepted, MISSED),
        ("accepted, grey", accepted & labels.grey, GREY),
        ("accepted, true", accepted & labels.positive, TRUE),
        ("accepted, FALSE", accepted & labels.negative, FALSE),
    )
