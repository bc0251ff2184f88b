"""The ruler's panel: a switch, the figures of the line, and the profile of heights along it."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from app.viewer.draw.colors import DATABASE, QUERY, Rgb, css
from app.viewer.draw.readout import significant_digits
from app.viewer.draw.ruler import Heights, Ruler
from app.viewer.host import Host
from app.viewer.widgets.actions import on_choice, on_press
from app.viewer.widgets.html import BUSY, FAINT, paragraph, table
from gpgrad_core.arrays import Array, NDArray

HOW = "Hold Shift and click two places. The profile shows the heights between them."
SECOND = "Hold Shift and click the second place."
NO_MOTION = "The two places lie on different submaps, and no motion was found that joins these."
WIDTH, HEIGHT = 288, 170
LEFT, RIGHT, TOP, BOTTOM = 44, 6, 8, 32
"""Margins of the profile [pixels]."""


class RulerPanel:
    """The switch, the figures and the profile; callbacks must be quick."""

    def __init__(
        self, host: Host, on_switch: Callable[[bool], None], on_clear: Callable[[], None]
    ) -> None:
        """Make the widgets in the current container.

        Args:
            host: Whose GUI they join.
            on_switch: Told whether clicks are to measure.
            on_clear: Called when the line is no longer wanted.
        """
        self._switch = host.gui.add_checkbox(
            "Ruler",
            initial_value=False,
            hint="While it is on, Shift and click measures between two places instead of reading "
            "one.",
        )
        self._card = host.gui.add_html("")
        self._clear = host.gui.add_button(
            "Clear the ruler", visible=False, hint="Removes the line from the surfaces."
        )

        on_choice(self._switch, on_switch)
        on_press(self._clear, on_clear)

    def wait_for(self, *, end: int | None) -> None:
        """Say which end comes next, 0 or 1; None says nothing, for the ruler is off."""
        said = "" if end is None else paragraph(SECOND if end else HOW, FAINT)
        self._card.content = said
        self._clear.visible = bool(end)

    def show(self, ruler: Ruler | None) -> None:
        """Show a line; None says that its ends cannot be joined."""
        self._clear.visible = True
        if ruler is None:
            self._card.content = paragraph(NO_MOTION, f"color:{BUSY}")
            return
        self._card.content = (
            f'<div data-testid="ruler" style="padding:.1em .75em .3em">'
            f"{table(ruler_rows(ruler))}{profile_svg(ruler)}</div>"
        )


def ruler_rows(ruler: Ruler) -> tuple[tuple[str, str], ...]:
    """Write the figures of a line as names and values."""
    rows = [("distance", f"{ruler.length:.3f} m, in the plane")]
    if not np.isfinite(ruler.rise):
        return (*rows, ("height difference", "unknown: one end is masked"))
    digits = significant_digits(ruler.rise_std)
    rows.append(("height difference", f"{ruler.rise:+z.{digits}f} ± {ruler.rise_std:.{digits}f} m"))
    if np.isfinite(ruler.slope):
        rows.append(("slope", f"{ruler.slope:+z.1f}°"))
    return tuple(rows)


def profile_svg(ruler: Ruler) -> str:
    """Draw the heights of both submaps along the line, each with a band of two deviations."""
    known: list[tuple[str, Rgb, Heights]] = [
        (name, color, heights)
        for name, color, heights in (
            ("query", QUERY, ruler.query),
            ("database", DATABASE, ruler.database),
        )
        if heights is not None and heights.is_known
    ]
    if not known or ruler.length <= 0:
        return paragraph("No ground is known along the line.", FAINT)
    low = min(float(np.nanmin(one.elevation - 2 * one.std)) for _, _, one in known)
    high = max(float(np.nanmax(one.elevation + 2 * one.std)) for _, _, one in known)
    room = 0.05 * max(high - low, 1e-3)
    low, high = low - room, high + room
    x = LEFT + ruler.along / ruler.length * (WIDTH - LEFT - RIGHT)

    def y_of(values: Float[Array, "*n"]) -> Float[Array, "*n"]:
        return TOP + (high - values) / (high - low) * (HEIGHT - TOP - BOTTOM)

    drawn: list[str] = []
    for _, color, heights in known:
        up, down = heights.elevation + 2 * heights.std, heights.elevation - 2 * heights.std
        for run in _runs(np.isfinite(heights.elevation)):
            band = np.concatenate(
                [
                    np.column_stack([x[run], y_of(up[run])]),
                    np.column_stack([x[run], y_of(down[run])])[::-1],
                ]
            )
            line = np.column_stack([x[run], y_of(heights.elevation[run])])
            drawn.append(
                f'<polygon points="{_points(band)}" fill="{css(color)}" opacity=".28"/>'
                f'<polyline points="{_points(line)}" fill="none" stroke="{css(color)}" '
                f'stroke-width="1.6"/>'
            )
    words = ", ".join(
        f"{name} {'known' if np.isfinite(one.elevation).all() else 'known in part'}"
        for name, _, one in known
    )
    legend = "".join(
        f'<span style="display:inline-block;width:1em;height:.25em;background:{css(color)};'
        f'margin:0 .35em .2em 0"></span>{name}&emsp;'
        for name, color, _ in known
    )
    return (
        f'<svg data-testid="profile" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="Heights along the line: {words}" '
        f'style="width:100%;font-size:10.5px;display:block;margin-top:.4em">'
        f"{_axes(ruler.length, low, high)}{''.join(drawn)}</svg>"
        f'<div style="font-size:.8em">{legend}'
        f'<span style="opacity:.8">bands: ± 2 standard deviations</span></div>'
    )


def _axes(length: float, low: float, high: float) -> str:
    """Draw the frame, the marks with their numbers, and what they mean."""
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    parts = [
        f'<path d="M{LEFT},{TOP}V{bottom}H{right}" fill="none" stroke="currentColor" opacity=".6"/>'
    ]
    for value in _marks(0.0, length):
        x = LEFT + value / length * (right - LEFT)
        parts.append(
            f'<path d="M{x:.1f},{bottom}v4" stroke="currentColor" opacity=".6"/>'
            f'<text x="{x:.1f}" y="{bottom + 14}" text-anchor="middle" fill="currentColor">'
            f"{value:g}</text>"
        )
    for value in _marks(low, high):
        y = TOP + (high - value) / (high - low) * (bottom - TOP)
        parts.append(
            f'<path d="M{LEFT},{y:.1f}H{right}" stroke="currentColor" opacity=".15"/>'
            f'<text x="{LEFT - 4}" y="{y + 3.5:.1f}" text-anchor="end" fill="currentColor">'
            f"{value:g}</text>"
        )
    middle = (TOP + bottom) / 2
    parts.append(
        f'<text x="{(LEFT + right) / 2}" y="{HEIGHT - 4}" text-anchor="middle" '
        f'fill="currentColor">distance [m]</text>'
        f'<text transform="translate(9,{middle}) rotate(-90)" text-anchor="middle" '
        f'fill="currentColor">height [m]</text>'
    )
    return "".join(parts)


def _marks(low: float, high: float) -> list[float]:
    """Choose three to eight round numbers within a range."""
    step = 10.0 ** np.floor(np.log10((high - low) / 3))
    step *= next((by for by in (5.0, 2.0) if (high - low) / (by * step) >= 3), 1.0)
    first = int(np.ceil(low / step))
    last = int(np.floor(high / step))
    return [float(f"{number * step:.6g}") for number in range(first, last + 1)]


def _runs(known: Bool[NDArray[np.bool_], "n"]) -> list[slice]:
    """Find the stretches without a gap."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _points(places: Float[Array, "n 2"]) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in places.tolist())
