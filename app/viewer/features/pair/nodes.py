"""What the scene of a pair has beside the two surfaces: what joins, marks, measures and names them.

Each class makes its nodes once, and hides them while they have nothing to show.
"""

import threading

import numpy as np
from jaxtyping import Float

from app.viewer.charts import round_length
from app.viewer.features.pair.picture import INLIER_WIDTH, OUTLIER_WIDTH, Picture
from app.viewer.scene.associations import (
    Dots,
    describe_match,
    inlier_color,
    keypoint_dots,
    match_arc,
    match_lines,
    on_surface,
    outline,
    shown_kinds,
)
from app.viewer.scene.colors import CHOSEN, INLIER, OUTLIER, PROBE, Rgb, faint, for_lines
from app.viewer.scene.nodes import Node, SubmapNode, label_node, lines_node, points_node
from app.viewer.scene.placement import Placement
from app.viewer.scene.probing import Reading, Ruler, label_text
from app.viewer.server.host import Host
from app.viewer.session.state import ROLES
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult

END_SIZE, PROBE_SIZE, MATCH_LIFT = 2.2, 1.6, 1.5
"""Of the marks of what is pointed at, and how high an association is lifted out of the ground, in
keypoints."""


class AssociationNodes:
    """Nodes of the associations between two submaps, and of what is pointed at."""

    def __init__(self, host: Host, root: str, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        """Prepare the nodes under a root node; those of (query, database) carry the keypoints."""
        self._nodes = nodes
        self._outlier_lines = lines_node(host, f"{root}/matches/outliers", OUTLIER, OUTLIER_WIDTH)
        self._inlier_lines = lines_node(host, f"{root}/matches/inliers", INLIER, INLIER_WIDTH)
        self._line = lines_node(host, f"{root}/match/line", CHOSEN, thickness=5.0)
        self._ends = points_node(host, f"{root}/match/ends", shape="circle", colors=CHOSEN)
        self._match_label = label_node(host, f"{root}/match/label", "bottom-center")
        self._point, self._other = (
            points_node(host, f"{root}/probe/{name}", shape="diamond", colors=PROBE)
            for name in ("point", "other")
        )
        self._point_label = label_node(host, f"{root}/probe/label", "bottom-left")

    def hide(self) -> None:
        for part in (
            *(node.keypoints for node in self._nodes),
            self._inlier_lines,
            self._outlier_lines,
            self._line,
            self._ends,
            self._match_label,
            self._point,
            self._other,
            self._point_label,
        ):
            part.hide()

    def show_keypoints(self, picture: Picture, result: PairResult, scale: float) -> None:
        """Mark the keypoints that the swipe shows, at a scale of the usual marks."""
        state, size = picture.state, picture.mark_size
        kinds = shown_kinds(state.options)
        for index, (node, submap) in enumerate(zip(self._nodes, state.pair, strict=True)):
            if not kinds:
                node.keypoints.hide()
                continue

            def make(
                index: int = index, centre: Float[NDArray[np.float64], "3"] = submap.centre
            ) -> Dots:
                dots = keypoint_dots(result, index, lift=size / 2, shown=kinds)
                kept = picture.sees(index, dots.points)
                points = picture.placements[index].exaggerated(dots.points[kept] - centre)
                return Dots(points, dots.kinds[kept])

            swiped = picture.swipe_at, picture.placements[index]
            times = state.options.exaggeration
            found = result.features[index], result.maps[index], result.matches, result.registration
            node.keypoints.show(
                (*found, kinds, times, None if picture.swipe_at is None else swiped),
                make,
                inliers=inlier_color(result),
                size=size,
                scale=scale,
            )

    def show_lines(self, picture: Picture, result: PairResult) -> None:
        """Join the associated keypoints, and point at those that the state points at."""
        options, size, placements = picture.state.options, picture.mark_size, picture.placements
        pointed = 1 <= picture.state.match <= len(result.matches)
        for lines, inliers, wanted, color, thickness in (
            (self._inlier_lines, True, options.inlier_lines, inlier_color(result), INLIER_WIDTH),
            (self._outlier_lines, False, options.outlier_lines, OUTLIER, OUTLIER_WIDTH),
        ):
            # Beside one that is pointed at, all others step back.
            lines.style(
                colors=for_lines(faint(color) if pointed else color),
                thickness=thickness / (2 if pointed else 1),
            )
            if wanted:
                how = placements, inliers, size / 2, options.all_lines
                inputs = (result.matches, result.registration, *result.maps, *how)
                lines.show(inputs, lambda how=how: {"points": match_lines(result, *how)})
            else:
                lines.hide()
        self._show_match(picture, result, size)
        self.show_place(picture)

    def _show_match(self, picture: Picture, result: PairResult, size: float) -> None:
        index, placements = picture.state.match - 1, picture.placements
        if not 0 <= index < len(result.matches):
            for part in (self._line, self._ends, self._match_label):
                part.hide()
            return
        arc = match_arc(result, placements, index, MATCH_LIFT * size)
        self._line.put(points=arc)
        self._ends.put(points=np.stack([arc[0, 0], arc[-1, 1]]), point_size=END_SIZE * size)
        kind, missed = describe_match(result, index)
        text = f"association {index + 1}"
        if missed is not None:
            text += f": {kind}, residual {missed:.3f} m"
        self._match_label.put(text=text, position=arc[len(arc) // 2, 0])

    def show_place(self, picture: Picture) -> None:
        """Mark the place that the state points at, with its values, and the same of the other."""
        probe, size = picture.state.probe, picture.mark_size
        here = 0 if probe is None else ROLES.index(probe.role)
        readings = picture.readings(probe)
        reading, other = readings[here], readings[1 - here]
        if reading is None:
            for part in (self._point, self._point_label, self._other):
                part.hide()
            return
        there = _mark(self._point, reading, picture.placements[here], size)
        self._point_label.put(text=label_text(reading), position=there)
        # Registered, the same place of the other submap is the same place of the scene.
        if other is None or not other.trusted or picture.state.options.layout == "registered":
            self._other.hide()
        else:
            _mark(self._other, other, picture.placements[1 - here], size)


def _mark(
    point: Node, reading: Reading, placement: Placement, size: float
) -> Float[NDArray[np.float32], "3"]:
    """Draw a point where a place is read; returns that place of the scene [m]."""
    spot = np.array([[reading.x, reading.y, reading.elevation + size / 2]])
    there = placement.apply(spot).astype(np.float32)
    point.put(points=there, point_size=PROBE_SIZE * size)
    return there[0]


BAR: Rgb = (120, 120, 120)  # visible on a light and on a dark page


class Annotations:
    """Nodes that say what the picture shows."""

    def __init__(self, host: Host, root: str) -> None:
        self._bar = lines_node(host, f"{root}/scale/bar", BAR, thickness=4.0)
        self._bar_label = label_node(host, f"{root}/scale/label", "top-center")
        self._swipe = lines_node(host, f"{root}/swipe", BAR, thickness=2.0)

    def show_swipe(self, picture: Picture) -> None:
        """Frame the upright plane at which one surface ends and the other begins."""
        x = picture.swipe_at
        if x is None:
            self._swipe.hide()
            return
        corners = picture.corners
        (_, y0, z0), (_, y1, z1) = corners.min(axis=0), corners.max(axis=0)
        rise = 0.05 * (y1 - y0)  # above and below
        frame = [(x, y0, z0 - rise), (x, y1, z0 - rise), (x, y1, z1 + rise), (x, y0, z1 + rise)]
        self._swipe.put(points=outline(np.array(frame)))

    def show_bar(self, picture: Picture) -> None:
        """Draw the scale bar before the database, where it stands."""
        box, placement = picture.boxes[1], picture.placements[1]
        length = round_length(0.4 * float(box.size[0]))
        corner = np.array([[box.low[0], box.low[1], box.center[2]]])
        start = placement.apply(corner)[0] - np.array([0.0, 0.04 * box.size[1], 0.0])
        end = start + np.array([length, 0.0, 0.0])
        self._bar.put(points=np.stack([start, end])[None].astype(np.float32))
        self._bar_label.put(text=f"{length:g} m", position=(start + end) / 2)


class RulerNodes:
    """A line on either submap, hidden where it saw no ground."""

    def __init__(self, host: Host, root: str) -> None:
        self._lines = [
            lines_node(host, f"{root}/ruler/{role}", PROBE, thickness=4.0) for role in ROLES
        ]
        self._label = label_node(host, f"{root}/ruler/label", "bottom-center")

    def show(self, ruler: Ruler | None, picture: Picture) -> None:
        """Show a line where the submaps stand; None shows none."""
        self._label.hide()
        profiles = (None, None) if ruler is None else (ruler.query, ruler.database)
        for index, (line, heights) in enumerate(zip(self._lines, profiles, strict=True)):
            if ruler is None or heights is None or not heights.is_known:
                line.hide()
                continue
            gradient_map = picture.maps[index]
            # Above squares that are drawn flat.
            points = on_surface(gradient_map, heights.xy, 0.4 * gradient_map.grid.resolution)
            points = picture.placements[index].apply(points)
            seen = np.isfinite(heights.elevation)
            pieces = np.stack([points[:-1], points[1:]], axis=1)[seen[:-1] & seen[1:]]
            line.put(points=pieces.astype(np.float32))
            known = points[seen]
            self._label.put(text=f"{ruler.length:.2f} m", position=known[len(known) // 2])


PERIOD = 0.8
"""How long each is shown [s]."""


class Blinker:
    """Shows the query and the database in turn, from a thread of its own.

    A blink is one message of a few bytes; the surfaces stay in the browser.
    """

    def __init__(self, host: Host, nodes: tuple[SubmapNode, SubmapNode]) -> None:
        self._host = host
        self._nodes = nodes
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def on(self) -> bool:
        return self._thread is not None

    def run(self, *, on: bool) -> None:
        """Begin or end; both are visible when it ends."""
        if on == self.on:
            return
        if not on:
            self.close()
            self._show(True, True)
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
        query = True
        while not self._stop.wait(PERIOD):
            self._show(query, not query)
            query = not query

    def _show(self, *visible: bool) -> None:
        with self._host.atomic():
            for node, shown in zip(self._nodes, visible, strict=True):
                node.visible = shown
        self._host.flush()
