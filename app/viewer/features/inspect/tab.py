"""The Inspect tab: values of a place, a ruler, and the associations one by one."""

from collections.abc import Callable

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.inspect.panel import MatchesPanel, ReadingPanel, RulerPanel
from app.viewer.scene.associations import describe_match, step_match
from app.viewer.scene.placement import z_offset_of
from app.viewer.scene.probing import Ray, Reading, Ruler, measure, read_both, significant_digits
from app.viewer.server.host import on_scene_click
from app.viewer.session.news import PairNews, PairShown, SubmapShown
from app.viewer.session.state import NEEDS_TWO, ROLES, Probe, ViewState, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import told_apart
from gpgrad_core.types import GradientMap


class InspectTab(Feature):
    """Shows what the session points at."""

    def __init__(
        self,
        desk: Desk,
        pick: Callable[[Ray], Probe | None],
        show_ruler: Callable[[Ruler | None], None],
    ) -> None:
        """Make the panels in the current container.

        ``pick`` finds the place of a surface that a line of sight meets first, and ``show_ruler``
        shows a measured line in the scene, or none.
        """
        self._desk = desk
        self._pick = pick
        self._show_ruler = show_ruler
        self._measuring = self._ruled = False
        self._ends: tuple[Probe, ...] = ()
        self._shown: PairShown | None = None
        self.reading = ReadingPanel(desk.host)
        on_press(self.reading.clear_button, lambda: desk.change(probe=None))
        self._ruler = RulerPanel(desk.host)
        on_choice(self._ruler.switch, self._switch_ruler)
        on_press(self._ruler.clear_button, self._clear_ruler)
        self.matches = MatchesPanel(
            desk.host, lambda number: desk.change(match=number), self.step, desk.numbers
        )
        on_scene_click(desk.host, self.clicked, modifier="shift")

    def on_pair_result(self, news: PairNews) -> None:
        """Show the result, and what is pointed at."""
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
        self._show_reading(state, result)
        self.matches.show_match(state.match, *match_figures(state, result))

    def _show_submap(self, state: ViewState, gradient_map: GradientMap) -> None:
        """Read the one submap there is; of a pair shown before, nothing is left."""
        self._shown, self._ends = None, ()
        self._measure()
        self.matches.show_match(0, "", (), why=NEEDS_TWO)
        ratio = state.params.features.max_std_ratio
        reading, _ = read_both((gradient_map, gradient_map), state.probe, None, ratio)
        self.reading.show(f"submap {state.query_id}", reading)

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
            self.reading.nothing_there()
        elif self._measuring:
            self._ends = (*self._ends, probe) if len(self._ends) == 1 else (probe,)
            self._measure()
        else:
            self._desk.change(probe=probe)

    # The ruler.

    def _switch_ruler(self, on: bool) -> None:
        self._measuring = on
        self._clear_ruler()

    def _clear_ruler(self) -> None:
        self._ends = ()
        self._measure()

    def _measure(self) -> None:
        """Measure between the ends that were clicked, and show the line."""
        shown, ends = self._shown, self._ends
        if shown is None or len(ends) < 2:
            if self._ruled:
                self._show_ruler(None)
            self._ruled = False
            self._ruler.wait_for(end=len(ends) if self._measuring else None)
            return
        self._ruled = True
        state, result = shown
        registration, ratio = result.registration, state.params.features.max_std_ratio
        z_offset = z_offset_of(registration, result.maps, ratio)
        line = ends[0], ends[1]
        ruler = measure(result.maps, line, registration.T_database_query, z_offset, ratio)
        self._show_ruler(ruler)
        self._ruler.show(ruler)

    def _show_reading(self, state: ViewState, result: PairResult) -> None:
        probe, ratio = state.probe, state.params.features.max_std_ratio
        if probe is None:
            self.reading.clear()
            return
        motion = result.registration.T_database_query
        readings = read_both(result.maps, probe, motion, ratio)
        index = ROLES.index(probe.role)
        rows = () if motion is None else _difference(result, readings, ratio)
        submap_id = (state.query_id, state.database_id)[index]
        self.reading.show(f"{probe.role} {submap_id}", readings[index], rows)


def _difference(
    result: PairResult, readings: tuple[Reading | None, Reading | None], ratio: float
) -> tuple[tuple[str, str], ...]:
    """Compare a place with the same one in the other submap."""
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
