"""The legend: what the colours of the picture mean, and how often each value occurs."""

from collections.abc import Mapping
from html import escape

from app.viewer.charts import Axis, round_marks
from app.viewer.scene.associations import Kind, mark_of
from app.viewer.scene.colors import UNTRUSTED_GREY, Rgb, css, legend_uri, lookup_table
from app.viewer.scene.layers import NUM_BINS, Histogram, Scale
from app.viewer.session.state import ROLES
from app.viewer.widgets.html import QUIET

WIDTH, HEIGHT = 100.0, 34.0
"""Of the picture, in its own units: the width stands for the whole colour bar."""


def legend_html(scale: Scale | None, *, histogram: str = "", note: str = "") -> str:
    """Write name and unit, histogram, bar, values at its ends and middle, note; empty for None."""
    if scale is None:
        return ""
    low, high = scale.low, scale.high
    exponent = _exponent(high - low)
    digits = max(0, min(4, (2 if exponent >= 0 else 1) - exponent))
    low_text, middle, high_text = (f"{value:.{digits}f}" for value in (low, (low + high) / 2, high))
    # In a place of two lines, so that what stands below it keeps its place as the note grows.
    below = (
        f'<div style="color:{QUIET};line-height:1.35;height:2.7em;overflow:hidden" '
        f'title="{escape(note)}">{escape(note)}</div>'
        if note
        else ""
    )
    return (
        f'<div data-testid="legend" style="padding:.1em .75em .3em;font-size:12px">'
        f"<b>{escape(scale.label)}</b> [{escape(scale.unit)}]{histogram}"
        f'<img src="{legend_uri(scale.bars)}" alt="colour bar" style="width:100%;height:12px;'
        f'display:block;border-radius:2px;margin:.15em 0">'
        f'<div style="display:flex;justify-content:space-between;'
        f'font-variant-numeric:tabular-nums"><span>{low_text}</span><span>{middle}</span>'
        f"<span>{high_text}</span></div>{below}</div>"
    )


KIND_NAMES: tuple[tuple[Kind, str], ...] = (
    ("inlier", "inliers"),
    ("outlier", "outliers"),
    ("unmatched", "without a partner"),
)


def marks_legend(counts: Mapping[Kind, int], inliers: Rgb) -> str:
    """Write what the marks of keypoints mean, each with its number; inliers have that colour."""
    parts = "".join(
        f'<span style="white-space:nowrap;margin:0 .5em">{mark_svg(kind, inliers)} '
        f"{counts[kind]:,} {name}</span>"
        for kind, name in KIND_NAMES
        if kind in counts
    )
    return f'<div data-testid="marks-legend" style="margin-bottom:2px">{parts}</div>'


def mark_svg(kind: Kind, inliers: Rgb) -> str:
    """Draw the mark of a keypoint as the scene has it."""
    mark = mark_of(kind, inliers)
    # A legend has the page's ground, in which a rim of the same light would vanish.
    edge = 'stroke="currentColor" stroke-opacity=".5" stroke-width=".6"'
    discs = (
        f'<circle r="{mark.rim_width / 2:g}" fill="{css(mark.rim)}" {edge}/>'
        f'<circle r="{mark.core_width / 2:g}" fill="{css(mark.core)}"/>'
    )
    return (
        '<svg aria-hidden="true" width="1em" height="1em" viewBox="-6 -6 12 12" '
        f'style="vertical-align:-1px">{discs}</svg>'
    )


def canvas_legend(scale: Scale | None, note: str, width: str = "21.7em") -> str:
    """Write the colour bar on the canvas, of a width in CSS: name, unit and ticks, and a note."""
    if scale is None:
        return ""
    along = Axis(scale.low, scale.high, 0.0, 100.0)
    ticks = "".join(
        f'<span style="position:absolute;left:{along(value):.2f}%;'
        f'transform:translateX(-50%)"><span style="display:block;width:1px;height:4px;'
        f'margin:0 auto;background:currentColor"></span>{value:g}</span>'
        for value in round_marks(scale.low, scale.high)
    )
    name = f"{scale.label} [{scale.unit}]" if scale.unit else scale.label
    name_line = escape(name)
    if scale.tints:
        squares = "&ensp;".join(
            f'<span style="white-space:nowrap"><i style="color:{css(tint)}">■</i> {role}</span>'
            for tint, role in zip(scale.tints, ROLES, strict=True)
        )
        name_line = f"{escape(name)}&ensp;{squares}"
    below = f'<div data-remark style="opacity:.85">{escape(note)}</div>' if note else ""
    return (
        f'<div>{name_line}</div><div style="width:{width};'
        f'max-width:min(45vw,100%,var(--bar,100%));margin:2px auto 0">'
        f'<img src="{legend_uri(scale.bars)}" alt="colour bar" style="width:100%;height:.92em;'
        f'display:block;border-radius:2px"><div style="position:relative;height:1.6em;'
        f'font-variant-numeric:tabular-nums">{ticks}</div></div>{below}'
    )


def _exponent(span: float) -> int:
    """Power of ten of a span; of an empty one, that of a millimetre."""
    return int(f"{max(abs(span), 1e-3):e}".partition("e")[2])


def histogram_svg(
    histogram: Histogram,
    scale: Scale,
    thresholds: tuple[tuple[float, Rgb | None], ...] = (),
    picked: tuple[float, float] | None = None,
) -> str:
    """Draw the bars in the colours of the legend, with masked cells in grey on top.

    The thresholds are values at which the mask stands on this layer, each with the colour of the
    submap that it holds for, or None for the text's. `histogram.js` lets a hand pick values out.
    The picture is as wide as the colour bar that it stands upon.
    """
    # Without points a map is level: one bin of masked cells would dwarf all others.
    tallest = histogram.trusted if histogram.num_trusted else histogram.masked
    highest = max(float(tallest.max()), 1.0)
    table = lookup_table(scale.color_map).tolist()
    step = WIDTH / NUM_BINS
    bars: list[str] = []
    for k in range(NUM_BINS):
        red, green, blue = table[int((k + 0.5) * 256 / NUM_BINS)]
        lower = HEIGHT * float(histogram.trusted[k]) / highest
        upper = min(HEIGHT * float(histogram.masked[k]) / highest, HEIGHT - lower)
        for height, top, fill in (
            (lower, HEIGHT - lower, css((red, green, blue))),
            (upper, HEIGHT - lower - upper, css(UNTRUSTED_GREY)),
        ):
            if height > 0:
                bars.append(
                    f'<rect x="{k * step:.2f}" y="{top:.2f}" width="{step:.2f}" '
                    f'height="{height:.2f}" fill="{fill}"/>'
                )
    lines = "".join(_line(scale, *mark) for mark in thresholds)
    return (
        f'<svg data-testid="histogram" role="img" aria-label="{escape(summary(histogram))}" '
        f'viewBox="0 0 {WIDTH:g} {HEIGHT:g}" preserveAspectRatio="none" '
        f'style="width:100%;height:44px;display:block;cursor:crosshair;border-bottom:1px solid '
        f'rgba(128,128,128,.5)"><title>Drag over values to pick out their cells.</title>'
        f"{''.join(bars)}{_band(scale, picked)}{lines}</svg>"
    )


def summary(histogram: Histogram) -> str:
    """How many cells there are and how many of them are masked, in words."""
    total = histogram.num_trusted + histogram.num_masked
    if total == 0:
        return "No cell has a value."
    share = 100 * histogram.num_masked / total
    return f"{histogram.num_trusted:,} cells; {share:.0f} % masked"


def _band(scale: Scale, picked: tuple[float, float] | None) -> str:
    along = Axis(scale.low, scale.high, 0.0, WIDTH)
    x, end = map(along, picked or (scale.low, scale.low))
    return (
        f'<rect data-band x="{x:.2f}" width="{end - x:.2f}" height="{HEIGHT:g}" '
        f'fill="currentColor" opacity=".22"/>'
    )


def _line(scale: Scale, value: float, color: Rgb | None) -> str:
    if not scale.low <= value <= scale.high or scale.high <= scale.low:
        return ""
    x = Axis(scale.low, scale.high, 0.0, WIDTH)(value)
    stroke = "currentColor" if color is None else css(color)
    return (
        f'<path data-testid="mask-threshold" d="M{x:.2f} 0V{HEIGHT:g}" stroke="{stroke}" '
        f'stroke-width="2" stroke-dasharray="4 2" vector-effect="non-scaling-stroke"/>'
    )
