"""The scene of a pair: two submaps, what joins them, and what is pointed at."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.draw.associations import inlier_color, keypoint_dots, match_lines, outline
from app.viewer.draw.cameras import set_start, set_view, top
from app.viewer.draw.colors import DATABASE, INLIER, OUTLIER, QUERY, Rgb, faint
from app.viewer.draw.layers import Scale
from app.viewer.draw.nodes import LinePoints, Segments, SubmapNode
from app.viewer.draw.picking import Ray
from app.viewer.draw.placement import (
    Camera,
    Extent,
    Placement,
    frame_camera,
    glide,
    place,
    z_offset_of,
)
from app.viewer.draw.surfels import make_surfels, stride_for
from app.viewer.host import Host, pages
from app.viewer.pair.blinker import Blinker
from app.viewer.pair.ground import ROLES, Difference, Ground, shown_roles
from app.viewer.pair.marks import Marks
from app.viewer.pair.readout import reading_of
from app.viewer.state import Probe, ViewState
from gpgrad_core.arrays import NDArray
from gpgrad_core.pipeline import PairResult
from gpgrad_core.types import Dataset, GradientMap, Registration, Submap

PAIR = "/pair"
"""Above all nodes of the pair, so that they come and go together."""
BAR: Rgb = (120, 120, 120)  # seen on a light and on a dark page
MAX_SURFELS = 200_000
"""Of one surface; a finer map is drawn at every second cell, or third, …"""
MAX_CLOUD_POINTS = 200_000
OUTDATED = "Out of date: "
SCALE_BAR_SHARE = 0.4
"""Longest length of the scale bar, as a share of the database's width."""
INLIER_WIDTH, OUTLIER_WIDTH = 1.2, 1.0
"""Of lines [pixels]."""
SWIPE_RISE = 0.05
"""How far the swipe's frame stands out above and below, as a share of the depth."""


@dataclass(frozen=True)
class Shown:
    """What a picture turned out to be, for the read-outs.

    Attributes:
        scale: Of the layer's colours; None while no surface is shown.
        registered: Whether the query was laid onto the database.
        num_surfels: Cells drawn.
        num_points: Cloud points drawn.
        ground: The maps as they are drawn.
    """

    scale: Scale | None
    registered: bool
    num_surfels: int
    num_points: int
    ground: Ground


@dataclass(frozen=True, eq=False)
class _Registered:
    """The registration last found, and for which pair."""

    dataset: Dataset
    query_id: str
    database_id: str
    registration: Registration

    def is_of(self, state: ViewState) -> bool:
        """Say whether a state shows that pair."""
        return (
            self.dataset is state.dataset
            and self.query_id == state.query_id
            and self.database_id == state.database_id
        )


@dataclass(frozen=True, eq=False)
class _Stage:
    """Where the submaps stand."""

    boxes: tuple[Extent, Extent]  # of (query, database)
    at_query: Placement
    at_database: Placement

    @property
    def corners(self) -> Float[NDArray[np.float64], "k 3"]:
        """Corners of both outlines in the scene [m]."""
        query, database = self.boxes
        return np.concatenate(
            [self.at_query.apply(query.corners), self.at_database.apply(database.corners)]
        )

    def swipe_at(self, share: float) -> float:
        """Turn a share of the width of both outlines into a place along the scene's x [m]."""
        low, high = self.corners[:, 0].min(), self.corners[:, 0].max()
        return float(low + share * (high - low))


class PairScene:
    """The two submaps, what joins them, and a scale bar."""

    def __init__(self, host: Host) -> None:
        """Make the nodes; nothing is shown until `show`."""
        self._host = host
        scene = host.scene
        scene.set_up_direction("+z")
        # Lit surfaces are not used, and an environment map would tint what is.
        scene.configure_environment_map(None)
        self._root = scene.add_frame(PAIR, show_axes=False)
        self._query = SubmapNode(host, PAIR, "query", QUERY, "right")
        self._database = SubmapNode(host, PAIR, "database", DATABASE, "left")
        self._outlier_lines = Segments(host, f"{PAIR}/matches/outliers", OUTLIER, OUTLIER_WIDTH)
        self._inlier_lines = Segments(host, f"{PAIR}/matches/inliers", INLIER, INLIER_WIDTH)
        self._bar = Segments(host, f"{PAIR}/scale/bar", BAR, thickness=4.0)
        self._bar_label = scene.add_label(f"{PAIR}/scale/label", "", anchor="top-center")
        self._verdict = scene.add_label(
            f"{PAIR}/verdict", "", anchor="top-center", font_screen_scale=1.3
        )
        self._swipe = Segments(host, f"{PAIR}/swipe", BAR, thickness=2.0)
        self._marks = Marks(host, PAIR)
        self._blinker = Blinker(host, (self._query, self._database))
        self._registered: _Registered | None = None
        self._lock = threading.Lock()  # two workers draw: the pair's, and the one that plays
        self._last: PairResult | None = None
        self._ground: Ground | None = None
        self._difference: Difference | None = None

    @property
    def visible(self) -> bool:
        """Whether the pair is to be seen; what is shown meanwhile is there when it is again."""
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    def show(self, state: ViewState, result: PairResult) -> Shown:
        """Show a pair as the state asks; one consistent change in the browser."""
        registration = result.registration
        self._registered = _Registered(
            state.dataset, state.query_id, state.database_id, registration
        )
        maps = result.query_map, result.database_map
        self._blinker.run(on=_is_registered(state, registration) and _blinks(state))
        with self._lock, self._host.atomic():
            self._last = result
            shown, stage = self._show_submaps(state, maps, registration)
            self._show_keypoints(shown.ground, result)
            self._show_lines(state, result, stage.at_query, stage.at_database)
            self._show_verdict(result, stage.corners)
            self._show_marks(state, result, stage.at_query, stage.at_database)
        self._host.flush()
        return shown

    def preview(self, state: ViewState, maps: tuple[GradientMap, GradientMap]) -> Shown:
        """Show the surfaces of (query, database) before it is known how they register.

        The motion last found for the pair goes on; so do its keypoints and lines, for a moment.
        Of another pair they go out of sight.
        """
        known = self._registered
        same_pair = self.knows_motion(state)
        registration = known.registration if known and same_pair else None
        self._blinker.run(on=_is_registered(state, registration) and _blinks(state))
        with self._lock, self._host.atomic():
            self._last = None
            shown, _ = self._show_submaps(state, maps, registration)
            if not same_pair:
                self._hide_associations()
        self._host.flush()
        return shown

    def gliding(self, state: ViewState, result: PairResult) -> Callable[[float], None] | None:
        """Give what moves the query from beside the database to where it registers.

        Args:
            state: As it was shown, in the registered layout.
            result: What was shown.

        Returns:
            A function of the share of the way in [0, 1], which does nothing once another picture
            has been shown; None where there is no motion.
        """
        motion = result.registration.T_database_query
        if motion is None:
            return None
        boxes = Extent.of(state.query), Extent.of(state.database)
        maps = result.query_map, result.database_map
        dz = z_offset_of(result.registration, maps, state.params.features.max_std_ratio)

        place_pair = self.placing(state, result)
        return lambda share: place_pair(*glide(*boxes, motion, dz, share))

    def placing(
        self, state: ViewState, result: PairResult
    ) -> Callable[[Placement, Placement], None]:
        """Give what puts query and database anywhere, without drawing them anew.

        It does nothing once another picture has been shown.

        Args:
            state: As it was shown.
            result: What was shown.
        """

        def put(at_query: Placement, at_database: Placement) -> None:
            with self._lock:
                if self._last is not result:
                    return
                with self._host.atomic():
                    self._query.move(at_query)
                    self._database.move(at_database)
                    self._show_lines(state, result, at_query, at_database)
                    self._show_marks(state, result, at_query, at_database)
            self._host.flush()

        return put

    def knows_motion(self, state: ViewState) -> bool:
        """Say whether the pair of a state is the one last shown with its registration."""
        return self._registered is not None and self._registered.is_of(state)

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place of a surface that a line of sight meets first, if it meets one."""
        return None if self._ground is None or not self.visible else self._ground.pick(ray)

    def close(self) -> None:
        """Stop blinking."""
        self._blinker.close()

    def _show_submaps(
        self,
        state: ViewState,
        maps: tuple[GradientMap, GradientMap],
        registration: Registration | None,
    ) -> tuple[Shown, "_Stage"]:
        options, ratio = state.options, state.params.features.max_std_ratio
        motion = None if registration is None else registration.T_database_query
        registered = _is_registered(state, registration)
        compared = options.layer == "difference"
        dz = 0.0
        if registration is not None and (registered or compared):
            dz = z_offset_of(registration, maps, ratio)
        difference = None
        if registration is not None and compared:
            difference = Difference.between(maps, registration, dz, ratio, self._difference)
            self._difference = difference
        boxes = Extent.of(state.query), Extent.of(state.database)
        stage = _Stage(boxes, *place(*boxes, options.layout, motion, dz))
        lift = dz if registered and options.layer == "elevation" else 0.0
        swipe_at = stage.swipe_at(options.swipe) if options.compare == "swipe" else None
        ground = self._ground = Ground.of(
            state,
            maps,
            (stage.at_query, stage.at_database),
            (lift, 0.0),
            difference,
            swipe_at if registered else None,
        )
        nodes = (self._query, self._database)
        for index, node in enumerate(nodes):
            submap, placement = (state.query, state.database)[index], ground.placements[index]
            node.move(placement)
            node.name(submap, boxes[index])
            if not self._blinker.on:
                node.visible = not registered or ROLES[index] in shown_roles(state)
            self._show_cloud(node, submap, state)
            self._show_surface(node, ground, index)
        self._show_bar(boxes[1], stage.at_database)
        self._show_swipe(ground, stage.corners)
        shown = Shown(
            ground.scale if options.surfaces else None,
            registered,
            sum(node.surface.num_points for node in nodes) if options.surfaces else 0,
            sum(node.cloud.num_points for node in nodes) if options.clouds else 0,
            ground,
        )
        return shown, stage

    def outdate(self) -> None:
        """Say in the picture that it is not what was asked for; the next one takes that back."""
        if self._verdict.text and not self._verdict.text.startswith(OUTDATED):
            self._verdict.text = OUTDATED + self._verdict.text

    def _hide_associations(self) -> None:
        for node in (self._query.keypoints, self._database.keypoints):
            node.hide()
        for segments in (self._inlier_lines, self._outlier_lines):
            segments.hide()
        self._marks.hide()
        self._verdict.text = ""

    def camera(self, state: ViewState) -> Camera:
        """Give the view that shows both submaps of a state side by side."""
        boxes = Extent.of(state.query), Extent.of(state.database)
        at_query, at_database = place(*boxes, "side by side", None, 0.0)
        return frame_camera(((boxes[0], at_query), (boxes[1], at_database)))

    def camera_above(self, state: ViewState) -> Camera:
        """Give the view from above of what is shown, y up as on a map."""
        placed = self._ground
        boxes = Extent.of(state.query), Extent.of(state.database)
        if placed is None:
            return self.camera(state)
        return top(frame_camera(tuple(zip(boxes, placed.placements, strict=True))))

    def start_camera(self, camera: Camera) -> None:
        """Set the view that new pages, and "reset view", begin with."""
        if isinstance(self._host, viser.ClientHandle):
            self.move_cameras(camera)  # the page is open already
            return
        set_start(self._host, camera)

    def move_cameras(self, camera: Camera) -> None:
        """Bring every open page to a view."""
        for page in pages(self._host).values():
            set_view(page, camera)

    def _show_surface(self, node: SubmapNode, ground: Ground, index: int) -> None:
        options = ground.state.options
        ratio = ground.state.params.features.max_std_ratio
        gradient_map, placement = ground.maps[index], ground.placements[index]
        offset, difference = ground.lifts[index], ground.difference
        if not options.surfaces:
            node.surface.hide()
            return

        def make() -> tuple[Any, Any, float]:
            surfels = make_surfels(
                gradient_map,
                ground.scale,
                layer=options.layer,
                max_std_ratio=ratio,
                untrusted=options.untrusted,
                hillshaded=options.hillshade,
                yaw=placement.yaw,
                offset=offset,
                stride=stride_for(gradient_map.grid.num_cells, MAX_SURFELS),
                values=None if difference is None else difference.fields[index],
                seen=ground.seen(index),
            )
            return surfels.positions, surfels.colors, surfels.size

        needs = (
            gradient_map,
            ground.scale,
            options.layer,
            ratio,
            options.untrusted,
            options.hillshade,
            placement.yaw,
            offset,
            difference,
            None if ground.swipe_at is None else (ground.swipe_at, placement),
        )
        node.surface.show(needs, make)

    def _show_cloud(self, node: SubmapNode, submap: Submap, state: ViewState) -> None:
        options = state.options
        if not options.clouds:
            node.cloud.hide()
            return

        def make() -> tuple[Any, Any, float]:
            stride = int(np.ceil(len(submap.points) / MAX_CLOUD_POINTS))
            points = submap.points[::stride].astype(np.float32)
            colors: UInt8[NDArray[np.uint8], "n 3"] = np.broadcast_to(
                np.array(node.color, dtype=np.uint8), points.shape
            ).copy()
            return points, colors, options.point_size

        node.cloud.show((submap, options.point_size), make)

    def _show_keypoints(self, ground: Ground, result: PairResult) -> None:
        size = _mark_size(ground.state)
        for index, node in enumerate((self._query, self._database)):
            if not ground.state.options.keypoints:
                node.keypoints.hide()
                continue
            of_query, placement = index == 0, ground.placements[index]

            def make(of_query: bool = of_query, index: int = index) -> tuple[Any, Any, float]:
                dots = keypoint_dots(result, of_query=of_query, lift=size / 2)
                kept = ground.sees(index, dots.points)
                return dots.points[kept], dots.colors[kept], size

            node.keypoints.show(
                (
                    result.query_features if of_query else result.database_features,
                    result.query_map if of_query else result.database_map,
                    result.matches,
                    result.registration,
                    result.closure.accepted,
                    size,
                    None if ground.swipe_at is None else (ground.swipe_at, placement),
                ),
                make,
            )

    def _show_lines(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
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

            def lines(inliers: bool = inliers) -> LinePoints:
                return match_lines(result, at_query, at_database, inliers=inliers, lift=lift)

            segments.show(
                (
                    result.matches,
                    result.registration,
                    result.query_map,
                    result.database_map,
                    at_query,
                    at_database,
                    lift,
                ),
                lines,
            )

    def _show_marks(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        size = _mark_size(state)
        self._marks.show_match(result, state.match, at_query, at_database, size)
        reading = reading_of(state, (result.query_map, result.database_map))
        of_query = state.probe is not None and state.probe.role == "query"
        self._marks.show_reading(reading, at_query if of_query else at_database, size)

    def _show_swipe(self, ground: Ground, corners: Float[NDArray[np.float64], "k 3"]) -> None:
        """Frame the upright plane at which one surface ends and the other begins."""
        if ground.swipe_at is None:
            self._swipe.hide()
            return
        x = ground.swipe_at
        (_, y0, z0), (_, y1, z1) = corners.min(axis=0), corners.max(axis=0)
        rise = SWIPE_RISE * (y1 - y0)
        frame = [(x, y0, z0 - rise), (x, y1, z0 - rise), (x, y1, z1 + rise), (x, y0, z1 + rise)]
        self._swipe.show((*frame,), lambda: outline(np.array(frame)))

    def _show_verdict(self, result: PairResult, corners: Float[NDArray[np.float64], "k 3"]) -> None:
        verdict = "Loop closure" if result.closure.accepted else "No loop closure"
        self._verdict.text = f"{verdict} · {result.registration.num_inliers} inliers"
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y, z = (low[0] + high[0]) / 2, low[1] - 0.08 * (high[1] - low[1]), corners[:, 2].mean()
        self._verdict.position = (float(x), float(y), float(z))

    def _show_bar(self, box: Extent, placement: Placement) -> None:
        length = round_length(SCALE_BAR_SHARE * float(box.size[0]))
        corner = np.array([[box.low[0], box.low[1], box.center[2]]])
        start = placement.apply(corner)[0] - np.array([0.0, 0.04 * box.size[1], 0.0])
        end = start + np.array([length, 0.0, 0.0])

        def make() -> LinePoints:
            return np.stack([start, end])[None].astype(np.float32)

        self._bar.show((length, *start), make)
        self._bar_label.text = f"{length:g} m"
        middle = (start + end) / 2
        self._bar_label.position = (float(middle[0]), float(middle[1]), float(middle[2]))


def _is_registered(state: ViewState, registration: Registration | None) -> bool:
    """Say whether the query is to be laid onto the database, and can be."""
    found = registration is not None and registration.T_database_query is not None
    return found and state.options.layout == "registered"


def _blinks(state: ViewState) -> bool:
    return state.options.compare == "blink"


def _mark_size(state: ViewState) -> float:
    """Give the size of a keypoint's mark [m]: small beside the submap, but seen."""
    return float(np.clip(0.006 * Extent.of(state.database).size[:2].max(), 0.02, 5.0))


def round_length(longest: float) -> float:
    """Give the longest of 1, 2, 5, 10, … [m] that is not longer.

    >>> round_length(4.7), round_length(0.3)
    (2.0, 0.2)
    """
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest))
