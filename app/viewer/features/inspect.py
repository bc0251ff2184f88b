"""The Inspect tab: values of a place, a ruler, and the associations one by one."""

from collections.abc import Callable
from html import escape

import numpy as np
import viser
from jaxtyping import Bool, Float

from app.viewer.charts import Axis, frame, points_of, svg
from app.viewer.features.desk import Desk, Feature
from app.viewer.scene.associations import describe_match, step_match
from app.viewer.scene.colors import DATABASE, QUERY, Rgb, css
from app.viewer.scene.placement import z_offset_of
from app.viewer.scene.probing import (
    Profile,
    Ray,
    Reading,
    Ruler,
    measure,
    read_both,
    significant_digits,
)
from app.viewer.server.host import on_scene_click
from app.viewer.session.news import PairNews, PairShown, SubmapShown
from app.viewer.session.state import NEEDS_TWO, ROLES, Probe, ViewState, same_pair
from app.viewer.widgets.actions import on_choice, on_option, on_press
from app.viewer.widgets.html import BUSY, FAINT, figures, paragraph
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import told_apart
from gpgrad_core.params import Bounds
from gpgrad_core.types import GradientMap

HOW_TO_READ = "Click a surface to keep its values; click the mark to let go."
NO_MATCH = "Choose an association by its number, or with the keys N and P."
NO_MOTION = "The two places lie on different submaps, and no motion was found that joins these."
MASKED = "The variance mask rejects this place: there are no points near."
ENDS = (
    "Hold Shift and click two places. The profile shows the heights between them.",
    "Hold Shift and click the second place.",
)
"""What the ruler waits for, by the number of places that were clicked."""
WIDTH, HEIGHT = 288, 170
LEFT, RIGHT, TOP, BOTTOM = 44, 6, 8, 32
"""Margins of the profile [pixels]."""


class InspectTab(Feature):
    """Shows what the session points at."""

    def __init__(
        self,
        desk: Desk,
        pick: Callable[[Ray], Probe | None],
        show_ruler: Callable[[Ruler | None], None],
    ) -> None:
        """Make the widgets in the current container.

        ``pick`` finds the place of a surface that a line of sight meets first, and ``show_ruler``
        shows a measured line in the scene, or none.
        """
        self._desk, self._pick, self._show_ruler = desk, pick, show_ruler
        self._measuring = self._ruled = False
        self._ends: tuple[Probe, ...] = ()
        self._shown: PairShown | None = None
        gui = desk.host.gui
        self._reading = gui.add_html("")
        self._clear = gui.add_button("Clear the reading", hint="Removes the mark from the surface.")
        self._show_reading(None)
        ruler = gui.add_checkbox(
            "Ruler",
            initial_value=False,
            hint="While it is on, Shift and click measures between two places instead of reading "
            "one.",
        )
        self._ruler = gui.add_html("")
        self._clear_ruler = gui.add_button(
            "Clear the ruler", visible=False, hint="Removes the line from the surfaces."
        )
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
        self._match = gui.add_html(paragraph(NO_MATCH, FAINT))
        on_press(self._clear, lambda: desk.change(probe=None))
        on_choice(ruler, self._switch_ruler)
        on_press(self._clear_ruler, lambda: self._set_ends(()))
        on_choice(self._number, self._choose)
        # There are fewer, and one that there is not is none.
        desk.numbers.add(self._number, Bounds(0, 1_000_000, 1), self._choose)
        acts = {"previous": -1, "next": 1}
        on_option(steps, lambda label: self.step(acts[label]) if label in acts else self._choose(0))
        on_scene_click(desk.host, self.clicked, modifier="shift")

    def on_pair_result(self, news: PairNews) -> None:
        if isinstance(news, PairShown):
            self._show_pair(news)
        elif isinstance(news, SubmapShown):
            self._show_submap(*news)

    def _show_pair(self, shown: PairShown) -> None:
        state, result = shown
        before, self._shown = self._shown, shown
        if before is not None and not same_pair(before[0], state):
            self._ends = ()
        if self._ends or self._ruled:
            self._measure()
        self._read_pair(state, result)
        self._show_match(state.match, *match_figures(state, result))

    def _show_submap(self, state: ViewState, gradient_map: GradientMap) -> None:
        """Read the one submap there is; of a pair shown before, nothing is left."""
        self._shown = None
        self._set_ends(())
        self._show_match(0, "", (), why=NEEDS_TWO)
        ratio = state.params.features.max_std_ratio
        reading, _ = read_both((gradient_map, gradient_map), state.probe, None, ratio)
        self._show_reading(reading, f"submap {state.query_id}")

    def _show_match(
        self, number: int, title: str, rows: tuple[tuple[str, str], ...], why: str = NO_MATCH
    ) -> None:
        """Show the figures of an association; without rows, why none is pointed at."""
        self._number.value = number if rows else 0
        self._match.content = (
            figures("match", rows, _title(title)) if rows else paragraph(why, FAINT)
        )

    def _choose(self, number: float) -> None:
        self._desk.change(match=int(number))

    def step(self, step: int) -> None:
        """Point at the next (1) or the previous (-1) association of those that are shown."""
        if self._shown is None:
            return
        state, result = self._shown
        options = state.options
        number = step_match(
            result,
            state.match,
            step,
            inliers=options.inlier_lines,
            outliers=options.outlier_lines,
        )
        self._desk.change(match=number)

    def clicked(self, event: viser.SceneClickEvent) -> None:
        """Read the place of a surface that was clicked on; from one of viser's threads."""
        ray = Ray(np.array(event.ray_origin), np.array(event.ray_direction))
        probe = self._pick(ray)
        if probe is None:
            self._show_reading(None)
            nothing = f"There is no surface. {HOW_TO_READ}"
            self._reading.content = paragraph(nothing, f"color:{BUSY}")
        elif self._measuring:
            self._set_ends((*self._ends, probe) if len(self._ends) == 1 else (probe,))
        else:
            self._desk.change(probe=probe)

    # The ruler.

    def _switch_ruler(self, on: bool) -> None:
        self._measuring = on
        self._set_ends(())

    def _set_ends(self, ends: tuple[Probe, ...]) -> None:
        self._ends = ends
        self._measure()

    def _measure(self) -> None:
        """Measure between the ends that were clicked, and show the line."""
        shown, ends = self._shown, self._ends
        if shown is None or len(ends) < 2:
            if self._ruled:
                self._show_ruler(None)
            self._ruled = False
            waits = paragraph(ENDS[min(len(ends), 1)], FAINT)
            self._ruler.content = waits if self._measuring else ""
            self._clear_ruler.visible = self._measuring and bool(ends)
            return
        self._ruled = self._clear_ruler.visible = True
        state, result = shown
        registration, ratio = result.registration, state.params.features.max_std_ratio
        z_offset = z_offset_of(registration, result.maps, ratio)
        line = ends[0], ends[1]
        ruler = measure(result.maps, line, registration.T_database_query, z_offset, ratio)
        self._show_ruler(ruler)
        self._ruler.content = (
            paragraph(NO_MOTION, f"color:{BUSY}")
            if ruler is None
            else figures("ruler", ruler_rows(ruler), below=profile_svg(ruler))
        )

    # Readings.

    def _read_pair(self, state: ViewState, result: PairResult) -> None:
        probe, ratio = state.probe, state.params.features.max_std_ratio
        if probe is None:
            self._show_reading(None)
            return
        motion = result.registration.T_database_query
        readings = read_both(result.maps, probe, motion, ratio)
        index = ROLES.index(probe.role)
        rows = () if motion is None else _difference(result, readings, ratio)
        submap_id = (state.query_id, state.database_id)[index]
        self._show_reading(readings[index], f"{probe.role} {submap_id}", rows)

    def _show_reading(
        self, reading: Reading | None, title: str = "", more: tuple[tuple[str, str], ...] = ()
    ) -> None:
        """Show the values of a place, whose surface it is and more rows; None says how to read."""
        self._clear.visible = reading is not None
        if reading is None:
            self._reading.content = paragraph(HOW_TO_READ, FAINT)
            return
        warning = f'<div style="color:{BUSY};font-size:.8em">{MASKED}</div>'
        lead = _title(title) + ("" if reading.trusted else warning)
        self._reading.content = figures("reading", reading_rows(reading) + more, lead)


def _title(text: str) -> str:
    return f'<div style="font-size:.85em;font-weight:600">{escape(text)}</div>'


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
    edges = np.flatnonzero(np.diff(np.concatenate([[0], finite.astype(int), [0]])))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _difference(
    result: PairResult, readings: tuple[Reading | None, Reading | None], ratio: float
) -> tuple[tuple[str, str], ...]:
    query, database = readings
    if query is None or database is None or not (query.trusted and database.trusted):
        return (("query minus database", "unknown: only one of them saw this place"),)
    offset = z_offset_of(result.registration, result.maps, ratio)
    difference = query.elevation + offset - database.elevation
    std = float(np.hypot(query.std, database.std))
    digits = significant_digits(std)
    return (("query minus database", f"{difference:+z.{digits}f} ± {std:.{digits}f} m"),)


def match_figures(state: ViewState, result: PairResult) -> tuple[str, tuple[tuple[str, str], ...]]:
    """Write the figures of the association that the state points at, if any: a title, and rows."""
    index, matches = state.match - 1, result.matches
    if not 0 <= index < len(matches):
        return "", ()
    kind, missed = describe_match(result, index)
    distance = float(matches.distances[index])
    rank = int(np.sum(matches.distances < distance)) + 1
    residual = "unknown: no motion was found"
    if missed is not None:
        allowed = state.params.registration.radius(result.registration.scale)
        most, has = told_apart(allowed, missed, "g", ".3f")
        residual = f"{has} m (at most {most} m for an inlier)"
    return f"Association {state.match} of {len(matches):,}: {kind}", (
        ("descriptor distance", f"{distance:.3f} (rank {rank})"),
        ("residual", residual),
        ("in the query", _position(matches.query_xy[index])),
        ("in the database", _position(matches.database_xy[index])),
    )


def _position(xy: Float[Array, "2"]) -> str:
    return f"x {xy[0]:+z.2f} m, y {xy[1]:+z.2f} m"
