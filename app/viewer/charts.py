"""Charts as SVG, and pictures for pages: axes, round numbers, texts, lines and PNG addresses."""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from math import floor, log10

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from gpgrad_core.arrays import Array, NDArray


@dataclass(frozen=True)
class Axis:
    """Where values lie on a chart: evenly between two places."""

    low: float  # the value at the start
    high: float  # the value at the end
    start: float  # place of the low end, in the chart's units
    end: float  # place of the high end; it may lie before the start, as on an axis that points up

    def __call__(self, value: float) -> float:
        """The place of a value; those beyond the ends lie at the ends."""
        return float(self.places(np.array([float(value)]))[0])

    def places(self, values: Float[Array, "n"]) -> Float[NDArray[np.float64], "n"]:
        low, high = self.low, self.high
        values = np.clip(values, min(low, high), max(low, high))
        shares = (values - low) / max(high - low, 1e-12)
        return self.start + shares * (self.end - self.start)


def round_step(least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20, … that is not smaller.

    >>> round_step(0.3), round_step(3), round_step(60)
    (1, 5, 100)
    """
    scale = 10 ** max(floor(log10(max(least, 1.0))), 0)
    return next(step * scale for step in (1, 2, 5, 10) if step * scale >= least)


def round_length(longest: float) -> float:
    """The largest of 1, 2, 5, 10, … and of 0.5, 0.2, 0.1, … that is not larger.

    >>> round_length(4.7), round_length(0.3), round_length(0.3 / 3)
    (2.0, 0.2, 0.1)
    """
    power, most = 10.0 ** np.floor(np.log10(longest)), (1 + 1e-9) * longest
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most))


def round_marks(low: float, high: float) -> list[float]:
    """Choose three to eight round numbers within a range.

    >>> round_marks(0.0, 4.0)
    [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    step = round_length(max(high - low, 1e-9) / 3)
    first, last = int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6))
    return [float(f"{number * step:.6g}") for number in range(first, last + 1)]


def text(x: float, y: float, words: str, anchor: str = "start") -> str:
    """Write words whose start, middle or end is at a place of a chart."""
    where = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{_short(x)}" y="{_short(y)}"{where}>{escape(words)}</text>'


def upright_text(x: float, y: float, words: str, anchor: str = "middle") -> str:
    """Write words from below upwards."""
    where = f"translate({_short(x)} {_short(y)}) rotate(-90)"
    return f'<text transform="{where}" text-anchor="{anchor}">{escape(words)}</text>'


def grid_line(path: str, opacity: float = 0.5) -> str:
    """Draw a thin line of the page's own colour, which steps back from what the chart shows."""
    return f'<path d="{path}" fill="none" stroke="currentColor" stroke-opacity="{opacity:g}"/>'


def frame(across: Axis, up: Axis, across_name: str, up_name: str) -> str:
    """Draw both axes with round numbers, faint lines from those at the left, and their names."""
    left, right, bottom, top = across.start, across.end, up.start, up.end
    drawn = [grid_line(f"M{left:g} {top:g}V{bottom:g}H{right:g}", 0.6)]
    for value in round_marks(across.low, across.high):
        drawn.append(grid_line(f"M{across(value):.1f} {bottom:g}v4", 0.6))
        drawn.append(text(across(value), bottom + 14, f"{value:g}", "middle"))
    for value in round_marks(up.low, up.high):
        drawn.append(grid_line(f"M{left:g} {up(value):.1f}H{right:g}", 0.15))
        drawn.append(text(left - 4, up(value) + 3.5, f"{value:g}", "end"))
    drawn.append(text((left + right) / 2, bottom + 26, across_name, "middle"))
    return "".join(drawn) + upright_text(9, (top + bottom) / 2, up_name)


def svg(drawn: Iterable[str], width: float, height: float, label: str) -> str:
    """Write a picture as wide as its panel, which screen readers call by its label."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" '
        f'aria-label="{escape(label)}" style="width:100%;display:block;font-size:10px;'
        f'fill:currentColor">{"".join(drawn)}</svg>'
    )


def points_of(places: Iterable[Sequence[float]]) -> str:
    """Write places as the ``points`` of a line.

    >>> points_of([(1.0, 2.25), (3.0, 4.0)])
    '1,2.2 3,4'
    """
    return " ".join(f"{_short(x)},{_short(y)}" for x, y in places)


def png_uri(pixels: UInt8[NDArray[np.uint8], "rows columns channels"]) -> str:
    """Write a picture, RGB or RGBA, as a ``data:`` address of a PNG."""
    order = [2, 1, 0, 3][: pixels.shape[-1]]
    _, png = cv2.imencode(".png", np.ascontiguousarray(pixels[..., order]))
    return "data:image/png;base64," + base64.b64encode(png.tobytes()).decode("ascii")


def _short(number: float) -> str:
    return f"{round(number, 1):g}"
