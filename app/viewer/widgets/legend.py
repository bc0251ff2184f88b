"""The legend: what the colours of the picture mean."""

from html import escape

from app.viewer.scene.colors import legend_uri
from app.viewer.scene.layers import Scale
from app.viewer.widgets.html import QUIET


def legend_html(scale: Scale | None, *, histogram: str = "", note: str = "") -> str:
    """Write the legend: name and unit, histogram, bar, values at its ends and middle, note.

    Args:
        scale: Of the colours; None where nothing is coloured, which has no legend.
        histogram: Picture of how often each value occurs, as HTML.
        note: A line about it.
    """
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
        f'<div data-testid="legend" style="padding:.1em .75em .3em;font-size:.8em">'
        f"<b>{escape(scale.label)}</b> [{escape(scale.unit)}]{histogram}"
        f'<img src="{legend_uri(scale.color_map)}" alt="colour bar" style="width:100%;height:12px;'
        f'display:block;border-radius:2px;margin:.15em 0">'
        f'<div style="display:flex;justify-content:space-between;'
        f'font-variant-numeric:tabular-nums"><span>{low_text}</span><span>{middle}</span>'
        f"<span>{high_text}</span></div>{below}</div>"
    )


def _exponent(span: float) -> int:
    """Power of ten of a span; of an empty one, that of a millimetre."""
    return int(f"{max(abs(span), 1e-3):e}".partition("e")[2])
