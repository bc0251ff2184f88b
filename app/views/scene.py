"""The scene of a pair: the only file that talks to the browser's 3D nodes.

Each node remembers what it was last made from and does nothing when asked for the same again;
the memo of the pipeline gives the same object for the same key, so comparing costs nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from app.host import Host, pages
from app.state import ViewState
from app.views.associations import inlier_color, keypoint_dots, match_lines, outline
from app.views.colors import DATABASE, INLIER, OUTLIER, QUERY, Rgb, for_lines
from app.views.layers import Scale, shared_scale
from app.views.placement import (
    FIELD_OF_VIEW,
    Camera,
    Extent,
    Placement,
    frame_camera,
    height_offset,
    place,
)
from app.views.surfels import make_surfels, stride_for
from gpgrad_core.pipeline import PairResult
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, GradientMap, Submap

LinePoints: TypeAlias = Float[NDArray[np.float32], "n 2 3"]

PAIR = "/pair"
"""Above all nodes of the pair, so that they come and go together."""
BAR: Rgb = (60, 60, 60)
MAX_SURFELS = 200_000
"""Of one surface; a finer map is drawn at every second cell, or third, …"""
MAX_CLOUD_POINTS = 200_000
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


class Cloud:
    """One point cloud node, made when first needed and then changed in place."""

    def __init__(self, host: Host, name: str, *, shape: str = "square") -> None:
        """Prepare the node of that name."""
        self._host = host
        self._name = name
        self._shape: Any = shape
        self._handle: viser.PointCloudHandle | None = None
        self._made_from: tuple[object, ...] = ()
        self.num_points = 0

    def show(
        self,
        made_from: tuple[object, ...],
        make: Callable[[], tuple[Any, Any, float]],
    ) -> None:
        """Show what ``make`` returns: positions (n, 3), colours (n, 3) and a size [m].

        Args:
            made_from: All that the points depend on; equal to last time means nothing to do.
            make: Called only if something changed.
        """
        if made_from == self._made_from and self._handle is not None:
            self._handle.visible = self.num_points > 0
            return
        points, colors, size = make()
        self._made_from = made_from
        self.num_points = len(points)
        if self.num_points == 0:
            # The client cannot frame a cloud without points; the old ones stay, unseen.
            self.hide()
            return
        if self._handle is None:
            self._handle = self._host.scene.add_point_cloud(
                self._name,
                points,
                colors,
                point_size=size,
                point_shape=self._shape,
                precision="float32",
                point_shading="flat",
            )
            return
        self._handle.points = points
        self._handle.colors = colors
        self._handle.point_size = size
        self._handle.visible = True

    def hide(self) -> None:
        """Take it out of sight."""
        if self._handle is not None:
            self._handle.visible = False


class Segments:
    """One node of line segments, made when first needed and then changed in place."""

    def __init__(self, host: Host, name: str, color: Rgb, thickness: float) -> None:
        """Prepare the node of that name, its colour as shown, its thickness in pixels."""
        self._color = color
        self._host = host
        self._name = name
        self._thickness = thickness
        self._handle: viser.LineSegmentsHandle | None = None
        self._made_from: tuple[object, ...] = ()
        self._num_lines = 0

    def show(self, made_from: tuple[object, ...], make: Callable[[], LinePoints]) -> None:
        """Show the lines that ``make`` returns [m], unless nothing changed."""
        if made_from == self._made_from and self._handle is not None:
            self._handle.visible = self._num_lines > 0
            return
        points = make()
        self._made_from = made_from
        self._num_lines = len(points)
        if self._num_lines == 0:
            self.hide()
            return
        if self._handle is None:
            self._handle = self._host.scene.add_line_segments(
                self._name,
                points,
                for_lines(self._color),
                thickness=self._thickness,
                thickness_units="screen",
            )
            return
        self._handle.points = points
        self._handle.visible = True

    def recolor(self, color: Rgb) -> None:
        """Change the colour."""
        if color == self._color:
            return
        self._color = color
        if self._handle is not None:
            self._handle.colors = np.array(for_lines(color), dtype=np.uint8)

    def hide(self) -> None:
        """Take it out of sight."""
        if self._handle is not None:
            self._handle.visible = False


class SubmapNode:
    """One submap: a frame, and beneath it surface, cloud, keypoints, outline and label.

    Registering moves the frame; what hangs on it follows without being sent again.
    """

    def __init__(self, host: Host, role: str, color: Rgb, outer: Literal["left", "right"]) -> None:
        """Make the frame of the query or the database.

        Args:
            host: Whose scene it joins.
            role: "query" or "database".
            color: Of its outline and its points.
            outer: Which way the other submap is not.
        """
        self._outer = outer
        self.color = color
        self._role = role
        root = f"{PAIR}/{role}"
        self._frame = host.scene.add_frame(root, show_axes=False)
        self.surface = Cloud(host, f"{root}/surface")
        self.cloud = Cloud(host, f"{root}/cloud", shape="circle")
        self.keypoints = Cloud(host, f"{root}/keypoints", shape="circle")
        self.outline = Segments(host, f"{root}/outline", color, thickness=2.0)
        self._label = host.scene.add_label(
            f"{root}/label", role, anchor="bottom-left" if outer == "left" else "bottom-right"
        )

    def move(self, placement: Placement) -> None:
        """Place the frame in the scene."""
        self._frame.position = placement.position
        self._frame.wxyz = placement.wxyz

    def name(self, submap: Submap, extent: Extent) -> None:
        """Write beside it which submap this is and how large, and draw its outline."""
        width, depth, _ = extent.size
        self._label.text = f"{self._role} {submap.id} · {width:.1f} m x {depth:.1f} m"
        # On the edge that a camera looking along y sees as the far one, at the outer corner, so
        # that two names do not meet.
        outer = extent.low if self._outer == "left" else extent.high
        self._label.position = (outer[0], extent.high[1], extent.high[2])
        self.outline.show(
            (submap,),
            lambda: outline(extent.corners),
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
        self._query = SubmapNode(host, "query", QUERY, "right")
        self._database = SubmapNode(host, "database", DATABASE, "left")
        self._outlier_lines = Segments(host, f"{PAIR}/matches/outliers", OUTLIER, thickness=1.0)
        self._inlier_lines = Segments(host, f"{PAIR}/matches/inliers", INLIER, thickness=1.2)
        self._bar = Segments(host, f"{PAIR}/scale/bar", BAR, thickness=4.0)
        self._bar_label = scene.add_label(f"{PAIR}/scale/label", "", anchor="top-center")
        self._verdict = scene.add_label(
            f"{PAIR}/verdict", "", anchor="top-center", font_screen_scale=1.3
        )
        self._registered: _Registered | None = None

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
        with self._host.atomic():
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
        with self._host.atomic():
            shown, _ = self._show_submaps(
                state, maps, known.motion if known and same_pair else None
            )
            if not same_pair:
                self._hide_associations()
        self._host.flush()
        return shown

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
        initial = self._host.initial_camera
        initial.fov = float(FIELD_OF_VIEW)
        initial.position = camera.position
        initial.look_at = camera.look_at

    def move_cameras(self, camera: Camera) -> None:
        """Bring every open page to a view."""
        for page in pages(self._host).values():
            with page.atomic():
                page.camera.fov = float(FIELD_OF_VIEW)
                page.camera.position = camera.position
                page.camera.look_at = camera.look_at

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
