"""The tab Inspect: the values of a place, a ruler, and the associations."""

from collections.abc import Callable
from html import escape

import numpy as np
from jaxtyping import Bool

from app.viewer.charts import Axis, frame, points_of, svg
from app.viewer.scene.colors import DATABASE, QUERY, Rgb, css
from app.viewer.scene.probing import Profile, Reading, Ruler, significant_digits
from app.viewer.server.host import Host
from app.viewer.widgets.actions import on_choice, on_option
from app.viewer.widgets.html import BUSY, FAINT, paragraph, table
from app.viewer.widgets.numbers import Numbers
from gpgrad_core.arrays import NDArray
from gpgrad_core.params import Bounds

HOW_TO_READ = "Click a surface to keep its values; click the mark to let go."
NO_MATCH = "Choose an association by its number, or with the keys N and P."
WIDTH, HEIGHT = 288, 170
LEFT, RIGHT, TOP, BOTTOM = 44, 6, 8, 32
"""Margins of the profile [pixels]."""


class ReadingPanel:
    """A card of the values of a place, and a button that clears it."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container."""
        self.card = host.gui.add_html("")
        self.clear_button = host.gui.add_button(
            "Clear the reading", hint="Removes the mark from the surface."
        )
        self.clear()

    def show(
        self, title: str, reading: Reading | None, more: tuple[tuple[str, str], ...] = ()
    ) -> None:
        """Show whose surface it is, its values there and more rows; None shows how it is read."""
        if reading is None:
            self.clear()
            return
        warning = (
            ""
            if reading.trusted
            else f'<div style="color:{BUSY};font-size:.8em">The variance mask rejects this place: '
            "there are no points near.</div>"
        )
        self.card.content = _card("reading", title, warning + table(reading_rows(reading) + more))
        self.clear_button.visible = True

    def nothing_there(self) -> None:
        """Report that a click met no surface."""
        self.clear()
        self.card.content = paragraph(f"There is no surface. {HOW_TO_READ}", f"color:{BUSY}")

    def clear(self) -> None:
        """Show how a place is read."""
        self.card.content = paragraph(HOW_TO_READ, FAINT)
        self.clear_button.visible = False


def reading_rows(reading: Reading) -> tuple[tuple[str, str], ...]:
    """Write a reading as names and values."""
    digits = significant_digits(reading.std)
    aspect = "level" if reading.aspect is None else f"falls towards {reading.aspect:.0f}°"
    return (
        ("x, y", f"{reading.x:z.3f} m, {reading.y:z.3f} m"),
        ("elevation", f"{reading.elevation:z.{digits}f} ± {reading.std:.{digits}f} m"),
        ("slope", f"{reading.slope:.1f}°"),
        ("aspect", f"{aspect}" + ("" if reading.aspect is None else " (from +y, clockwise)")),
    )


def _card(test_id: str, title: str, content: str) -> str:
    """Write HTML that is safe below a title."""
    return (
        f'<div data-testid="{test_id}" style="padding:.1em .75em .3em">'
        f'<div style="font-size:.85em;font-weight:600">{escape(title)}</div>{content}</div>'
    )


class RulerPanel:
    """The ruler: its switch, the figures of a line, and the profile of heights along it."""

    def __init__(self, host: Host) -> None:
        """Make the widgets in the current container."""
        self.switch = host.gui.add_checkbox(
            "Ruler",
            initial_value=False,
            hint="While it is on, Shift and click measures between two places instead of reading "
            "one.",
        )
        self._card = host.gui.add_html("")
        self.clear_button = host.gui.add_button(
            "Clear the ruler", visible=False, hint="Removes the line from the surfaces."
        )

    def wait_for(self, *, end: int | None) -> None:
        """Show which end comes next, 0 or 1; None shows nothing, for the ruler is off."""
        said = (
            "Hold Shift and click the second place."
            if end
            else "Hold Shift and click two places. The profile shows the heights between them."
        )
        self._card.content = "" if end is None else paragraph(said, FAINT)
        self.clear_button.visible = bool(end)

    def show(self, ruler: Ruler | None) -> None:
        """Show a line; None says that its ends cannot be joined."""
        self.clear_button.visible = True
        if ruler is None:
            self._card.content = paragraph(
                "The two places lie on different submaps, and no motion was found that joins "
                "these.",
                f"color:{BUSY}",
            )
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
    """Draw the heights of both submaps along the line, with bands of one and two deviations."""
    lines: list[tuple[str, Rgb, Profile]] = [
        (name, color, heights)
        for name, color, heights in (
            ("query", QUERY, ruler.query),
            ("database", DATABASE, ruler.database),
        )
        if heights is not None and heights.is_known
    ]
    if not lines or ruler.length <= 0:
        return paragraph("No ground is known along the line.", FAINT)
    low = min(float(np.nanmin(heights.elevation - 2 * heights.std)) for _, _, heights in lines)
    high = max(float(np.nanmax(heights.elevation + 2 * heights.std)) for _, _, heights in lines)
    room = 0.05 * max(high - low, 1e-3)
    across = Axis(0.0, ruler.length, LEFT, WIDTH - RIGHT)
    upward = Axis(low - room, high + room, HEIGHT - BOTTOM, TOP)
    x = across.places(ruler.along)
    drawn: list[str] = []
    for _, color, heights in lines:
        widest, wide, line, low_wide, lowest = (
            np.column_stack([x, upward.places(heights.elevation + deviations * heights.std)])
            for deviations in (2, 1, 0, -1, -2)
        )
        for run in _runs(np.isfinite(heights.elevation)):
            drawn += [
                f'<polygon points="{points_of([*up[run].tolist(), *down[run][::-1].tolist()])}" '
                f'fill="{css(color)}" opacity=".18"/>'
                for up, down in ((widest, lowest), (wide, low_wide))
            ]
            drawn.append(
                f'<polyline points="{points_of(line[run].tolist())}" fill="none" '
                f'stroke="{css(color)}" stroke-width="1.6"/>'
            )
    words = ", ".join(
        f"{name} {'known' if np.isfinite(heights.elevation).all() else 'known in part'}"
        for name, _, heights in lines
    )
    legend = "".join(
        f'<span style="display:inline-block;width:1em;height:.25em;background:{css(color)};'
        f'margin:0 .35em .2em 0"></span>{name}&emsp;'
        for name, color, _ in lines
    )
    drawn.insert(0, frame(across, upward, "distance [m]", "height [m]"))
    picture = svg(drawn, WIDTH, HEIGHT, f"Heights along the line: {words}")
    return (
        f'<div data-testid="profile">{picture}</div><div style="font-size:.8em">{legend}'
        f'<span style="opacity:.8">bands: ± 1 and 2 standard deviations</span></div>'
    )


def _runs(finite: Bool[NDArray[np.bool_], "n"]) -> list[slice]:
    """Find the stretches without a gap."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], finite.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


class MatchesPanel:
    """Number box, steps and figures; callbacks must be quick."""

    def __init__(
        self,
        host: Host,
        on_match: Callable[[int], None],
        on_step: Callable[[int], None],
        numbers: Numbers,
    ) -> None:
        """Add the widgets to the current container.

        They report the requested number, 0 for none, and a step, 1 for the next, -1 for the
        previous.
        """
        gui = host.gui
        self._number = gui.add_number(
            "Association",
            0,
            min=0,
            step=1,
            hint="Number of an association, from 1; 0 chooses none.",
        )
        steps = gui.add_button_group(
            "Step association",
            ("previous", "next", "none"),
            hint="Steps through the associations of the kinds that have lines (keys P and N).",
        )
        self.figures = gui.add_html(paragraph(NO_MATCH, FAINT))
        on_choice(self._number, lambda number: on_match(int(number)))
        # There are fewer, and one that there is not is none.
        numbers.add(self._number, Bounds(0, 1_000_000, 1), lambda number: on_match(int(number)))
        on_option(
            steps,
            lambda label: on_match(0) if label == "none" else on_step(1 if label == "next" else -1),
        )

    def show_match(
        self, number: int, title: str, rows: tuple[tuple[str, str], ...], why: str = NO_MATCH
    ) -> None:
        """Show the figures of an association; without rows, why none is pointed at."""
        self._number.value = number if rows else 0
        self.figures.content = _card("match", title, table(rows)) if rows else paragraph(why, FAINT)
