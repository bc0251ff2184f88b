"""The scene of the world: every submap at its pose, trajectories, and loops.

A submap is a frame with a surface beneath it, so that moving it sends a pose and nothing else.
"""

import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.features.world.merged import (
    MergedTerrain,
    alone,
    merge,
    pieces,
    terrain_colors,
    world_scale,
)
from app.viewer.features.world.submaps import (
    PoseSource,
    Terrain,
    WorldOptions,
)
from app.viewer.scene.associations import arcs, outline
from app.viewer.scene.colors import Rgb, colorize, for_line_ends
from app.viewer.scene.layers import Scale, Surfels
from app.viewer.scene.nodes import Node, lines_node, points_node
from app.viewer.scene.placement import UNKNOWN_CANVAS, Box, Canvas, Placement, frame_camera
from app.viewer.server.host import Host
from app.viewer.session.decisions import count_kinds
from app.viewer.session.state import Camera, ColorMap
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.choosing import likely
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import OptimisedGraph
from gpgrad_core.types import Dataset, LoopClosure, PairOfIds

LinePoints = Float[NDArray[np.float32], "n 2 3"]

TRAJECTORY_COLORS: dict[PoseSource, Rgb] = {
    "true": (25, 25, 25),
    "odometry": (222, 120, 20),
    "corrected": (31, 119, 200),
}
SCORE_MAP: ColorMap = "viridis"
MOST_ARCHES = 60
"""Accepted loops that are drawn, and refused pairs; those of the chosen submap come on top."""
LOOP_PIECES = 12
"""Straight pieces of the arch of one loop."""


def trajectory_lines(poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Join the submaps in the order of the traverse, so far above the ground [m]."""
    points = np.array([pose.translation for pose in poses.values()], dtype=np.float64)
    points = points.reshape(-1, 3) + np.array([0.0, 0.0, lift])
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def arches(loops: Iterable[LoopClosure], poses: Mapping[str, Pose], lift: float) -> LinePoints:
    """Span each `drawable` loop as an arch whose feet stand so far above the ground [m]."""
    chosen = drawable(loops, poses)
    if not chosen:
        return np.zeros((0, 2, 3), np.float32)
    raised = {name: pose.translation + np.array([0.0, 0.0, lift]) for name, pose in poses.items()}
    start = np.array([raised[loop.database_id] for loop in chosen])
    end = np.array([raised[loop.query_id] for loop in chosen])
    return arcs(start, end, LOOP_PIECES, rise=0.45)


def arch_colors(
    loops: Sequence[LoopClosure], highest: float, wrong: Collection[PairOfIds]
) -> UInt8[NDArray[np.uint8], "n 3"]:
    """Colour the pieces of `arches` by the score, from 0 to the highest; wrong ones are black."""
    scores = np.array([loop.registration.score for loop in loops], dtype=np.float64)
    colors = colorize(scores, 0.0, highest, SCORE_MAP)
    colors[[loop.pair in wrong for loop in loops]] = 0
    return np.repeat(colors, LOOP_PIECES, axis=0)


def choose_arches(
    loops: Iterable[LoopClosure], options: WorldOptions, selected: str | None
) -> tuple[LoopClosure, ...]:
    """Choose the loops to draw: those with the highest scores, and all of the selected submap.

    Hundreds of arches would hide the ground and each other.
    """
    chosen: list[LoopClosure] = []
    for accepted, wanted in ((True, options.loops), (False, options.refused)):
        if wanted:
            ranked = likely(loop for loop in loops if loop.accepted is accepted)
            chosen += ranked[:MOST_ARCHES]
            chosen += [loop for loop in ranked[MOST_ARCHES:] if selected in loop.pair]
    return tuple(chosen)


def drawable(loops: Iterable[LoopClosure], poses: Mapping[str, Pose]) -> tuple[LoopClosure, ...]:
    """Keep the loops both of whose submaps have a pose."""
    return tuple(loop for loop in loops if poses.keys() >= set(loop.pair))


WORLD = "/world"
SELECTED: Rgb = (235, 40, 140)
OUTLINES: Rgb = (150, 150, 150)
MAX_NAMES = 60
"""Of more submaps, only every second is named, or every third, …"""
Side: TypeAlias = Literal["bottom-center", "top-center", "center-left", "center-right"]
SIDES: dict[Side, tuple[float, float]] = {
    "bottom-center": (0.0, 0.5),
    "top-center": (0.0, -0.5),
    "center-left": (0.5, 0.0),
    "center-right": (-0.5, 0.0),
}
"""Which point of a name lies on its place, and where its middle is then, in its own sizes."""
LETTER, LINE = 0.02, 0.05
"""About how wide a letter of a name and how high a name is, in widths of the map."""
LIFT = 0.08
"""How far trajectories and loops stand above the ground, in widths of a submap."""


def sides_of(places: Mapping[str, Float[Array, "2"]], width: float) -> dict[str, Side]:
    """Choose where each name stands at its place, so that names cover little of each other.

    Where a drive comes back, submaps share their place. The upper one chooses first: it likes to be
    above its place.

    Args:
        places: Of the submaps that are named, seen from above with y up [m].
        width: Of the map [m].
    """
    chosen: dict[str, Side] = {}
    middles, sizes = np.zeros((0, 2)), np.zeros((0, 2))
    offsets = np.array(list(SIDES.values()))
    for name in sorted(places, key=lambda name: -places[name][1]):
        place = places[name]
        size = width * np.array([LETTER * (len(name) + 1), LINE])
        candidates = place + offsets * size
        apart = np.abs(candidates[:, None] - middles)
        covered = np.maximum((size + sizes) / 2 - apart, 0.0).prod(axis=-1).sum(axis=-1)
        best = int(np.argmin(covered))
        chosen[name] = list(SIDES)[best]
        middles, sizes = np.vstack([middles, candidates[best]]), np.vstack([sizes, size])
    return chosen


@dataclass(frozen=True, eq=False)
class Correction:
    """What the pose graph says of the world.

    Attributes:
        graph: The optimised graph between the submaps' centres; None before the first one.
        covariances: Of x [m], y [m] and yaw [rad] of each of its poses (n, 3, 3), in their order.
        loops: Pairs of submaps, accepted and refused.
        wrong: Those of which the pose graph found that the others contradict them.
        highest_score: Of the last colour of the loops.
        marked: Pair (query, database) whose loop stands out.
    """

    graph: OptimisedGraph | None = None
    covariances: Float[Array, "n 3 3"] | None = None
    loops: tuple[LoopClosure, ...] = ()
    wrong: frozenset[PairOfIds] = frozenset()
    highest_score: float = 1.0
    marked: PairOfIds | None = None

    @property
    def corrected(self) -> Mapping[str, Pose] | None:
        """The corrected poses, if there are any."""
        return None if self.graph is None else self.graph.poses


@dataclass(frozen=True, eq=False)
class Past:
    """What there was of the world at some time of a drive, to be shown in place of the whole.

    Attributes:
        dataset: With the submaps that had come, and perhaps later ones.
        poses: Poses of the centres of those that had come, as they were corrected then.
        odometry: Their poses by odometry alone, in the same frame.
        loops: The pairs to draw.
        wrong: Those that the others contradict.
        covariances: Of x [m], y [m] and yaw [rad] of each pose (n, 3, 3), in their order.
        highest_score: Of the last colour of the loops.
        moves_from: Poses from which they move to these; None if they stand still.
        seconds: How long they move.
        goes_on: Whether the next moment follows soon, so that nothing is inferred meanwhile.
        grows: Whether later submaps are not known yet, so that the cameras follow.
        words: What happened then, in a line.
    """

    dataset: Dataset
    poses: Mapping[str, Pose]
    odometry: Mapping[str, Pose]
    loops: tuple[LoopClosure, ...]
    wrong: frozenset[PairOfIds]
    covariances: Float[Array, "n 3 3"]
    highest_score: float = 1.0
    moves_from: Mapping[str, Pose] | None = None
    seconds: float = 0.6
    goes_on: bool = False
    grows: bool = False
    words: str = ""


ELLIPSE_PIECES = 24
ELLIPSE_STDS = 3.0
"""Half axes of an ellipse, in standard deviations: nearly all of what is possible lies within."""


def ellipses(
    names: Iterable[str],
    covariances: Float[Array, "poses 3 3"],
    poses: Mapping[str, Pose],
    lift: float,
) -> LinePoints:
    """Draw how certain each position is, as an ellipse so far above the ground [m]."""
    angles = np.linspace(0.0, 2 * np.pi, ELLIPSE_PIECES + 1)
    circle = ELLIPSE_STDS * np.stack([np.cos(angles), np.sin(angles)])
    rings: list[LinePoints] = [np.zeros((0, 2, 3), np.float32)]
    for name, covariance in zip(names, covariances, strict=True):
        values, axes = np.linalg.eigh(covariance[:2, :2])
        around = (axes * np.sqrt(np.maximum(values, 0.0))) @ circle
        ring = np.column_stack([*around, np.full(len(angles), lift)]) + poses[name].translation
        rings.append(np.stack([ring[:-1], ring[1:]], axis=1).astype(np.float32))
    return np.concatenate(rings)


@dataclass(frozen=True, eq=False)
class World:
    """What the scene is to show.

    Attributes:
        dataset: Whose submaps.
        surfaces: A surface of each, by id.
        poses: Pose of the centre of each that stands somewhere, by id.
        trajectories: Poses along each trajectory to draw, by where they come from.
        options: How it is drawn.
        correction: What the pose graph says of it, with the loops to draw.
        selected: Id of the submap to outline.
        past: What of it is shown, if it is not the whole.
    """

    dataset: Dataset
    surfaces: Mapping[str, Terrain]
    poses: Mapping[str, Pose]
    trajectories: Mapping[PoseSource, Mapping[str, Pose]]
    options: WorldOptions = field(default_factory=WorldOptions)
    correction: Correction = field(default_factory=Correction)
    selected: str | None = None
    past: Past | None = None

    @property
    def num_accepted(self) -> tuple[int, int]:
        """Number of loop closures, and of odometry neighbours, among the loops accepted."""
        accepted = (loop.pair for loop in self.correction.loops if loop.accepted)
        return count_kinds(self.dataset, accepted)

    @property
    def certain(self) -> tuple[list[str], Float[Array, "n 3 3"]]:
        """The ids and covariances of the poses that are known to be so certain."""
        correction = self.correction
        if self.past is not None:
            return list(self.past.poses), self.past.covariances
        if correction.covariances is None or self.options.poses != "corrected":
            return [], np.zeros((0, 3, 3))
        return list(correction.corrected or {}), correction.covariances


class WorldScene:
    """All submaps of a dataset under one frame that can be hidden."""

    def __init__(self, host: Host, *, visible: bool = False) -> None:
        """Make the frame; nothing is shown until `show`."""
        self._host = host
        self._root = host.scene.add_frame(WORLD, show_axes=False, visible=visible)
        self._nodes: list[_Node] = []
        self._trajectories: dict[PoseSource, Node] = {
            source: lines_node(host, f"{WORLD}/trajectories/{source}", color, thickness=3.0)
            for source, color in TRAJECTORY_COLORS.items()
        }
        self._loops = lines_node(host, f"{WORLD}/loops", None, thickness=4.0)
        self._refused = lines_node(host, f"{WORLD}/refused", (165, 165, 165), thickness=1.5)
        self._marked = lines_node(host, f"{WORLD}/marked", SELECTED, thickness=6.0)
        self._ellipses = lines_node(
            host, f"{WORLD}/ellipses", TRAJECTORY_COLORS["corrected"], thickness=2.0
        )
        self._outlines = lines_node(host, f"{WORLD}/outlines", OUTLINES, thickness=1.0)
        self._pin = lines_node(host, f"{WORLD}/place", SELECTED, thickness=5.0)
        self._outline = lines_node(host, f"{WORLD}/selected", SELECTED, thickness=4.0)
        self._origin = np.zeros(3)
        self._shown: World | None = None
        self._merged: _Merged | None = None
        self._look: tuple[object, object] | None = None  # terrain and colours that the nodes have
        self._scale: Scale | None = None  # what these colours mean
        self._alone: dict[str, Terrain] = {}  # whose nodes have what is not merged yet
        self._arches: tuple[LoopClosure, ...] = ()
        self._extents: dict[str, Box] = {}  # to measure one reads all of its points
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
        return 0 if self._merged is None else len(self._merged.terrain.positions)

    @property
    def terrain(self) -> MergedTerrain | None:
        """The ground that is shown."""
        return None if self._merged is None else self._merged.terrain

    @property
    def num_arches(self) -> int:
        """Number of loops that are drawn."""
        return len(self._arches)

    def show(
        self, world: World, at: Mapping[str, Pose] | None = None, *, merges: bool = True
    ) -> Scale | None:
        """Show a world as one consistent change; gives what its colours mean.

        Args:
            world: What to show.
            at: Other poses to put the submaps at for the moment, before `mover` moves them on.
            merges: Whether the ground is merged anew, which takes a while. Otherwise each submap
                keeps its part of it, and a new one lies on top, until `take` is given the ground.
        """
        with self._lock:
            return self._show(world, world.poses if at is None else at, merges=merges)

    def take(self, world: World, terrain: MergedTerrain) -> bool:
        """Show a ground that was merged of a world; says whether that still fits what is shown."""
        with self._lock:
            shown = self._shown
            if shown is None or not (
                has_grown(world.dataset, shown.dataset) and world.poses.keys() <= shown.poses.keys()
            ):
                return False
            surfaces = {name: world.surfaces[name] for name in terrain.names}
            self._merged = _Merged(terrain, surfaces, world.poses)
            with self._host.atomic():
                self._dress(shown, self._merged)
        self._host.flush()
        return True

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

    def _show(self, world: World, at: Mapping[str, Pose], *, merges: bool) -> Scale | None:
        surfaces = {
            name: surface for name, surface in world.surfaces.items() if name in world.poses
        }
        before = self._shown
        with self._host.atomic():
            if before is None or before.dataset is not world.dataset:
                known = dict[str, Box]()
                if before is not None and has_grown(before.dataset, world.dataset):
                    known = self._extents
                else:
                    self._origin = _middle(world.poses)
                self._extents = {
                    submap.id: known.get(submap.id) or Box.of(submap).seen_from(submap.centre)
                    for submap in world.dataset.submaps
                }
                widths = [float(extent.size[0]) for extent in self._extents.values()]
                self._lift = LIFT * float(np.median(widths))
            merged = self._merged
            if merges or merged is None or not merged.is_part_of(surfaces):
                merged = self._merge(surfaces, world.poses)
            self._dress(world, merged)
            self._shown = world
            loops = drawable(world.correction.loops, world.poses)
            self._arches = choose_arches(loops, world.options, world.selected)
            self._place(at)
        self._host.flush()
        return self._scale

    def _dress(self, world: World, merged: "_Merged") -> None:
        """Give each submap its part of a ground; what is not merged yet is shown as it is."""
        terrain, color = merged.terrain, world.options.color
        look = terrain, color
        made = dict[str, Surfels]()
        if self._look != look:
            self._look, self._scale, self._alone = look, world_scale(terrain, color), {}
            made = pieces(terrain, terrain_colors(terrain, color, self._scale), merged.poses)
        self._fit_nodes(len(world.dataset.submaps))
        sides = self._sides(world)
        for place, submap in enumerate(world.dataset.submaps):
            node, surface, name = self._nodes[place], world.surfaces.get(submap.id), submap.id
            if surface is None or name not in world.poses:
                node.hide()
                continue
            if name not in merged.surfaces and self._alone.get(name) is not surface:
                looks = terrain.resolution, color, self._scale
                made[name] = alone(name, surface, world.poses[name], *looks, place)
                self._alone[name] = surface
            node.show(name, self._extents[name], made.get(name), sides.get(name))

    def _sides(self, world: World) -> dict[str, Side]:
        """Choose which submaps are named, and at which side of their middle."""
        if not world.options.names:
            return {}
        submaps = world.dataset.submaps
        every = -(-len(submaps) // MAX_NAMES)
        named = {submap.id for submap in submaps[::every]} | {world.selected}
        middles = {
            name: pose.apply(self._extents[name].center[None])[0, :2]
            for name, pose in world.poses.items()
            if name in named
        }
        points = np.array(list(middles.values())).reshape(-1, 2)
        reach = float(np.ptp(points, axis=0).max()) if len(points) else 0.0
        return sides_of(middles, reach + self._lift / LIFT)

    def pick(self, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> int | None:
        """Say which cell of the terrain a ray of the scene hits first."""
        terrain = self.terrain
        return None if terrain is None else terrain.hit(origin + self._origin, direction)

    def mark(self, cell: int | None) -> None:
        """Mark a cell of the terrain by a pin, or none."""
        terrain = self.terrain
        if cell is None or terrain is None:
            self._pin.hide()
            return
        foot = terrain.positions[cell] - self._origin
        pin = np.stack([foot, foot + np.array([0.0, 0.0, 3 * self._lift])])[None]
        self._pin.put(points=pin.astype(np.float32))

    def _merge(self, surfaces: Mapping[str, Terrain], poses: Mapping[str, Pose]) -> "_Merged":
        """Merge the surfaces, unless that is what was merged last."""
        if self._merged is None or not self._merged.is_of(surfaces, poses):
            self._merged = _Merged(merge(surfaces, poses), surfaces, poses)
        return self._merged

    def camera(
        self, canvas: Canvas = UNKNOWN_CANVAS, forward: Float[Array, "3"] | None = None
    ) -> Camera | None:
        """Give the view in which all fills a canvas; None while nothing is shown."""
        shown, extents = self._shown, self._extents  # another dataset's, while that is drawn first
        placed = tuple(
            (extents[name], self._placement(pose))
            for name, pose in (() if shown is None else shown.poses.items())
            if name in extents
        )
        return frame_camera(placed, canvas, forward=forward) if placed else None

    def camera_at(self, name: str, canvas: Canvas = UNKNOWN_CANVAS) -> Camera | None:
        """Give the view of one submap; None if it is not shown."""
        shown, extent = self._shown, self._extents.get(name)
        if shown is None or extent is None or name not in shown.poses:
            return None
        return frame_camera(((extent, self._placement(shown.poses[name])),), canvas)

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
        names, covariances = world.certain
        rings = ellipses(names, covariances, local, self._lift)
        self._ellipses.put(points=rings)
        corners = [outline(pose.apply(self._extents[name].corners)) for name, pose in local.items()]
        lines = np.concatenate([np.zeros((0, 2, 3), np.float32), *corners])
        self._outlines.put(points=lines)

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
            segments.put(points=trajectory_lines(along, self._lift))

    def _place_loops(self, world: World, local: Mapping[str, Pose]) -> None:
        accepted = [loop for loop in self._arches if loop.accepted]
        refused = [loop for loop in self._arches if not loop.accepted]
        correction = world.correction
        colors = arch_colors(accepted, correction.highest_score, correction.wrong)
        points = arches(accepted, local, self._lift)
        self._loops.put(points=points, colors=for_line_ends(colors))
        marked = [loop for loop in correction.loops if loop.pair == correction.marked]
        self._marked.put(points=arches(marked, local, 1.1 * self._lift))
        self._refused.put(points=arches(refused, local, self._lift))

    def _place_outline(self, world: World, local: Mapping[str, Pose]) -> None:
        if world.selected is None or world.selected not in local:
            self._outline.hide()
            return
        corners = self._extents[world.selected].corners
        self._outline.put(points=outline(local[world.selected].apply(corners)))

    def _local(self, pose: Pose) -> Pose:
        """The pose in the scene's frame, whose numbers are small enough for the browser."""
        return Pose(pose.translation - self._origin, pose.quaternion)

    def _placement(self, pose: Pose) -> Placement:
        x, y, z = (float(value) for value in pose.translation - self._origin)
        return Placement(x, y, z, pose.planar.yaw)


@dataclass(frozen=True, eq=False)
class _Merged:
    """A ground, and the surfaces and the poses that it was merged of."""

    terrain: MergedTerrain
    surfaces: Mapping[str, Terrain]
    poses: Mapping[str, Pose]

    def is_of(self, surfaces: Mapping[str, Terrain], poses: Mapping[str, Pose]) -> bool:
        """Tell whether it is made of the same, in the same order."""
        return list(self.surfaces.items()) == list(surfaces.items()) and all(
            self.poses[name] == poses[name] for name in surfaces
        )

    def is_part_of(self, surfaces: Mapping[str, Terrain]) -> bool:
        """Tell whether all of its submaps are among others."""
        return self.surfaces.keys() <= surfaces.keys()


class _Node:
    """One submap of the world."""

    def __init__(self, host: Host, root: str) -> None:
        self.name = ""
        self._frame = host.scene.add_frame(root, show_axes=False)
        self.surface = points_node(host, f"{root}/surface")
        self._host, self._root = host, root
        self._label: viser.LabelHandle | None = None  # most of many submaps have none

    def show(self, name: str, box: Box, ground: Surfels | None, side: Side | None) -> None:
        """Show a submap with the ground that it owns; None leaves that as it is.

        Its name stands at a side of its middle; None leaves it out.
        """
        self.name = name
        self._frame.visible = True
        if ground is not None:
            self.surface.put(**ground.properties)
        if side is None:
            if self._label is not None:
                self._label.visible = False
            return
        if self._label is None:
            where = f"{self._root}/name"
            self._label = self._host.scene.add_label(where, name, anchor=side)
        self._label.visible = True
        if self._label.text != name:
            self._label.text = name
        if self._label.anchor != side:
            self._label.anchor = side
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
        self.name = ""

    def remove(self) -> None:
        """Remove it from the scene and from the pages."""
        self._frame.remove()


def has_grown(before: Dataset, after: Dataset) -> bool:
    """Tell whether a dataset has all submaps of another, and then some more."""
    return after.submaps[: len(before.submaps)] == before.submaps


def _middle(poses: Mapping[str, Pose]) -> Float[Array, "3"]:
    if not poses:
        return np.zeros(3)
    points = np.array([pose.translation for pose in poses.values()])
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2, dtype=np.float64)
