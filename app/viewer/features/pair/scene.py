"""The scene of a pair: two submaps, what joins them, and what is pointed at."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from app.viewer.features.pair.nodes import Annotations, AssociationNodes, Blinker, RulerNodes
from app.viewer.features.pair.picture import (
    Picture,
    boxes_of,
    compose,
    corners_of,
    place_pair,
    surfels_of,
)
from app.viewer.scene.cameras import DOWN, FRAMES_A_SECOND, ease
from app.viewer.scene.colors import DATABASE, OUTLIER, QUERY
from app.viewer.scene.layers import Paint
from app.viewer.scene.nodes import SubmapNode
from app.viewer.scene.placement import (
    UNKNOWN_CANVAS,
    Canvas,
    HeightFrame,
    Placement,
    beside,
    frame_camera,
    glide,
    level_of,
    z_offset_of,
)
from app.viewer.scene.probing import Ray, Ruler
from app.viewer.server.host import Host
from app.viewer.session.state import (
    FROM_ABOVE,
    ROLES,
    Camera,
    Layout,
    Probe,
    ViewState,
    as_drawn,
    same_pair,
)
from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PairResult
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import MAX_STD_RATIO, GradientMap, Registration, Submap

PAIR = "/pair"
"""Above all nodes of the pair, so that they come and go together."""
MAX_CLOUD_POINTS = 200_000
"""Of one submap; of a larger cloud every second point is drawn, or third, …"""
HEADING_BACK = 0.12
"""How far behind each of two pictures its heading stands, as a share of its depth."""
EASES = 6
"""Pictures in which the colours go from one range to another."""


class PairScene:
    """The two submaps, and what joins them.

    Attributes:
        tall: Whether side by side means one behind the other, as fills a tall canvas.
        mark_scale: How large the marks of keypoints are, beside the usual ones.
        picture: What is drawn; None before the first picture.
        is_split: Whether another picture of the pair stands beside this one, see `beside`.
        like: What stands beside it, if anything: its colours mean the same.
        join: Joins each picture with a result to the other one; says whether that has the lines.
    """

    def __init__(
        self,
        host: Host,
        memo: Memo | None = None,
        *,
        standalone: bool = True,
        root: str = PAIR,
    ) -> None:
        """Make the nodes below a root; nothing is shown until `show`.

        The scale is part of a standalone scene, because nothing is written over it.
        """
        self.is_split = False
        self.like: Picture | None = None
        self.join: Callable[[Picture], bool] = lambda _: False
        self.tall = False
        self.mark_scale = 1.0
        self.picture: Picture | None = None
        self._host, self._memo = host, memo or Memo()
        self._standalone = standalone
        scene = host.scene
        scene.set_up_direction("+z")
        # Lit surfaces are not used, and an environment map would tint what is.
        scene.configure_environment_map(None)
        self._root = scene.add_frame(root, show_axes=False)
        self._nodes = (
            SubmapNode(host, root, "query", QUERY, "left"),
            SubmapNode(host, root, "database", DATABASE, "right"),
        )
        self._annotations = Annotations(host, root)
        self._associations = AssociationNodes(host, root, self._nodes)
        self._ruler = RulerNodes(host, root)
        self._blinker = Blinker(host, self._nodes)
        # The last registration, and the state whose pair it is of.
        self._registered: tuple[ViewState, Registration] | None = None
        self._held: Paint | None = None  # whose range stays while a hand is on a slider
        self._let_go: Paint | None = None  # whose range did until then
        self._lock = threading.Lock()  # two workers draw: the pair's, and the one that plays

    @property
    def visible(self) -> bool:
        """Whether the pair is visible; hidden, it is drawn all the same."""
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    def move(self, x: float, y: float) -> None:
        """Move all of it to another place in the scene [m]."""
        self._root.position = x, y, 0.0

    def show(self, state: ViewState, result: PairResult) -> Picture:
        """Show a pair as the state asks; one consistent change in the browser."""
        self._registered = state, result.registration
        return self._draw(state, result.maps, result)

    def preview(self, state: ViewState, maps: tuple[GradientMap, ...]) -> Picture:
        """Show the surfaces of (query, database) before their registration.

        The pair's last motion still applies; its keypoints and lines stay for a moment.
        Those of another pair are hidden. The one submap there is has its surface only.
        """
        return self._draw(state, maps, None)

    def _draw(
        self,
        state: ViewState,
        maps: tuple[GradientMap, ...],
        result: PairResult | None,
        ends: tuple[float, float] | None = None,
    ) -> Picture:
        registration, before = self._known_registration(state), self.picture
        picture = compose(
            state,
            maps,
            registration,
            self._memo,
            result=result,
            before=None if before is None else before.paint,
            tall=self.tall,
            ends=ends or self._held_ends(state),
        )
        options = state.options
        self._blinker.run(on=picture.is_registered and options.compare == "blink")
        with self._lock, self._host.atomic():
            self.picture = picture = self._show_submaps(picture)
            self._annotations.show_swipe(picture)
            if self._standalone:
                self._annotations.show_bar(picture)
            if result is not None:
                self._associations.show_keypoints(picture, result, self.mark_scale)
                shown = picture.without_lines() if self.join(picture) else picture
                self._associations.show_lines(shown, result)
            elif registration is None:
                self._associations.hide()
                if not state.is_pair:
                    self._associations.show_place(picture)
        self._host.flush()
        return picture

    def hold_range(self, *, on: bool) -> bool:
        """Keep the range of the colours as it is, or let it go; says whether another may come."""
        held, shown = self._held, self.picture
        self._held = shown.paint if on and shown is not None else None
        self._let_go = None if on else held
        return held is not None and not on

    def ease_range(self, state: ViewState, result: PairResult, progress: Progress) -> None:
        """Lead the colours from the range that was held to the one that suits the ground."""
        held, self._let_go = self._let_go, None
        if held is None or self.is_split or self._ends_of(held, state) is None:
            return
        maps, motion, memo = result.maps, result.registration, self._memo
        scales = held.scale, compose(state, maps, motion, memo, result=result).paint.scale
        starts, ends = ((scale.low, scale.high) for scale in scales)
        for step in range(1, EASES if starts != ends else 0):
            progress(0.0)
            share = ease(step / EASES)
            low, high = ((1 - share) * a + share * b for a, b in zip(starts, ends, strict=True))
            self._draw(state, maps, result, ends=(low, high))
            time.sleep(1 / FRAMES_A_SECOND)

    def _held_ends(self, state: ViewState) -> tuple[float, float] | None:
        """The ends of the held range, if it is of the same pair and layer."""
        like = self.like if self.is_split else None
        return self._ends_of(self._held if like is None else like.paint, state)

    def _ends_of(self, held: Paint | None, state: ViewState) -> tuple[float, float] | None:
        shown = self.like if self.is_split else self.picture
        if held is None or shown is None or held.layer != as_drawn(state.options).layer:
            return None
        return (held.scale.low, held.scale.high) if same_pair(shown.state, state) else None

    def gliding(self, state: ViewState, result: PairResult) -> Callable[[float], None] | None:
        """A mover of the query from beside the database to where it registers.

        Its argument is the share of the way in [0, 1]; it does nothing once another picture has
        been shown. Without a motion it is None.
        """
        registration, ratio = result.registration, state.params.features.max_std_ratio
        motion = registration.T_database_query
        if motion is None:
            return None
        level = self._memo(level_of, *result.maps, registration, MAX_STD_RATIO)
        dz = HeightFrame(z_offset_of(registration, result.maps, ratio))
        starts = place_pair(state, "side by side", motion, level, tall=self.tall)
        ends = place_pair(state, "registered", motion, dz, tall=self.tall)
        box, put = boxes_of(state)[0], self.placing(result)
        return lambda share: put(*glide(box, starts, ends, share))

    def placing(self, result: PairResult) -> Callable[[Placement, Placement], None]:
        """A mover of query and database, without drawing them anew.

        It does nothing once another picture than that of the result has been shown.
        """

        def put(at_query: Placement, at_database: Placement) -> None:
            placements = at_query, at_database
            with self._lock:
                if self.picture is None or self.picture.result is not result:
                    return
                with self._host.atomic():
                    for node, placement in zip(self._nodes, placements, strict=True):
                        node.move(placement)
                    placed = replace(self.picture, placements=placements)
                    self._associations.show_lines(placed, result)
            self._host.flush()

        return put

    def fading(
        self, before: tuple[NDArray[np.uint8], ...], result: PairResult
    ) -> Callable[[float], None]:
        """A function that fades both surfaces into the colours that they had before.

        Its argument is the share of the way in [0, 1]. It skips a surface that has other cells
        by now, and does nothing once another picture than that of the result has been shown.
        """
        now = self.colors

        def paint(share: float) -> None:
            with self._lock:
                if self.picture is None or self.picture.result is not result:
                    return
                with self._host.atomic():
                    for node, start, end in zip(self._nodes, now, before, strict=True):
                        if start.shape == end.shape:
                            mixed = (1.0 - share) * start + share * end
                            node.surface.paint(np.rint(mixed).astype(np.uint8))
            self._host.flush()

        return paint

    @property
    def colors(self) -> tuple[NDArray[np.uint8], ...]:
        """Colours of the cells (n, 3) of query and database, as they were shown last."""
        with self._lock:
            empty = np.zeros((0, 3), np.uint8)
            return tuple(node.surface.made.get("colors", empty) for node in self._nodes)

    def colors_of(self, state: ViewState, result: PairResult) -> tuple[NDArray[np.uint8], ...]:
        """The colours that both surfaces would have in another state."""
        known = result.registration
        picture = compose(state, result.maps, known, self._memo, result=result, tall=self.tall)
        return tuple(surfels_of(picture, index).colors for index in range(2))

    def knows_motion(self, state: ViewState) -> bool:
        """Whether the pair of a state is the one last shown with its registration.

        One submap alone needs none.
        """
        return not state.is_pair or self._known_registration(state) is not None

    def turns(self, state: ViewState) -> bool:
        """Whether the query stands in the database's frame, side by side."""
        is_raw = state.options.layout != "registered" and state.options.raw_frames
        registration = self._known_registration(state)
        return not is_raw and registration is not None and registration.T_database_query is not None

    def _known_registration(self, state: ViewState) -> Registration | None:
        if self._registered is None:
            return None
        shown, registration = self._registered
        return registration if same_pair(shown, state) else None

    def pick(self, ray: Ray) -> Probe | None:
        """Find the place of a surface that a line of sight meets first, if it meets one."""
        return None if self.picture is None or not self.visible else self.picture.pick(ray)

    def show_ruler(self, ruler: Ruler | None) -> None:
        with self._lock, self._host.atomic():
            if self.picture is not None:
                self._ruler.show(ruler, self.picture)
        self._host.flush()

    def scale_labels(self, scale: float) -> None:
        """Write the names of both submaps larger than usual."""
        for node in self._nodes:
            node.label.font_screen_scale = scale
        self._host.flush()

    def close(self) -> None:
        self._blinker.close()

    def _show_submaps(self, picture: Picture) -> Picture:
        """Show surfaces and clouds where they stand; gives the picture with their numbers."""
        state, options = picture.state, picture.state.options
        shown = self._nodes if state.is_pair else self._nodes[:1]
        if not state.is_pair:
            self._nodes[1].visible = False
        submaps = state.query, state.database
        for index, node in enumerate(shown):
            role = ROLES[index]
            name = role if state.is_pair else "submap"
            node.name(submaps[index], picture.boxes[index], name)
            node.move(picture.placements[index])
            node.show_frame(submaps[index], shown=options.frames)
            if not self._blinker.on:
                node.visible = role in picture.roles
            self._show_cloud(node, submaps[index], state)
            self._show_surface(node, picture, index)
        has_clouds = options.clouds or options.left_out
        return replace(
            picture,
            num_surfels=sum(node.surface.count for node in shown) if options.surfaces else 0,
            num_points=sum(node.cloud.count for node in shown) if has_clouds else 0,
        )

    def camera(
        self,
        state: ViewState,
        canvas: Canvas = UNKNOWN_CANVAS,
        forward: Float[NDArray[np.float64], "3"] | None = None,
        *,
        layout: Layout | None = None,
        parallel: bool = False,
    ) -> Camera:
        """The view in which both submaps fill a canvas, in the state's layout or another.

        Without a direction of sight it is one that fills the canvas, and suits the layout.
        """
        layout = layout or state.options.layout
        registration, motion, level = self._known_registration(state), None, HeightFrame()
        if registration is not None:
            motion, level = registration.T_database_query, HeightFrame(registration.z_offset)
        placed = place_pair(state, layout, motion, level, tall=self.tall)
        if forward is None and layout == FROM_ABOVE:
            forward = DOWN
        boxes = tuple(zip(boxes_of(state), placed, strict=True))
        if self.is_split:
            corners = corners_of(boxes)
            x, y = beside(corners, corners, self.stacks(layout))
            boxes += tuple(
                (box, replace(at, x=at.x + x, y=at.y + y + back))
                for back in (0.0, HEADING_BACK * float(np.ptp(corners[:, 1])))
                for box, at in boxes
            )
        return frame_camera(boxes, canvas, forward=forward, parallel=parallel)

    def stacks(self, layout: Layout) -> bool:
        """Whether two pictures of the pair fill the canvas better one behind the other."""
        return (layout == "registered") == self.tall

    def _show_surface(self, node: SubmapNode, picture: Picture, index: int) -> None:
        options, paint = picture.state.options, picture.paint
        if not options.surfaces:
            node.surface.hide()
            return
        hue = node.color if picture.is_tinted else None
        swipe_at = picture.swipe_at
        swiped = None if swipe_at is None else (swipe_at, picture.placements[index])
        how = options.untrusted, options.hillshade, options.exaggeration, options.picked_values
        node.surface.show((paint, *how, hue, swiped), lambda: surfels_of(picture, index).properties)

    def _show_cloud(self, node: SubmapNode, submap: Submap, state: ViewState) -> None:
        options = state.options
        if not options.clouds and not options.left_out:
            node.cloud.hide()
            return

        def make() -> dict[str, Any]:
            parts = [(submap.points[: None if options.clouds else 0], node.color)]
            if options.left_out and submap.left_out is not None:
                parts.append((_near(submap.left_out, submap), OUTLIER))
            parts = [(points[:: 1 + len(points) // MAX_CLOUD_POINTS], c) for points, c in parts]
            points = np.concatenate([points for points, _ in parts]) - submap.centre
            points *= (1.0, 1.0, options.exaggeration)
            colors = np.repeat(
                np.array([color for _, color in parts], np.uint8),
                [len(some) for some, _ in parts],
                axis=0,
            )
            size = options.point_size
            return {"points": points.astype(np.float32), "colors": colors, "point_size": size}

        how = options.clouds, options.left_out, options.point_size, options.exaggeration
        node.cloud.show((submap, *how), make)


def _near(left_out: Float[NDArray[np.float64], "k 3"], submap: Submap) -> NDArray[np.float64]:
    """Choose the points left out that are no further from the others than these extend."""
    low, high = submap.bounds
    around = float((high - low).max())
    return left_out[((left_out >= low - around) & (left_out <= high + around)).all(axis=1)]
