"""The scene of a pair: two submaps, what joins them, and what is pointed at."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from app.viewer.features.pair.ground import (
    ROLES,
    Appearance,
    Ground,
    Paint,
    compare_maps,
    shown_roles,
)
from app.viewer.features.pair.nodes import (
    Annotations,
    AssociationNodes,
    Blinker,
    Painted,
    RulerNodes,
    painted,
)
from app.viewer.scene.cameras import DOWN
from app.viewer.scene.colors import DATABASE, OUTLIER, QUERY
from app.viewer.scene.layers import IDENTITY, OWN_LEVEL, Scale, make_surfels, stride_for
from app.viewer.scene.nodes import SubmapNode
from app.viewer.scene.placement import (
    UNKNOWN_CANVAS,
    Box,
    Canvas,
    HeightFrame,
    Placement,
    frame_camera,
    glide,
    level_of,
    place,
    z_offset_of,
)
from app.viewer.scene.probing import Ray, Ruler, other_place
from app.viewer.server.host import Host
from app.viewer.session.state import (
    COMPARED,
    FROM_ABOVE,
    Camera,
    Layout,
    Probe,
    ViewState,
    as_drawn,
    same_pair,
)
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.se2 import SE2
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Registration, Submap

PAIR = "/pair"
"""Above all nodes of the pair, so that they come and go together."""
MAX_SURFELS = 200_000
"""Of one surface; a finer map is drawn at every second cell, or third, …"""
MAX_CLOUD_POINTS = 200_000
"""Of one submap; of a larger cloud every second point is drawn, or third, …"""


@dataclass(frozen=True)
class Shown:
    """What the picture shows, for the read-outs.

    Attributes:
        scale: Of the layer's colours; None while no surface is shown.
        registered: Whether the query was laid onto the database.
        num_surfels: Cells drawn.
        num_points: Points of the clouds drawn.
        ground: The maps as they are drawn.
    """

    scale: Scale | None
    registered: bool
    num_surfels: int
    num_points: int
    ground: Ground


@dataclass(frozen=True, eq=False)
class PickContext:
    """What a cursor meets: the ground, and what was found on it, unless that is being made."""

    ground: Ground
    result: PairResult | None


@dataclass(frozen=True, eq=False)
class _Layout:
    """Where the submaps stand."""

    boxes: tuple[Box, Box]  # of (query, database)
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
    """The two submaps, and what joins them.

    Attributes:
        tall: Whether side by side means one behind the other, as fills a tall canvas.
        mark_scale: How large the marks of keypoints are, beside the usual ones.
    """

    def __init__(self, host: Host, *, standalone: bool = True) -> None:
        """Make the nodes; nothing is shown until `show`.

        Verdict and scale are part of a standalone scene, because nothing is written over it.
        """
        self.tall = False
        self.mark_scale = 1.0
        self._host = host
        self._standalone = standalone
        scene = host.scene
        scene.set_up_direction("+z")
        # Lit surfaces are not used, and an environment map would tint what is.
        scene.configure_environment_map(None)
        self._root = scene.add_frame(PAIR, show_axes=False)
        self._query = SubmapNode(host, PAIR, "query", QUERY, "left")
        self._database = SubmapNode(host, PAIR, "database", DATABASE, "right")
        self._annotations = Annotations(host, PAIR)
        self._associations = AssociationNodes(host, PAIR, (self._query, self._database))
        self._ruler = RulerNodes(host, PAIR)
        self._blinker = Blinker(host, (self._query, self._database))
        # The registration last found, and the state whose pair it is of.
        self._registered: tuple[ViewState, Registration] | None = None
        self._lock = threading.Lock()  # two workers draw: the pair's, and the one that plays
        self._last: PairResult | None = None
        self._ground: Ground | None = None
        self._compare = lru_cache(maxsize=1)(compare_maps)
        self._level_of = lru_cache(maxsize=2)(level_of)
        self._appearance = lru_cache(maxsize=1)(Appearance)
        self._paint = lru_cache(maxsize=1)(Paint)

    @property
    def visible(self) -> bool:
        """Whether the pair is visible; hidden, it is drawn all the same."""
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    def show(self, state: ViewState, result: PairResult) -> Shown:
        """Show a pair as the state asks; one consistent change in the browser."""
        registration = result.registration
        self._registered = state, registration
        maps = result.query_map, result.database_map
        self._blink(state, registration)
        with self._lock, self._host.atomic():
            self._last = result
            shown, layout = self._show_submaps(state, maps, registration)
            self._associations.show_keypoints(shown.ground, result, self.mark_scale)
            self._associations.show_lines(state, result, layout.at_query, layout.at_database)
            if self._standalone:
                self._annotations.show_verdict(result, layout.corners)
            self._associations.show_marks(state, result, layout.at_query, layout.at_database)
        self._host.flush()
        return shown

    def preview(self, state: ViewState, maps: tuple[GradientMap, GradientMap]) -> Shown:
        """Show the surfaces of (query, database) before it is known how they register.

        The motion last found for the pair goes on; so do its keypoints and lines, for a moment.
        Of another pair they go out of sight.
        """
        registration = self._known_registration(state)
        self._blink(state, registration)
        with self._lock, self._host.atomic():
            self._last = None
            shown, _ = self._show_submaps(state, maps, registration)
            if registration is None:
                self._associations.hide()
                self._annotations.hide_verdict()
        self._host.flush()
        return shown

    def show_alone(self, state: ViewState, gradient_map: GradientMap) -> Shown:
        """Show the one submap there is; of a pair shown before, nothing is left."""
        self._blinker.run(on=False)
        with self._lock, self._host.atomic():
            self._last = None
            shown, layout = self._show_submaps(state, (gradient_map, gradient_map), None)
            self._associations.show_alone(state, gradient_map, layout.at_query)
            self._annotations.hide_verdict()
        self._host.flush()
        return shown

    def gliding(self, state: ViewState, result: PairResult) -> Callable[[float], None] | None:
        """Give what moves the query from beside the database to where it registers.

        It takes the share of the way in [0, 1], and does nothing once another picture has been
        shown. Where there is no motion it is None.
        """
        motion = result.registration.T_database_query
        if motion is None:
            return None
        boxes = Box.of(state.query), Box.of(state.database)
        maps = result.query_map, result.database_map
        ratio = state.params.features.max_std_ratio
        dz = z_offset_of(result.registration, maps, ratio)
        tilt = self._level_of(*maps, result.registration, MAX_STD_RATIO).tilt
        place_pair, tall, raw = self.placing(state, result), self.tall, state.options.raw_frames
        return lambda share: place_pair(
            *glide(*boxes, motion, dz, share, tilt=tilt, raw=raw, tall=tall)
        )

    def placing(
        self, state: ViewState, result: PairResult
    ) -> Callable[[Placement, Placement], None]:
        """Give what puts query and database anywhere, without drawing them anew.

        It does nothing once another picture than that of the result has been shown.
        """

        def put(at_query: Placement, at_database: Placement) -> None:
            with self._lock:
                if self._last is not result:
                    return
                with self._host.atomic():
                    self._query.move(at_query)
                    self._database.move(at_database)
                    self._associations.show_lines(state, result, at_query, at_database)
                    self._associations.show_marks(state, result, at_query, at_database)
            self._host.flush()

        return put

    def fading(
        self, before: tuple[NDArray[np.uint8], ...], result: PairResult
    ) -> Callable[[float], None]:
        """Give what fades the colours of both surfaces into those that they had before.

        It takes the share of the way in [0, 1]. It leaves a surface as it is that has other cells
        by now, and does nothing once another picture than that of the result has been shown.
        """
        now = self.colors

        def paint(share: float) -> None:
            with self._lock:
                if self._last is not result:
                    return
                with self._host.atomic():
                    nodes = self._query, self._database
                    for node, start, end in zip(nodes, now, before, strict=True):
                        if start.shape == end.shape:
                            mixed = (1.0 - share) * start + share * end
                            node.surface.paint(np.rint(mixed).astype(np.uint8))
            self._host.flush()

        return paint

    @property
    def colors(self) -> tuple[NDArray[np.uint8], ...]:
        """Colours of the cells (n, 3) of query and database, as they were shown last."""
        with self._lock:
            return tuple(node.surface.colors for node in (self._query, self._database))

    def knows_motion(self, state: ViewState) -> bool:
        """Say whether the pair of a state is the one last shown with its registration.

        One submap alone needs none.
        """
        return not state.is_pair or self._known_registration(state) is not None

    def turns(self, state: ViewState) -> bool:
        """Say whether the query stands in the database's frame, side by side."""
        return self._motion_for(state, state.options.layout) is not None

    def _known_registration(self, state: ViewState) -> Registration | None:
        if self._registered is None:
            return None
        shown, registration = self._registered
        return registration if same_pair(shown, state) else None

    def _motion(self, state: ViewState) -> SE2 | None:
        registration = self._known_registration(state)
        return None if registration is None else registration.T_database_query

    def _motion_for(self, state: ViewState, layout: Layout) -> SE2 | None:
        """Give the motion that a layout shows; raw frames show none."""
        is_raw = layout != "registered" and state.options.raw_frames
        return None if is_raw else self._motion(state)

    @property
    def looked(self) -> PickContext | None:
        """What is drawn; None before the first picture."""
        with self._lock:
            return None if self._ground is None else PickContext(self._ground, self._last)

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place of a surface that a line of sight meets first, if it meets one."""
        return None if self._ground is None or not self.visible else self._ground.pick(ray)

    def spots(self, probe: Probe) -> tuple[Float[NDArray[np.float64], "3"], ...]:
        """Give where a place is seen in the scene [m], and the same place of the other submap.

        The other is left out without a motion, and where the other submap saw no ground.
        """
        with self._lock:
            ground = self._ground
            motion = None if ground is None else self._motion(ground.state)
        if ground is None:
            return ()
        spots = [ground.spot(probe)]
        if motion is not None:
            of_query = probe.role == "query"
            x, y = other_place(motion, probe.x, probe.y, of_query=of_query)
            spots.append(ground.spot(Probe("database" if of_query else "query", x, y)))
        return tuple(spot for spot in spots if spot is not None)

    def show_ruler(self, ruler: Ruler | None) -> None:
        """Show a measured line where the submaps stand; None shows none."""
        with self._lock, self._host.atomic():
            if self._ground is not None:
                self._ruler.show(ruler, self._ground)
        self._host.flush()

    def _blink(self, state: ViewState, registration: Registration | None) -> None:
        registered = _is_registered(state, registration)
        self._blinker.run(on=registered and state.options.compare == "blink")

    def close(self) -> None:
        """Stop blinking."""
        self._blinker.close()

    def _show_submaps(
        self,
        state: ViewState,
        maps: tuple[GradientMap, GradientMap],
        registration: Registration | None,
    ) -> tuple[Shown, "_Layout"]:
        state = replace(state, options=as_drawn(state.options))
        options, ratio = state.options, state.params.features.max_std_ratio
        registered = _is_registered(state, registration)
        motion, comparison, level = None, None, OWN_LEVEL
        if registration is not None:
            motion = registration.T_database_query
            compared = options.layer in COMPARED
            dz = z_offset_of(registration, maps, ratio) if registered or compared else 0.0
            if compared:
                comparison = self._compare(options.layer, *maps, registration, dz, ratio)
            if motion is not None and registered:
                level = HeightFrame(dz, yaw=motion.yaw)
            elif motion is not None and not options.raw_frames:
                # Not by what the slider of the mask leaves: each of its steps would level anew.
                level = self._level_of(*maps, registration, MAX_STD_RATIO)
            else:
                motion = None
        boxes = Box.of(state.query), Box.of(state.database)
        layout = _Layout(boxes, *self._place(state, boxes, options.layout, motion, level))
        swipe_at = layout.swipe_at(options.swipe) if options.compare == "swipe" else None
        seen = self._appearance(maps, options.layer, (level.rounded, OWN_LEVEL), comparison)
        ground = self._ground = Ground(
            state,
            self._paint(seen, options.color_map, ratio),
            (layout.at_query, layout.at_database),
            (level, OWN_LEVEL),
            swipe_at if registered else None,
        )
        nodes = (self._query, self._database)
        if not state.is_pair:
            self._database.visible = False
            nodes = nodes[:1]
        for index, node in enumerate(nodes):
            submap, placement = (state.query, state.database)[index], ground.placements[index]
            node.name(submap, boxes[index], ROLES[index] if state.is_pair else "submap")
            node.move(placement)
            if not self._blinker.on:
                node.visible = not registered or ROLES[index] in shown_roles(state)
            self._show_cloud(node, submap, state)
            self._show_surface(node, submap, ground, index)
        if self._standalone:
            self._annotations.show_bar(boxes[1], layout.at_database)
        self._annotations.show_swipe(ground.swipe_at, layout.corners)
        shown = Shown(
            ground.scale if options.surfaces else None,
            registered,
            sum(node.surface.num_points for node in nodes) if options.surfaces else 0,
            sum(node.cloud.num_points for node in nodes)
            if options.clouds or options.left_out
            else 0,
            ground,
        )
        return shown, layout

    def camera(
        self,
        state: ViewState,
        canvas: Canvas = UNKNOWN_CANVAS,
        forward: Float[NDArray[np.float64], "3"] | None = None,
        *,
        layout: Layout | None = None,
    ) -> Camera:
        """Give the view in which both submaps fill a canvas.

        Args:
            state: Whose pair, and whose layout.
            canvas: Of the page.
            forward: Direction of sight; None chooses what fills the canvas, and suits the layout.
            layout: Instead of the state's.
        """
        boxes = Box.of(state.query), Box.of(state.database)
        layout = layout or state.options.layout
        registration = self._known_registration(state)
        level = HeightFrame() if registration is None else HeightFrame(registration.z_offset)
        placed = self._place(state, boxes, layout, self._motion_for(state, layout), level)
        if forward is None and layout == FROM_ABOVE:
            forward = DOWN
        return frame_camera(tuple(zip(boxes, placed, strict=True)), canvas, forward=forward)

    def _place(
        self,
        state: ViewState,
        boxes: tuple[Box, Box],
        layout: Layout,
        motion: SE2 | None,
        level: HeightFrame,
    ) -> tuple[Placement, Placement]:
        """Place (query, database) in the scene; one submap alone stands in its middle."""
        if not state.is_pair:
            layout, motion, level = "registered", SE2(), HeightFrame()
        x, y, _ = boxes[0].center[:, None]
        (dz,) = level.height_at(x, y).tolist()
        return place(*boxes, layout, motion, dz, tilt=level.tilt, tall=self.tall)

    def _show_surface(self, node: SubmapNode, submap: Submap, ground: Ground, index: int) -> None:
        options = ground.state.options
        if not options.surfaces:
            node.surface.hide()
            return
        ratio = ground.ratio
        gradient_map, level = ground.maps[index], ground.paint.shown.levels[index]
        relief = ground.paint.shown.relief if options.hillshade else IDENTITY
        hue = node.color if ground.is_tinted else None

        def make() -> Painted:
            surfels = make_surfels(
                gradient_map,
                ground.scale,
                layer=options.layer,
                max_std_ratio=ratio,
                untrusted=options.untrusted,
                hillshaded=options.hillshade,
                level=level,
                relief=relief,
                hue=hue,
                stride=stride_for(gradient_map.grid.num_cells, MAX_SURFELS),
                values=ground.paint.shown.fields[index],
                seen=ground.seen(index),
                centre=submap.centre,
            )
            return surfels.positions, surfels.colors, surfels.size

        look = options.layer, ratio, options.untrusted, options.hillshade
        placement = ground.placements[index]
        swiped = None if ground.swipe_at is None else (ground.swipe_at, placement)
        made_from = (
            gradient_map,
            ground.scale,
            *look,
            level,
            relief,
            hue,
            ground.paint.shown.comparison,
            swiped,
        )
        node.surface.show(made_from, make)

    def _show_cloud(self, node: SubmapNode, submap: Submap, state: ViewState) -> None:
        options = state.options
        if not options.clouds and not options.left_out:
            node.cloud.hide()
            return

        def make() -> Painted:
            parts = [(submap.points[: None if options.clouds else 0], node.color)]
            if options.left_out and submap.left_out is not None:
                parts.append((_near(submap.left_out, submap), OUTLIER))
            parts = [(points[:: 1 + len(points) // MAX_CLOUD_POINTS], c) for points, c in parts]
            points = np.concatenate([points for points, _ in parts]) - submap.centre
            colors = np.concatenate([painted(color, len(some)) for some, color in parts])
            return points.astype(np.float32), colors, options.point_size

        node.cloud.show((submap, options.clouds, options.left_out, options.point_size), make)


def _near(left_out: Float[NDArray[np.float64], "k 3"], submap: Submap) -> NDArray[np.float64]:
    """Choose the points left out that are no further from the others than these extend."""
    low, high = submap.points.min(axis=0), submap.points.max(axis=0)
    around = float((high - low).max())
    return left_out[((left_out >= low - around) & (left_out <= high + around)).all(axis=1)]


def _is_registered(state: ViewState, registration: Registration | None) -> bool:
    """Say whether the query is to be laid onto the database, and can be."""
    has_motion = registration is not None and registration.T_database_query is not None
    return has_motion and state.options.layout == "registered"
