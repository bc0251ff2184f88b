"""What a parameter does to the verdict: the pair registered at many of its values, as a picture."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from app.viewer.widgets.bridge import say
from app.viewer.widgets.html import BAD, FAINT, GOOD, QUIET
from gpgrad_core.params.bounds import DECADES_FROM
from gpgrad_core.params.fields import Field, with_unit

NUM_VALUES = 15
WIDTH, LEFT, RIGHT = 300.0, 34.0, 10.0
SCORES, BETWEEN, INLIERS, BELOW = 84.0, 30.0, 34.0, 26.0
"""Heights of the scores, of the gap, of the inliers, and of the axis below them."""
LEAST_HIGH = 6.0
"""The axis of the score goes as far at least: twice the default threshold."""


@dataclass(frozen=True)
class Tried:
    """What was found at one value.

    Attributes:
        value: Of the parameter.
        score: Of the pair there.
        num_inliers: Number of inliers there.
        accepted: Whether the pair is a loop closure there.
    """

    value: float
    score: float
    num_inliers: int
    accepted: bool


def values_of(field: Field, current: float | None) -> tuple[float, ...]:
    """Choose the values to try, over the range of the parameter's slider.

    Args:
        field: The parameter; it must have bounds.
        current: Its value now, which is among them; None if it is automatic.
    """
    bounds = field.bounds
    assert bounds is not None
    low, high = bounds.slider_range
    if current is not None:
        low, high = min(low, current), max(high, current)
    low = max(low, bounds.step) if low == 0 and high > DECADES_FROM * bounds.step else low
    spaced = np.geomspace if low > 0 and high >= DECADES_FROM * low else np.linspace
    chosen = {bounds.round(float(value)) for value in spaced(low, high, NUM_VALUES)}
    chosen = {min(max(value, bounds.low), bounds.high) for value in chosen}
    return tuple(sorted(chosen | ({current} if current is not None else set())))


def summary(tried: Sequence[Tried], unit: str) -> str:
    """Say in a line where the pair is a loop closure, and where the score is highest."""
    best = max(tried, key=lambda one: one.score)
    highest = f"The highest score is {best.score:.1f}, at {best.value:g} {unit}".rstrip() + "."
    runs: list[list[float]] = []
    for before, one in zip((None, *tried), tried, strict=False):
        if one.accepted:
            if before is not None and before.accepted:
                runs[-1].append(one.value)
            else:
                runs.append([one.value])
    if not runs:
        return f"No value makes it a loop closure. {highest}"
    if len(runs) == 1 and len(runs[0]) == len(tried):
        return f"It is a loop closure at every value. {highest}"
    parts = " and ".join(
        f"{run[0]:g} to {run[-1]:g}" if len(run) > 1 else f"{run[0]:g}" for run in runs
    )
    return f"It is a loop closure at {parts} {unit}".rstrip() + f". {highest}"


def sweep_html(
    field: Field,
    name: str,
    tried: Sequence[Tried],
    *,
    current: float | None,
    threshold: float,
    num_left: int = 0,
    stale: bool = False,
) -> str:
    """Draw score and inliers over the values of a parameter; a click on a value sets it.

    Args:
        field: The parameter.
        name: What people call it.
        tried: What was found, by value; not empty.
        current: Where the slider stands; None if it is not on this axis.
        threshold: The lowest score of a loop closure.
        num_left: Number of values that are still to be tried.
        stale: Whether other parameters, or the pair, have changed since.
    """
    unit = "" if field.bounds is None else field.bounds.unit
    axis = _Axis.over([one.value for one in tried])
    high = max(LEAST_HIGH, *(one.score for one in tried)) * 1.05
    most = max(1, *(one.num_inliers for one in tried))

    def score_y(score: float) -> float:
        return SCORES * (1 - min(score, high) / high) + 6

    top = SCORES + BETWEEN
    points = " ".join(f"{axis(one.value):.1f},{score_y(one.score):.1f}" for one in tried)
    drawn = [
        f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{score_y(threshold):.1f}" '
        f'y2="{score_y(threshold):.1f}" stroke="currentColor" stroke-dasharray="4 3"/>',
        f'<text x="{WIDTH - RIGHT}" y="{score_y(threshold) - 3:.1f}" text-anchor="end">threshold '
        f"{threshold:.1f}</text>",
        f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="1.2" '
        'opacity=".6"/>',
        *(_label(LEFT - 4, score_y(value) + 3, f"{value:.0f}") for value in (0, high / 1.05)),
        _label(LEFT - 4, top + 9, f"{most}"),
        _label(LEFT - 4, top + INLIERS, "0"),
        f'<text x="{LEFT}" y="{top - 3}">inliers</text><text x="{LEFT}" y="9">score</text>',
        f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{top + INLIERS}" y2="{top + INLIERS}" '
        'stroke="currentColor" opacity=".5"/>',
    ]
    if current is not None:
        x = axis(current)
        drawn.append(
            f'<line data-testid="sweep-now" x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{top + INLIERS}" '
            'stroke="#1f77c8" stroke-width="2"/>'
        )
    width = (WIDTH - LEFT - RIGHT) / max(len(tried), 2)
    for one in tried:
        x, y, bar = axis(one.value), score_y(one.score), INLIERS * one.num_inliers / most
        color = GOOD if one.accepted else BAD
        # Filled or hollow too, for eyes that do not tell the two colours apart.
        look = f'style="fill:{color if one.accepted else "none"};stroke:{color}"'
        said = (
            f"{name} {one.value:g} {unit}".rstrip()
            + f": score {one.score:.1f}, {one.num_inliers} inliers, "
            + ("loop closure" if one.accepted else "no loop closure")
        )
        drawn.append(
            f'<g style="cursor:pointer" onclick="{say("sweep-value", value=one.value)}">'
            f"<title>{escape(said)}. Click to set it.</title>"
            f'<rect x="{x - width / 2:.1f}" y="0" width="{width:.1f}" height="{top + INLIERS}" '
            'fill="transparent"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.6" stroke-width="1.6" {look}/>'
            f'<rect x="{x - 3:.1f}" y="{top + INLIERS - bar:.1f}" width="6" height="{bar:.1f}" '
            f'style="fill:{color}"/></g>'
        )
    foot = top + INLIERS + 12
    ends = (tried[0].value, tried[len(tried) // 2].value, tried[-1].value)
    drawn += [
        f'<text x="{axis(value):.1f}" y="{foot}" text-anchor="{anchor}">{value:g}</text>'
        for value, anchor in zip(ends, ("start", "middle", "end"), strict=True)
    ]
    drawn.append(
        f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{foot + 12}" text-anchor="middle">'
        f"{escape(with_unit(name, field.bounds))}</text>"
    )
    words = summary(tried, unit)
    if num_left:  # what holds at some values need not hold at all
        words = f"{len(tried)} of {len(tried) + num_left} values so far."
    note = "Something else has changed since. Sweep again." if stale else words
    dim = f";{FAINT}" if stale else ""
    return (
        f'<div data-testid="sweep" style="padding:.1em .75em{dim}">'
        f'<svg viewBox="0 0 {WIDTH} {top + INLIERS + BELOW}" role="img" '
        f'aria-label="{escape(f"Score and inliers over {name}. {words}")}" '
        f'style="width:100%;display:block;font-size:10px;fill:currentColor">{"".join(drawn)}</svg>'
        f'<div role="status" style="font-size:.8em;line-height:1.4;min-height:2.8em;'
        f'color:{QUIET}">{escape(note)}</div></div>'
    )


@dataclass(frozen=True)
class _Axis:
    """Places of values on the picture, evenly or in their logarithm."""

    low: float
    high: float
    decades: bool

    @classmethod
    def over(cls, values: Sequence[float]) -> "_Axis":
        low, high = values[0], values[-1]
        return cls(low, high, low > 0 and high >= DECADES_FROM * low)

    def __call__(self, value: float) -> float:
        low, high = self.low, self.high
        if self.decades:
            low, high, value = np.log([low, high, max(value, low)])
        share = (value - low) / max(high - low, 1e-12)
        return float(LEFT + 8 + min(max(share, 0.0), 1.0) * (WIDTH - LEFT - RIGHT - 16))


def _label(x: float, y: float, text: str) -> str:
    return f'<text x="{x}" y="{y:.1f}" text-anchor="end">{text}</text>'
