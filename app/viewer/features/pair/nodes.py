"""What the scene of a pair has beside the two surfaces: what joins, marks, measures and names them.

Each class makes its nodes once, and hides them while they have nothing to show.
"""

import threading
from typing import TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.charts import round_length
from app.viewer.features.pair.ground import Ground
from app.viewer.features.pair.verdict import headline_of
from app.viewer.scene.associations import (
    Dots,
    inlier_color,
    keypoint_dots,
    match_arc,
    match_lines,
    on_surface,
    outline,
    residuals,
)
from app.viewer.scene.colors import CHOSEN, INLIER, OUTLIER, PROBE, Rgb, faint
from app.viewer.scene.nodes import LinePoints, LinesNode, PointsNode, SubmapNode
from app.viewer.scene.placement import Box, Placement
from app.viewer.scene.probing import (
    Profile,
    Reading,
    Ruler,
    label_text,
    other_place,
    read,
    reading_of,
)
from app.viewer.server.host import Host
from app.viewer.session.state import ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.types import GradientMap

Painted: TypeAlias = tuple[
    Float[NDArray[np.float32], "n 3"], UInt8[NDArray[np.uint8], "n 3"], float
]
"""Points [m], their colours, and the side of one [m]."""
INLIER_WIDTH, OUTLIER_WIDTH = 1.2, 1.0
"""Of lines [pixels]."""


class AssociationNodes:
    """Nodes of the associations between two submaps."""

    def __init__(self, host: Host, root: str, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        """Prepare the nodes under a root node; those of (query, database) carry the keypoints."""
        self._nodes = nodes
        self._outlier_lines = LinesNode(host, f"{root}/matches/outliers", OUTLIER, OUTLIER_WIDTH)
        self._inlier_lines = LinesNode(host, f"{root}/matches/inliers", INLIER, INLIER_WIDTH)
        self._marks = Marks(host, root)

    def hide(self) -> None:
        """Hide all of them."""
        for node in self._nodes:
            node.keypoints.hide()
        self._inlier_lines.hide()
        self._outlier_lines.hide()
        self._marks.hide()

    def show_keypoints(self, ground: Ground, result: PairResult, scale: float) -> None:
        """Mark the keypoints that the swipe leaves to be seen, at a scale of the usual marks."""
        size = _mark_size(ground.state)
        submaps = ground.state.query, ground.state.database
        for index, node in enumerate(self._nodes):
            if not ground.state.options.keypoints:
                node.keypoints.hide()
                continue
            of_query = index == 0

            def make(of_query: bool = of_query, index: int = index) -> Dots:
                dots = keypoint_dots(result, of_query=of_query, lift=size / 2)
                kept = ground.sees(index, dots.points)
                return Dots(dots.points[kept] - submaps[index].centre, dots.kinds[kept])

            swiped = (ground.swipe_at, ground.placements[index])
            node.keypoints.show(
                (
                    result.query_features if of_query else result.database_features,
                    result.query_map if of_query else result.database_map,
                    result.matches,
                    result.registration,
                    None if ground.swipe_at is None else swiped,
                ),
                make,
                inliers=inlier_color(result),
                size=size,
                scale=scale,
            )

    def show_lines(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        """Join the associated keypoints of submaps that stand at these placements."""
        options, lift = state.options, _mark_size(state) / 2
        pointed = 1 <= state.match <= len(result.matches)
        for segments, inliers, wanted, color, thickness in (
            (self._inlier_lines, True, options.inlier_lines, inlier_color(result), INLIER_WIDTH),
            (self._outlier_lines, False, options.outlier_lines, OUTLIER, OUTLIER_WIDTH),
        ):
            # Beside one that is pointed at, all others step back.
            segments.restyle(faint(color) if pointed else color, thickness / (2 if pointed else 1))
            if not wanted:
                segments.hide()
                continue

            everything = options.all_lines

            def lines(inliers: bool = inliers, everything: bool = everything) -> LinePoints:
                return match_lines(
                    result,
                    at_query,
                    at_database,
                    inliers=inliers,
                    lift=lift,
                    everything=everything,
                )

            maps = result.query_map, result.database_map
            made_from = (result.matches, result.registration, *maps, at_query, at_database)
            segments.show((*made_from, lift, everything), lines)

    def show_alone(self, state: ViewState, gradient_map: GradientMap, placement: Placement) -> None:
        """Show what is left without a pair: the place that is pointed at."""
        self.hide()
        reading = reading_of(state, (gradient_map, gradient_map))
        self._marks.show_reading(reading, placement, _mark_size(state))

    def show_marks(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        """Show the association and the place that are pointed at."""
        size = _mark_size(state)
        self._marks.show_match(result, state.match, at_query, at_database, size)
        reading = reading_of(state, (result.query_map, result.database_map))
        of_query = state.probe is not None and state.probe.role == "query"
        self._marks.show_reading(reading, at_query if of_query else at_database, size)
        motion, other = result.registration.T_database_query, None
        # Registered, the same place of the other submap is the same place of the scene.
        if reading is not None and motion is not None and state.options.layout != "registered":
            x, y = other_place(motion, reading.x, reading.y, of_query=of_query)
            read_map = result.database_map if of_query else result.query_map
            other = read(read_map, x, y, state.params.features.max_std_ratio)
        self._marks.show_other(other, at_database if of_query else at_query, size)


def _mark_size(state: ViewState) -> float:
    """Give the size of a keypoint's mark [m]: small beside the submap, but seen."""
    return float(np.clip(0.006 * Box.of(state.database).size[:2].max(), 0.02, 5.0))


END_SIZE, PROBE_SIZE, MATCH_LIFT = 2.2, 1.6, 1.5
"""Of the marks, and how high an association is lifted out of the ground, in keypoints."""


class Marks:
    """Nodes that are moved to whatever is pointed at, and hidden while nothing is."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        self._line = LinesNode(host, f"{root}/match/line", CHOSEN, thickness=5.0)
        self._ends = PointsNode(host, f"{root}/match/ends", shape="circle")
        self._match_label = host.scene.add_label(
            f"{root}/match/label", "", anchor="bottom-center", visible=False
        )
        self._point = PointsNode(host, f"{root}/probe/point", shape="diamond")
        self._other = PointsNode(host, f"{root}/probe/other", shape="diamond")
        self._point_label = host.scene.add_label(
            f"{root}/probe/label", "", anchor="bottom-left", visible=False
        )

    def show_match(
        self,
        result: PairResult,
        number: int,
        at_query: Placement,
        at_database: Placement,
        size: float,
    ) -> None:
        """Show the association of a number from 1 boldly; none if there is none of that number."""
        if not 1 <= number <= len(result.matches):
            self.hide_match()
            return
        arc = match_arc(result, at_query, at_database, number - 1, MATCH_LIFT * size)
        place = (result, number, at_query, at_database)
        self._line.show(place, lambda: arc)
        ends = np.stack([arc[0, 0], arc[-1, 1]])
        self._ends.show(place, lambda: (ends, painted(CHOSEN, 2), END_SIZE * size))
        missed = residuals(result)
        text = f"association {number}"
        if missed is not None:
            kind = "inlier" if result.registration.inliers[number - 1] else "outlier"
            text += f": {kind}, residual {missed[number - 1]:.3f} m"
        _write(self._match_label, text, arc[len(arc) // 2, 0])

    def hide_match(self) -> None:
        """Point at no association."""
        self._line.hide()
        self._ends.hide()
        self._match_label.visible = False

    def hide(self) -> None:
        """Point at nothing."""
        self.hide_match()
        self._point.hide()
        self._other.hide()
        self._point_label.visible = False

    def show_reading(self, reading: Reading | None, placement: Placement, size: float) -> None:
        """Mark the place that is read in a submap's frame, with its values; None marks none."""
        if reading is None:
            self._point.hide()
            self._point_label.visible = False
            return
        there = _place_point(self._point, reading, placement, size)
        _write(self._point_label, label_text(reading), there[0])

    def show_other(self, reading: Reading | None, placement: Placement, size: float) -> None:
        """Mark the same place of the other submap; None marks none, as where it saw no ground."""
        if reading is None or not reading.trusted:
            self._other.hide()
        else:
            _place_point(self._other, reading, placement, size)


def _place_point(
    point: PointsNode, reading: Reading, placement: Placement, size: float
) -> Float[NDArray[np.float32], "1 3"]:
    spot = np.array([[reading.x, reading.y, reading.elevation + size / 2]])
    there = placement.apply(spot).astype(np.float32)
    point.show((reading, placement, size), lambda: (there, painted(PROBE, 1), PROBE_SIZE * size))
    return there


def painted(color: Rgb, count: int) -> UInt8[NDArray[np.uint8], "n 3"]:
    """Give the colours of points that all have one."""
    return np.tile(np.array(color, dtype=np.uint8), (count, 1))


def _write(label: viser.LabelHandle, text: str, place: Float[NDArray[np.floating], "3"]) -> None:
    """Show words at a place of the scene [m]."""
    x, y, z = (float(value) for value in place)
    label.text, label.position, label.visible = text, (x, y, z), True


BAR: Rgb = (120, 120, 120)  # seen on a light and on a dark page


class Annotations:
    """Nodes that say what the picture shows."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        scene = host.scene
        self._bar = LinesNode(host, f"{root}/scale/bar", BAR, thickness=4.0)
        # A label without a word would be a white bar.
        self._bar_label = scene.add_label(
            f"{root}/scale/label", "", anchor="top-center", visible=False
        )
        self._verdict = scene.add_label(
            f"{root}/verdict", "", anchor="top-center", font_screen_scale=1.3, visible=False
        )
        self._swipe = LinesNode(host, f"{root}/swipe", BAR, thickness=2.0)

    def hide_verdict(self) -> None:
        """Say nothing of the pair."""
        self._verdict.visible = False

    def show_verdict(self, result: PairResult, corners: Float[NDArray[np.float64], "k 3"]) -> None:
        """Write the verdict in front of the corners (k, 3) of both submaps [m]."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y, z = (low[0] + high[0]) / 2, low[1] - 0.08 * (high[1] - low[1]), corners[:, 2].mean()
        _write(self._verdict, headline_of(result, with_score=True), np.array([x, y, z]))

    def show_swipe(
        self, swipe_at: float | None, corners: Float[NDArray[np.float64], "k 3"]
    ) -> None:
        """Frame the upright plane at which one surface ends and the other begins."""
        if swipe_at is None:
            self._swipe.hide()
            return
        x = swipe_at
        (_, y0, z0), (_, y1, z1) = corners.min(axis=0), corners.max(axis=0)
        rise = 0.05 * (y1 - y0)  # above and below
        frame = [(x, y0, z0 - rise), (x, y1, z0 - rise), (x, y1, z1 + rise), (x, y0, z1 + rise)]
        self._swipe.show((*frame,), lambda: outline(np.array(frame)))

    def show_bar(self, box: Box, placement: Placement) -> None:
        """Draw the scale bar before a submap of that extent, where it stands."""
        length = round_length(0.4 * float(box.size[0]))
        corner = np.array([[box.low[0], box.low[1], box.center[2]]])
        start = placement.apply(corner)[0] - np.array([0.0, 0.04 * box.size[1], 0.0])
        end = start + np.array([length, 0.0, 0.0])

        def make() -> LinePoints:
            return np.stack([start, end])[None].astype(np.float32)

        self._bar.show((length, *start), make)
        _write(self._bar_label, f"{length:g} m", (start + end) / 2)


class RulerNodes:
    """A line on either submap, hidden where it saw no ground."""

    def __init__(self, host: Host, root: str) -> None:
        """Prepare the nodes under a root node; nothing is shown."""
        self._lines = tuple(
            LinesNode(host, f"{root}/ruler/{role}", PROBE, thickness=4.0)
            for role in ("query", "database")
        )
        self._label = host.scene.add_label(
            f"{root}/ruler/label", "", anchor="bottom-center", visible=False
        )

    def show(self, ruler: Ruler | None, ground: Ground) -> None:
        """Show a line where the submaps stand; None shows none."""
        self._label.visible = False
        for index, line in enumerate(self._lines):
            heights = None if ruler is None else (ruler.query, ruler.database)[index]
            if ruler is None or heights is None or not heights.is_known:
                line.hide()
                continue
            points = _on_ground(heights, ground, index)
            pieces = np.stack([points[:-1], points[1:]], axis=1)
            pieces = pieces[np.isfinite(pieces).all(axis=(1, 2))].astype(np.float32)
            line.show((ruler, ground.placements[index], ground.maps[index]), lambda p=pieces: p)
            seen = points[np.isfinite(points).all(axis=1)]
            _write(self._label, f"{ruler.length:.2f} m", seen[len(seen) // 2])


def _on_ground(heights: Profile, ground: Ground, index: int) -> Float[NDArray[np.float64], "n 3"]:
    """Give the places of a line in the scene [m]; NaN where no ground is known."""
    gradient_map = ground.maps[index]
    # Above squares that are drawn flat.
    points = on_surface(gradient_map, heights.xy, 0.4 * gradient_map.grid.resolution)
    points[~np.isfinite(heights.elevation)] = np.nan
    return ground.placements[index].apply(points)


PERIOD = 0.8
"""How long each is seen [s]."""


class Blinker:
    """Shows the query and the database in turn, from a thread of its own.

    A blink is one message of a few bytes; the surfaces stay in the browser.
    """

    def __init__(self, host: Host, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        """Prepare to show (query, database) in turn; `run` begins."""
        self._host = host
        self._nodes = nodes
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def on(self) -> bool:
        """Whether it blinks."""
        return self._thread is not None

    def run(self, *, on: bool) -> None:
        """Begin or end; both are visible when it ends."""
        if on == self.on:
            return
        if not on:
            self.close()
            with self._host.atomic():
                for node in self._nodes:
                    node.visible = True
            self._host.flush()
            return
        self._stop.clear()
        self._thread = threading.Thread(target=self._blink, name="blinker", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End, leaving the nodes as they are."""
        if self._thread is not None:
            self._stop.set()
            self._thread.join()
            self._thread = None

    def _blink(self) -> None:
        shown = 0
        while not self._stop.wait(PERIOD):
            with self._host.atomic():
                for index, node in enumerate(self._nodes):
                    node.visible = index == shown
            self._host.flush()
            shown = 1 - shown
