"""The scene of a pair: two submaps, what joins them, and what is pointed at."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from app.host import Host, pages
from app.state import ViewState
from app.views.associations import inlier_color, keypoint_dots, match_lines
from app.views.colors import DATABASE, INLIER, OUTLIER, QUERY, Rgb
from app.views.flight import set_start, set_view
from app.views.layers import Scale, shared_scale
from app.views.nodes import LinePoints, Segments, SubmapNode
from app.views.placement import (
    Camera,
    Extent,
    Placement,
    frame_camera,
    glide,
    height_offset,
    place,
)
from app.views.surfels import make_surfels, stride_for
from gpgrad_core.pipeline import PairResult
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, GradientMap, Submap

PAIR = "/pair"
"""Above all nodes of the pair, so that they come and go together."""
BAR: Rgb = (60, 60, 60)
MAX_SURFELS = 200_000
"""Of one surface; a finer map is drawn at every second cell, or third, …"""
MAX_CLOUD_POINTS = 200_000
OUTDATED = "Out of date: "
SCALE_BAR_SHARE = 0.4
"""Longest length of the scale bar, as a share of the database's width."""


@dataclass(frozen=True)
class Shown:
    """What a picture turned out to be, for the read-outs.

    Attributes:
        scale: Of the layer's colours; None while no surface is shown.
        registered: Whether the query was laid onto the database.
        num_surfels: Cells drawn.
        num_points: Cloud points drawn.
    """

    scale: Scale | None
    registered: bool
    num_surfels: int
    num_points: int


@dataclass(frozen=True, eq=False)
class _Registered:
    """The motion last found, and for which pair."""

    dataset: Dataset
    query_id: str
    database_id: str
    motion: SE2 | None

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
        self._outlier_lines = Segments(host, f"{PAIR}/matches/outliers", OUTLIER, thickness=1.0)
        self._inlier_lines = Segments(host, f"{PAIR}/matches/inliers", INLIER, thickness=1.2)
        self._bar = Segments(host, f"{PAIR}/scale/bar", BAR, thickness=4.0)
        self._bar_label = scene.add_label(f"{PAIR}/scale/label", "", anchor="top-center")
        self._verdict = scene.add_label(
            f"{PAIR}/verdict", "", anchor="top-center", font_screen_scale=1.3
        )
        self._registered: _Registered | None = None
        self._lock = threading.Lock()  # two workers draw: the pair's, and the one that plays
        self._last: PairResult | None = None

    @property
    def visible(self) -> bool:
        """Whether the pair is to be seen; what is shown meanwhile is there when it is again."""
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    def show(self, state: ViewState, result: PairResult) -> Shown:
        """Show a pair as the state asks; one consistent change in the browser."""
        motion = result.registration.T_database_query
        self._registered = _Registered(state.dataset, state.query_id, state.database_id, motion)
        with self._lock, self._host.atomic():
            self._last = result
            shown, stage = self._show_submaps(
                state, (result.query_map, result.database_map), motion
            )
            self._show_associations(state, result, stage.at_query, stage.at_database)
            self._show_verdict(result, stage.corners)
        self._host.flush()
        return shown

    def preview(self, state: ViewState, maps: tuple[GradientMap, GradientMap]) -> Shown:
        """Show the surfaces of (query, database) before it is known how they register.

        The motion last found for the pair goes on; so do its keypoints and lines, for a moment.
        Of another pair they go out of sight.
        """
        known = self._registered
        same_pair = self.knows_motion(state)
        with self._lock, self._host.atomic():
            self._last = None
            shown, _ = self._show_submaps(
                state, maps, known.motion if known and same_pair else None
            )
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
        ratio = state.params.features.max_std_ratio
        dz = height_offset(result.query_map, result.database_map, motion, ratio)

        def draw(share: float) -> None:
            with self._lock:
                if self._last is not result:
                    return
                at_query, at_database = glide(*boxes, motion, dz, share)
                with self._host.atomic():
                    self._query.move(at_query)
                    self._database.move(at_database)
                    self._show_associations(state, result, at_query, at_database)
            self._host.flush()

        return draw

    def knows_motion(self, state: ViewState) -> bool:
        """Say whether the pair of a state is the one last shown with its registration."""
        return self._registered is not None and self._registered.is_of(state)

    def _show_submaps(
        self, state: ViewState, maps: tuple[GradientMap, GradientMap], motion: SE2 | None
    ) -> tuple[Shown, "_Stage"]:
        options, ratio = state.options, state.params.features.max_std_ratio
        query_map, database_map = maps
        registered = options.layout == "registered" and motion is not None
        dz = 0.0
        if registered and motion is not None:
            dz = height_offset(query_map, database_map, motion, ratio)
        boxes = Extent.of(state.query), Extent.of(state.database)
        stage = _Stage(boxes, *place(*boxes, options.layout, motion, dz))
        lift = dz if options.layer == "elevation" else 0.0
        scale = shared_scale(maps, options.layer, options.color_map, ratio, (lift, 0.0))
        for node, submap, box, placement in (
            (self._query, state.query, boxes[0], stage.at_query),
            (self._database, state.database, boxes[1], stage.at_database),
        ):
            node.move(placement)
            node.name(submap, box)
            self._show_cloud(node, submap, state)
        self._show_surface(
            self._query, query_map, state, scale, yaw=stage.at_query.yaw, offset=lift
        )
        self._show_surface(self._database, database_map, state, scale, yaw=0.0, offset=0.0)
        self._show_bar(boxes[1], stage.at_database)
        nodes = (self._query, self._database)
        shown = Shown(
            scale if options.surfaces else None,
            registered,
            sum(node.surface.num_points for node in nodes) if options.surfaces else 0,
            sum(node.cloud.num_points for node in nodes) if options.clouds else 0,
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
        self._verdict.text = ""

    def camera(self, state: ViewState) -> Camera:
        """Give the view that shows both submaps of a state side by side."""
        boxes = Extent.of(state.query), Extent.of(state.database)
        at_query, at_database = place(*boxes, "side by side", None, 0.0)
        return frame_camera(((boxes[0], at_query), (boxes[1], at_database)))

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

    def _show_surface(
        self,
        node: SubmapNode,
        gradient_map: GradientMap,
        state: ViewState,
        scale: Scale,
        *,
        yaw: float,
        offset: float,
    ) -> None:
        options, ratio = state.options, state.params.features.max_std_ratio
        if not options.surfaces:
            node.surface.hide()
            return

        def make() -> tuple[Any, Any, float]:
            surfels = make_surfels(
                gradient_map,
                scale,
                layer=options.layer,
                max_std_ratio=ratio,
                untrusted=options.untrusted,
                hillshaded=options.hillshade,
                yaw=yaw,
                offset=offset,
                stride=stride_for(gradient_map.grid.num_cells, MAX_SURFELS),
            )
            return surfels.positions, surfels.colors, surfels.size

        needs = (
            gradient_map,
            scale,
            options.layer,
            ratio,
            options.untrusted,
            options.hillshade,
            yaw,
            offset,
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

    def _show_associations(
        self, state: ViewState, result: PairResult, at_query: Placement, at_database: Placement
    ) -> None:
        options = state.options
        size = float(np.clip(0.006 * Extent.of(state.database).size[:2].max(), 0.02, 5.0))
        lift = size / 2
        for node, of_query in ((self._query, True), (self._database, False)):
            if not options.keypoints:
                node.keypoints.hide()
                continue

            def make(of_query: bool = of_query) -> tuple[Any, Any, float]:
                dots = keypoint_dots(result, of_query=of_query, lift=lift)
                return dots.points, dots.colors, size

            node.keypoints.show(
                (
                    result.query_features if of_query else result.database_features,
                    result.query_map if of_query else result.database_map,
                    result.matches,
                    result.registration,
                    result.closure.accepted,
                    lift,
                ),
                make,
            )
        self._inlier_lines.recolor(inlier_color(result))
        for segments, inliers, wanted in (
            (self._inlier_lines, True, options.inlier_lines),
            (self._outlier_lines, False, options.outlier_lines),
        ):
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


def round_length(longest: float) -> float:
    """Give the longest of 1, 2, 5, 10, … [m] that is not longer.

    >>> round_length(4.7), round_length(0.3)
    (2.0, 0.2)
    """
    power = 10.0 ** np.floor(np.log10(longest))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= longest))
