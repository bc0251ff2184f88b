"""How often each value of the shown layer occurs, drawn above its colour bar."""

from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Bool, Float

from app.viewer.scene.colors import UNTRUSTED_GREY, Rgb, css, lookup_table
from app.viewer.scene.layers import Scale
from gpgrad_core.arrays import NDArray

NUM_BINS = 50
WIDTH, HEIGHT = 100.0, 34.0
"""Of the picture, in its own units: the width stands for the whole colour bar."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """Cells by value, from the low end of the colours to the high one.

    Attributes:
        trusted: Cells that the mask lets pass; those beyond the ends count in the end bins, as
            they take the end colours.
        masked: Cells that it rejects, those within the ends only.
        num_masked: All cells that it rejects.
    """

    trusted: Float[NDArray[np.float64], "bins"]
    masked: Float[NDArray[np.float64], "bins"]
    num_masked: int

    @property
    def num_trusted(self) -> int:
        """Number of trusted cells."""
        return int(self.trusted.sum())


def count_values(
    fields: tuple[Float[NDArray[np.floating], "_rows _columns"], ...],
    trusted: tuple[Bool[NDArray[np.bool_], "_rows _columns"], ...],
    scale: Scale,
) -> Histogram:
    """Count the cells of all maps together.

    Args:
        fields: What each map shows; NaN counts nowhere.
        trusted: Which of its cells the mask lets pass.
        scale: What the colours mean.
    """
    passed, rejected = np.zeros(NUM_BINS), np.zeros(NUM_BINS)
    num_masked = 0
    span = max(scale.high - scale.low, 1e-12)
    for values, sure in zip(fields, trusted, strict=True):
        finite = np.isfinite(values)
        places = (values - scale.low) * (NUM_BINS / span)
        inside = places[finite & sure].clip(0, NUM_BINS - 1).astype(np.intp)
        passed += np.bincount(inside, minlength=NUM_BINS)
        outside = places[finite & ~sure]
        num_masked += len(outside)
        outside = outside[(outside >= 0) & (outside < NUM_BINS)].astype(np.intp)
        rejected += np.bincount(outside, minlength=NUM_BINS)
    return Histogram(passed, rejected, num_masked)


def histogram_svg(
    histogram: Histogram, scale: Scale, thresholds: tuple[tuple[float, Rgb | None], ...] = ()
) -> str:
    """Draw the bars in the colours of the legend, with masked cells in grey on top.

    Args:
        histogram: What to draw.
        scale: What the colours mean.
        thresholds: Values at which the mask stands on this layer, each with the colour of the
            submap that it holds for; None for the text's colour.

    Returns:
        A picture for a page, as wide as the colour bar that it stands upon.
    """
    # Where nothing was seen a map is level: one bin of masked cells would dwarf all others.
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
    return (
        f'<svg data-testid="histogram" role="img" aria-label="{escape(summary(histogram))}" '
        f'viewBox="0 0 {WIDTH:g} {HEIGHT:g}" preserveAspectRatio="none" '
        f'style="width:100%;height:44px;display:block;border-bottom:1px solid '
        f'rgba(128,128,128,.5)">'
        f"{''.join(bars)}{''.join(_line(scale, *mark) for mark in thresholds)}</svg>"
    )


def summary(histogram: Histogram) -> str:
    """Say in words how many cells there are and how many of them are masked."""
    total = histogram.num_trusted + histogram.num_masked
    if total == 0:
        return "No cell has a value."
    share = 100 * histogram.num_masked / total
    return f"{histogram.num_trusted:,} cells; {share:.0f} % masked"


def _line(scale: Scale, value: float, color: Rgb | None) -> str:
    if not scale.low <= value <= scale.high or scale.high <= scale.low:
        return ""
    x = WIDTH * (value - scale.low) / (scale.high - scale.low)
    stroke = "currentColor" if color is None else css(color)
    return (
        f'<path data-testid="mask-threshold" d="M{x:.2f} 0V{HEIGHT:g}" stroke="{stroke}" '
        f'stroke-width="2" stroke-dasharray="4 2" vector-effect="non-scaling-stroke"/>'
    )
