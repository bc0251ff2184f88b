"""The scene of the world: every submap at its pose, trajectories, and loops.

A submap is a frame with a surface beneath it, so that moving it sends a pose and nothing else.
"""

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.features.world.submaps import (
    PoseSource,
    Surface,
    WorldOptions,
    make_patch,
    pick,
    submap_color,
    world_scale,
)
from app.viewer.scene.associations import arcs, outline
from app.viewer.scene.colors import Rgb, colorize, for_lines
from app.viewer.scene.layers import Scale
from app.viewer.scene.nodes import LinesNode, PointsNode
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas, Extent, Placement, frame_camera
from app.viewer.scene.surfels import Surfels
from app.viewer.server.host import Host
from app.viewer.session.state import Camera, ColorMap
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset

LinePoints = Float[NDArray[np.float32], "n 2 3"]

TRAJECTORY_COLORS: dict[PoseSource, Rgb] = {
    "true": (90, 90, 90),
    "odometry": (222, 120, 20),
    "corrected": (31, 119, 200),
}
REFUSED_LOOP: Rgb = (165, 165, 165)
WRONG_LOOP: Rgb = (0, 0, 0)
SCORE_MAP: ColorMap = "viridis"
MOST_ARCHES = 60
"""Accepted loops that are drawn, and refused pairs; those of the chosen submap come on top."""
LOOP_PIECES = 12
"""Straight pieces of the arch of one loop."""
LOOP_RISE = 0.45
"""Height of the arch over its feet, as a share of its span."""


@dataclass(frozen=True)
class Loop:
    """One pair of submaps as an edge of the picture.

    Attributes:
        query: Id of the later submap.
        database: Id of the earlier one.
        score: What its colour tells.
        accepted: Whether it is taken for a loop closure.
        wrong: Whether the pose graph found that the others contradict it.
    """

    query: str
    database: str
    score: float
    accepted: bool
    wrong: bool = False

    @property
    def pair(self) -> tuple[str, str]:
        """Query and database."""
        return self.query, self.database


def trajectory_lines(poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Join the submaps' origins in the order of the traverse, so far above the ground [m]."""
    points = np.array([pose.translation for pose in poses.values()], dtype=np.float64)
    points = points.reshape(-1, 3) + np.array([0.0, 0.0, lift])
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def arches(loops: Iterable[Loop], poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Span each `drawable` loop as an arch whose feet stand so far above the ground [m]."""
    chosen = drawable(loops, poses)
    if not chosen:
        return np.zeros((0, 2, 3), np.float32)
    raised = {name: pose.translation + np.array([0.0, 0.0, lift]) for name, pose in poses.items()}
    start = np.array([raised[loop.database] for loop in chosen])
    end = np.array([raised[loop.query] for loop in chosen])
    return arcs(start, end, LOOP_PIECES, LOOP_RISE)


def arch_colors(loops: Iterable[Loop], highest: float) -> UInt8[NDArray[np.uint8], "n 3"]:
    """Colour the pieces of `arches` by the score, from 0 to the highest; wrong ones are black."""
    drawn = list(loops)
    scores = np.array([loop.score for loop in drawn], dtype=np.float64)
    colors = colorize(scores, 0.0, highest, SCORE_MAP)
    colors[[loop.wrong for loop in drawn]] = WRONG_LOOP
    return np.repeat(colors, LOOP_PIECES, axis=0)


def choose_arches(
    loops: Iterable[Loop], options: WorldOptions, selected: str | None
) -> tuple[Loop, ...]:
    """Choose the loops to draw: those with the highest scores, and all of the selected submap.

    Hundreds of arches would hide the ground and each other.
    """
    chosen: list[Loop] = []
    for accepted, wanted in ((True, options.loops), (False, options.refused)):
        if wanted:
            ranked = sorted(
                (loop for loop in loops if loop.accepted is accepted), key=lambda loop: -loop.score
            )
            chosen += ranked[:MOST_ARCHES]
            chosen += [loop for loop in ranked[MOST_ARCHES:] if selected in loop.pair]
    return tuple(chosen)


def drawable(loops: Iterable[Loop], poses: Mapping[str, Pose]) -> tuple[Loop, ...]:
    """Keep the loops both of whose submaps have a pose."""
    return tuple(loop for loop in loops if loop.query in poses and loop.database in poses)


WORLD = "/world"
SELECTED: Rgb = (235, 40, 140)
MAX_NAMES = 60
"""Of more submaps, only every second is named, or every third, …"""
LIFT = 0.08
"""How far trajectories and loops stand above the ground, in widths of a submap."""


@dataclass(frozen=True, eq=False)
class World:
    """What the scene is to show.

    Attributes:
        dataset: Whose submaps.
        surfaces: A surface of each, by id.
        poses: ``T_world_submap`` of each that stands somewhere, by id.
        trajectories: Poses along each trajectory to draw, by where they come from.
        options: How it is drawn.
        loops: Pairs to join.
        selected: Id of the submap to outline.
        marked: Pair (query, database) whose loop stands out.
        highest_score: Of the last colour of the loops.
    """

    dataset: Dataset
    surfaces: Mapping[str, Surface]
    poses: Mapping[str, Pose]
    trajectories: Mapping[PoseSource, Mapping[str, Pose]]
    options: WorldOptions = field(default_factory=WorldOptions)
    loops: tuple[Loop, ...] = ()
    selected: str | None = None
    marked: tuple[str, str] | None = None
    highest_score: float = 1.0


class WorldScene:
    """All submaps of a dataset under one frame that can be hidden."""

    def __init__(self, host: Host, *, visible: bool = False) -> None:
        """Make the frame; nothing is shown until `show`."""
        self._host = host
        self._root = host.scene.add_frame(WORLD, show_axes=False, visible=visible)
        self._nodes: list[_Node] = []
        self._trajectories: dict[PoseSource, LinesNode] = {
            source: LinesNode(host, f"{WORLD}/trajectories/{source}", color, thickness=3.0)
            for source, color in TRAJECTORY_COLORS.items()
        }
        self._loops = _Loops(host, f"{WORLD}/loops")
        self._refused = LinesNode(host, f"{WORLD}/refused", REFUSED_LOOP, thickness=1.5)
        self._marked = LinesNode(host, f"{WORLD}/marked", SELECTED, thickness=6.0)
        self._outline = LinesNode(host, f"{WORLD}/selected", SELECTED, thickness=4.0)
        self._origin = np.zeros(3)
        self._shown: World | None = None
        self._arches: tuple[Loop, ...] = ()
        self._extents: dict[str, Extent] = {}  # to measure one reads all of its points
        self._lift = 0.0
        self._lock = threading.Lock()

    @property
    def visible(self) -> bool:
        """Whether the world is to be seen."""
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    @property
    def num_cells(self) -> int:
        """Cells drawn."""
        return sum(node.surface.num_points for node in self._nodes)

    @property
    def num_arches(self) -> int:
        """Number of loops that are drawn."""
        return len(self._arches)

    def show(self, world: World, at: Mapping[str, Pose] | None = None) -> Scale | None:
        """Show a world as one consistent change; gives what its colours mean.

        Args:
            world: What to show.
            at: Other poses to put the submaps at for the moment, before `mover` moves them on.
        """
        with self._lock:
            return self._show(world, world.poses if at is None else at)

    def mover(self) -> Callable[[Mapping[str, Pose]], None]:
        """Give what moves the submaps, and what hangs on them, without drawing them anew.

        It does nothing once another world has been shown.
        """
        world = self._shown

        def move(poses: Mapping[str, Pose]) -> None:
            with self._lock:
                if world is None or self._shown is not world:
                    return
                with self._host.atomic():
                    self._place(poses)
            self._host.flush()

        return move

    def _show(self, world: World, at: Mapping[str, Pose]) -> Scale | None:
        surfaces = {
            name: surface for name, surface in world.surfaces.items() if name in world.poses
        }
        before = self._shown
        with self._host.atomic():
            if before is None or before.dataset is not world.dataset:
                self._origin = _middle(world.poses)
                self._extents = {submap.id: Extent.of(submap) for submap in world.dataset.submaps}
                widths = [float(extent.size[0]) for extent in self._extents.values()]
                self._lift = LIFT * float(np.median(widths))
            scale = world_scale(surfaces, dict(world.poses), world.options.color)
            self._fit_nodes(len(world.dataset.submaps))
            for place, submap in enumerate(world.dataset.submaps):
                node, surface = self._nodes[place], surfaces.get(submap.id)
                if surface is None:
                    node.hide()
                    continue
                node.show(self._extents[submap.id], surface, world, scale, place)
            self._shown = world
            loops = drawable(world.loops, world.poses)
            self._arches = choose_arches(loops, world.options, world.selected)
            self._place(at)
        self._host.flush()
        return scale

    def pick(self, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> str | None:
        """Say which submap a ray of the scene hits first."""
        if self._shown is None:
            return None
        surfaces = {
            node.name: (node.surfels.positions, self._shown.poses[node.name], node.surfels.size)
            for node in self._nodes
            if node.surfels is not None and node.name in self._shown.poses
        }
        return pick(origin + self._origin, direction, surfaces)

    def camera(
        self, canvas: Canvas = UNKNOWN_CANVAS, forward: Float[Array, "3"] | None = None
    ) -> Camera | None:
        """Give the view in which all fills a canvas; None while nothing is shown."""
        if self._shown is None or not self._shown.poses:
            return None
        return frame_camera(
            tuple(
                (self._extents[submap.id], self._placement(self._shown.poses[submap.id]))
                for submap in self._shown.dataset.submaps
                if submap.id in self._shown.poses
            ),
            canvas,
            forward=forward,
        )

    def camera_at(self, name: str, canvas: Canvas = UNKNOWN_CANVAS) -> Camera | None:
        """Give the view of one submap; None if it is not shown."""
        if self._shown is None or name not in self._shown.poses:
            return None
        placed = self._placement(self._shown.poses[name])
        return frame_camera(((self._extents[name], placed),), canvas)

    def path(self) -> Float[Array, "n 3"]:
        """Give the trajectory along the submaps in the scene [m]."""
        if self._shown is None:
            return np.zeros((0, 3))
        points = [pose.translation - self._origin for pose in self._shown.poses.values()]
        return np.array(points, dtype=np.float64).reshape(-1, 3)

    def _fit_nodes(self, count: int) -> None:
        while len(self._nodes) > count:
            self._nodes.pop().remove()
        while len(self._nodes) < count:
            self._nodes.append(_Node(self._host, f"{WORLD}/submaps/{len(self._nodes)}"))

    def _place(self, poses: Mapping[str, Pose]) -> None:
        """Move the frames to poses, and draw trajectories and loops between them."""
        world = self._shown
        assert world is not None
        for node in self._nodes:
            pose = poses.get(node.name)
            if pose is not None:
                node.move(pose.translation - self._origin, pose)
        local = {name: self._local(pose) for name, pose in poses.items()}
        self._place_trajectories(world, local)
        self._place_loops(world, local)
        self._place_outline(world, local)

    def _place_trajectories(self, world: World, local: Mapping[str, Pose]) -> None:
        for source, segments in self._trajectories.items():
            poses = world.trajectories.get(source)
            if poses is None or not world.options.trajectories:
                segments.hide()
                continue
            # The trajectory that the submaps stand on moves along with them.
            along = (
                local
                if source == world.options.poses
                else {name: self._local(pose) for name, pose in poses.items()}
            )
            points = trajectory_lines(along, self._lift)
            segments.show((points.tobytes(),), lambda points=points: points)

    def _place_loops(self, world: World, local: Mapping[str, Pose]) -> None:
        accepted = [loop for loop in self._arches if loop.accepted]
        refused = [loop for loop in self._arches if not loop.accepted]
        self._loops.show(
            arches(accepted, local, self._lift), lambda: arch_colors(accepted, world.highest_score)
        )
        marked = [loop for loop in world.loops if loop.pair == world.marked]
        if marked:
            above = arches(marked, local, 1.1 * self._lift)
            self._marked.show((above.tobytes(),), lambda: above)
        else:
            self._marked.hide()
        if refused:
            points = arches(refused, local, self._lift)
            self._refused.show((points.tobytes(),), lambda: points)
        else:
            self._refused.hide()

    def _place_outline(self, world: World, local: Mapping[str, Pose]) -> None:
        if world.selected is None or world.selected not in local:
            self._outline.hide()
            return
        box, pose = self._extents[world.selected], local[world.selected]
        self._outline.show(
            (world.dataset, world.selected, *pose.translation, *pose.quaternion),
            lambda: outline(pose.apply(box.corners)),
        )

    def _local(self, pose: Pose) -> Pose:
        """The pose in the scene's frame, whose numbers are small enough for the browser."""
        return Pose(pose.translation - self._origin, pose.quaternion)

    def _placement(self, pose: Pose) -> Placement:
        x, y, z = (float(value) for value in pose.translation - self._origin)
        return Placement(x, y, z, pose.planar.yaw)


class _Node:
    """One submap of the world."""

    def __init__(self, host: Host, root: str) -> None:
        self.name = ""
        self.surfels: Surfels | None = None
        self._frame = host.scene.add_frame(root, show_axes=False)
        self.surface = PointsNode(host, f"{root}/surface")
        self._host, self._root = host, root
        self._label: viser.LabelHandle | None = None  # most of many submaps have none

    def show(
        self, box: Extent, surface: Surface, world: World, scale: Scale | None, place: int
    ) -> None:
        """Show a submap, unless it is shown just so."""
        name = world.dataset.submaps[place].id
        count, color, pose = len(world.surfaces), world.options.color, world.poses[name]
        self.name = name
        self._frame.visible = True

        def make() -> tuple[Any, Any, float]:
            made = make_patch(surface, pose, color, scale, submap_color(place), count)
            self.surfels = made
            return made.positions, made.colors, made.size

        height = float(pose.translation[2]) if color == "elevation" else 0.0
        look = (color, scale, place, count, pose.planar.yaw, height)
        self.surface.show((surface.gradient_map, surface.max_std_ratio, *look), make)
        every = -(-len(world.dataset.submaps) // MAX_NAMES)
        named = world.options.names and (place % every == 0 or name == world.selected)
        if not named:
            if self._label is not None:
                self._label.visible = False
            return
        if self._label is None:
            where = f"{self._root}/name"
            self._label = self._host.scene.add_label(where, name, anchor="bottom-center")
        self._label.visible = True
        if self._label.text != name:
            self._label.text = name
        x, y, _ = box.center
        self._label.position = (float(x), float(y), float(box.high[2]))

    def move(self, position: Float[Array, "3"], pose: Pose) -> None:
        """Move the frame."""
        x, y, z, w = pose.quaternion
        self._frame.position = position
        self._frame.wxyz = np.array([w, x, y, z])

    def hide(self) -> None:
        """Hide it."""
        self._frame.visible = False
        self.name, self.surfels = "", None

    def remove(self) -> None:
        """Remove it from the scene and from the pages."""
        self._frame.remove()


class _Loops:
    """Line segments of many colours in one node."""

    def __init__(self, host: Host, name: str) -> None:
        self._host = host
        self._name = name
        self._handle: viser.LineSegmentsHandle | None = None
        self._colored: bytes = b""

    def show(self, points: Any, make_colors: Callable[[], Any]) -> None:
        """Show lines (n, 2, 3) [m] in the colours (n, 3) that ``make_colors`` returns."""
        if len(points) == 0:
            if self._handle is not None:
                self._handle.visible = False
            return
        wanted = make_colors()
        unique, places = np.unique(wanted, axis=0, return_inverse=True)
        table = np.array([for_lines((int(r), int(g), int(b))) for r, g, b in unique], np.uint8)
        colors = np.repeat(table[places.ravel()][:, None], 2, axis=1)
        if self._handle is None:
            self._handle = self._host.scene.add_line_segments(
                self._name, points, colors, thickness=4.0, thickness_units="screen"
            )
        else:
            self._handle.points = points
            if colors.tobytes() != self._colored:
                self._handle.colors = colors
            self._handle.visible = True
        self._colored = colors.tobytes()


def _middle(poses: Mapping[str, Pose]) -> Float[Array, "3"]:
    if not poses:
        return np.zeros(3)
    points = np.array([pose.translation for pose in poses.values()])
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2, dtype=np.float64)
