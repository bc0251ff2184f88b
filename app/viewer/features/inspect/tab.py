"""The Inspect tab: values of a place, associations one by one, and the flat picture of the pair."""

from collections.abc import Callable

import msgspec
import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature
from app.viewer.features.inspect.flat_picture import MASKED, Image, draw_pane
from app.viewer.features.inspect.panel import SEEN, Key, MatchesPanel, ReadingPanel, RulerPanel
from app.viewer.features.work import message_of
from app.viewer.scene.associations import (
    MOST_LINES,
    count_kinds,
    describe_match,
    inlier_color,
    step_match,
)
from app.viewer.scene.colors import DATABASE, OUTLIER, QUERY, UNMATCHED, css
from app.viewer.scene.placement import z_offset_of
from app.viewer.scene.probing import Ray, Reading, Ruler, measure, read_both, significant_digits
from app.viewer.server.host import on_scene_click, pages
from app.viewer.session.jobs import Lane
from app.viewer.session.news import PairNews, PairShown, SubmapShown
from app.viewer.session.state import COMPARED, NEEDS_TWO, ROLES, Layer, Probe, ViewState, same_pair
from app.viewer.widgets.actions import on_choice, on_press
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import told_apart
from gpgrad_core.types import GradientMap

COMPARED_TITLES: dict[Layer, str] = {
    "difference": "The height of the query above the database, in the colours of the legend.",
    "agreement": "Where the heights speak for one terrain (blue), and where against it (red).",
}


class SeenMsg(msgspec.Struct):
    """Whether a page has the flat picture in view."""

    seen: bool


class InspectTab(Feature):
    """Shows what the session points at; the picture is drawn by a worker of its own.

    Attributes:
        seen_by: Numbers of the pages that have the flat picture in view.
    """

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
            desk.host,
            lambda number: desk.change(match=number),
            self.step,
            desk.numbers,
        )
        # Drawn after the scene, only the newest, and only while a page has it in view: the flat
        # picture must cost the 3D nothing.
        self.seen_by: set[int] = set()
        self._painter: Lane[PairShown, Image] = Lane(
            desk.jobs,
            lambda job, _: draw_pane(*job),
            self._on_drawn,
            lambda _, error: self.matches.failed(message_of(error)),
        )
        on_scene_click(desk.host, self.clicked, modifier="shift")
        desk.bridge.on_message(SEEN, SeenMsg, self._see)

    def on_pair_result(self, news: PairNews) -> None:
        """Follow what was found and what is pointed at."""
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
        if not self.seen_by.isdisjoint(pages(self._desk.host)):
            self._painter.submit(shown)
        self._show_reading(state, result)
        self.matches.show_match(state.match, *match_figures(state, result))

    def _show_submap(self, state: ViewState, gradient_map: GradientMap) -> None:
        """Read the one submap there is; of a pair shown before, nothing is left."""
        self._shown, self._ends = None, ()
        self._measure()
        self.matches.show_nothing(NEEDS_TWO)
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

    def _see(self, page: viser.ClientHandle, said: SeenMsg) -> None:
        """Draw the flat picture for a page that has it in view, and for no other."""
        if not said.seen:
            self.seen_by.discard(page.client_id)
            return
        self.seen_by.add(page.client_id)
        if self._shown is not None:
            self._painter.submit(self._shown)

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

    def _on_drawn(self, job: PairShown, image: Image, _seconds: float) -> None:
        host = self._desk.host
        with host.atomic():
            self.matches.show_picture(image, title_of(*job), key_of(*job))
        host.flush()

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


def title_of(state: ViewState, result: PairResult) -> str:
    """Say what the flat picture shows."""
    registered = state.options.layout == "registered"
    if not registered or result.registration.T_database_query is None:
        return (
            f"The gradient from above, light where the ground is steep: query {state.query_id}, "
            f"and below it database {state.database_id}."
        )
    if state.options.layer in COMPARED:
        return COMPARED_TITLES[state.options.layer]
    match state.options.compare:
        case "query" | "database" as role:
            return f"The gradient of the {role}, in the database's frame."
        case "swipe":
            return "The gradient of the query left of the line, and of the database right of it."
        case "both" | "blink":
            return "The gradients of both, laid onto each other. Where they agree, they look grey."


def key_of(state: ViewState, result: PairResult) -> Key:
    """Say what the colours of the flat picture mean, with counts."""
    options, registration = state.options, result.registration
    inliers, total = registration.num_inliers, len(result.matches)
    registered = options.layout == "registered" and registration.T_database_query is not None
    overlaid = registered and options.compare in ("both", "blink")
    key: list[tuple[str, str]] = []
    if registered and options.layer in COMPARED:
        key.append(("rgb(38,38,42)", "masked in one of the two maps"))
    elif overlaid:
        key += [(css(QUERY), "the query alone"), (css(DATABASE), "the database alone")]
    else:
        key.append((css(MASKED), "masked: no points nearby"))
    for color, count, kind, drawn in (
        (inlier_color(result), inliers, "inliers", options.inlier_lines),
        (OUTLIER, total - inliers, "outliers", options.outlier_lines),
    ):
        note = "" if drawn else " (lines are off)"
        if drawn and not options.all_lines and count > MOST_LINES:
            note = f" ({MOST_LINES} lines drawn)"
        key.append((css(color), f"{count:,} {kind}{note}"))
    if options.other_keypoints:
        alone = count_kinds(result)["unmatched"]
        key.append((css(UNMATCHED), f"{alone:,} keypoints without an association"))
    return tuple(key)
