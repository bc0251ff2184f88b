"""The scene of the world: every submap at its pose, trajectories, and loops.

A submap is a frame with a surface beneath it, so that moving it sends a pose and nothing else.
"""

import threading
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.features.world.merged import MergedTerrain, merge, merge_at, pieces, world_scale
from app.viewer.features.world.model import World
from app.viewer.features.world.submaps import PoseSource, Terrain, WorldOptions
from app.viewer.scene.associations import arcs, outline
from app.viewer.scene.colors import Rgb, colorize, for_line_ends
from app.viewer.scene.layers import Scale, Surfels
from app.viewer.scene.nodes import LinePoints, lines_node, points_node
from app.viewer.scene.placement import UNKNOWN_CANVAS, Box, Canvas, Placement, frame_camera
from app.viewer.server.host import Host
from app.viewer.session.state import Camera, ColorMap
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.choosing import likely
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, LoopClosure, PairOfIds

NO_LINES = np.zeros((0, 2, 3), np.float32)

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
        return NO_LINES
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
LINES: dict[str, tuple[Rgb | None, float]] = {
    **{f"trajectories/{source}": (color, 3.0) for source, color in TRAJECTORY_COLORS.items()},
    "refused": ((165, 165, 165), 1.5),
    "marked": (SELECTED, 6.0),
    "ellipses": (TRAJECTORY_COLORS["corrected"], 2.0),
    "outlines": (OUTLINES, 1.0),
    "place": (SELECTED, 5.0),
    "selected": (SELECTED, 4.0),
    "loops": (None, 4.0),
}
"""The colour and the thickness [pixels] of all lines; those of None have colours of their own."""


def sides_of(places: Mapping[str, Float[Array, "2"]], width: float) -> dict[str, Side]:
    """Choose where each name stands at its place, so that names cover little of each other.

    Where a drive comes back, submaps share their place, seen from above with y up [m] on a map of
    a width [m]. The upper one chooses first: it likes to be above its place.
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


ELLIPSE_PIECES = 24
ELLIPSE_STDS = 3.0
"""Half axes of an ellipse, in standard deviations: nearly all of what is possible lies within."""


def ellipses(
    covariances: Mapping[str, Float[Array, "3 3"]], poses: Mapping[str, Pose], lift: float
) -> LinePoints:
    """Draw how certain each position is, as an ellipse so far above the ground [m]."""
    angles = np.linspace(0.0, 2 * np.pi, ELLIPSE_PIECES + 1)
    circle = ELLIPSE_STDS * np.stack([np.cos(angles), np.sin(angles)])
    rings = [NO_LINES]
    for name, covariance in covariances.items():
        values, axes = np.linalg.eigh(covariance[:2, :2])
        around = (axes * np.sqrt(np.maximum(values, 0.0))) @ circle
        ring = np.column_stack([*around, np.full(len(angles), lift)]) + poses[name].translation
        rings.append(np.stack([ring[:-1], ring[1:]], axis=1).astype(np.float32))
    return np.concatenate(rings)


class WorldScene:
    """All submaps of a dataset under one frame that can be hidden.

    Attributes:
        terrain: The ground that is shown.
        scale: What its colours mean.
        arches: The loops that are drawn.
    """

    def __init__(self, host: Host, *, visible: bool = False) -> None:
        """Make the frame; nothing is shown until `show`."""
        self._host = host
        self._root = host.scene.add_frame(WORLD, show_axes=False, visible=visible)
        self._nodes: list[_Node] = []
        self._lines = {
            name: lines_node(host, f"{WORLD}/{name}", *look) for name, look in LINES.items()
        }
        self._origin = np.zeros(3)
        self._shown: World | None = None
        self.terrain: MergedTerrain | None = None
        self._look: tuple[object, object] | None = None  # terrain and colours that the nodes have
        self.scale: Scale | None = None
        self._alone: dict[str, Terrain] = {}  # whose nodes have what is not merged yet
        self.arches: tuple[LoopClosure, ...] = ()
        self._extents: dict[str, Box] = {}
        self._lift = 0.0
        self._lock = threading.Lock()

    @property
    def visible(self) -> bool:
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

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
        with self._lock, self._host.atomic():
            self._measure(world)
            placed, ground = world.placed, self.terrain
            keeps = ground is not None and not merges and ground.surfaces.keys() <= placed.keys()
            if ground is None or not (keeps or ground.is_of(placed, world.poses)):
                ground = merge(placed, world.poses)
            self._dress(world, ground)
            self._shown = world
            loops = drawable(world.correction.loops, world.poses)
            self.arches = choose_arches(loops, world.options, world.selected)
            self._place(world.poses if at is None else at)
        self._host.flush()
        return self.scale

    def take(self, world: World, terrain: MergedTerrain) -> bool:
        """Show a ground that was merged of a world; says whether that still fits what is shown."""
        with self._lock:
            shown = self._shown
            if shown is None or not (
                has_grown(world.dataset, shown.dataset) and world.poses.keys() <= shown.poses.keys()
            ):
                return False
            with self._host.atomic():
                self._dress(shown, terrain)
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

    def _measure(self, world: World) -> None:
        """Measure the submaps of another dataset, and choose where the scene has its origin."""
        before = self._shown
        if before is not None and before.dataset is world.dataset:
            return
        if before is None or not has_grown(before.dataset, world.dataset):
            self._origin = _middle(world.poses)
        self._extents = {
            submap.id: Box.of(submap).seen_from(submap.centre) for submap in world.dataset.submaps
        }
        widths = [float(extent.size[0]) for extent in self._extents.values()]
        self._lift = LIFT * float(np.median(widths))

    def _dress(self, world: World, terrain: MergedTerrain) -> None:
        """Give each submap its part of a ground; what is not merged yet is shown as it is."""
        submaps, color = world.dataset.submaps, world.options.color
        self.terrain, look = terrain, (terrain, color)
        made = dict[str, Surfels]()
        if self._look != look:
            self._look, self.scale, self._alone = look, world_scale(terrain, color), {}
            made = pieces(terrain, color, self.scale)
        while len(self._nodes) > len(submaps):
            self._nodes.pop().remove()
        while len(self._nodes) < len(submaps):
            self._nodes.append(_Node(self._host, f"{WORLD}/submaps/{len(self._nodes)}"))
        sides, placed = self._sides(world), world.placed
        for place, (node, submap) in enumerate(zip(self._nodes, submaps, strict=True)):
            surface, name = placed.get(submap.id), submap.id
            if surface is None:
                node.hide()
                continue
            if name not in terrain.surfaces and self._alone.get(name) is not surface:
                self._alone[name] = surface
                alone = merge_at({name: surface}, world.poses, terrain.resolution)
                made |= pieces(alone, color, self.scale, place)
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
        pin, terrain = NO_LINES, self.terrain
        if cell is not None and terrain is not None:
            foot = terrain.positions[cell] - self._origin
            pin = np.array([[foot, foot + np.array([0.0, 0.0, 3 * self._lift])]], np.float32)
        self._lines["place"].put(points=pin)

    def camera(
        self, canvas: Canvas = UNKNOWN_CANVAS, forward: Float[Array, "3"] | None = None
    ) -> Camera | None:
        """Give the view in which all fills a canvas; None while nothing is shown."""
        return self._view(None, canvas, forward)

    def camera_at(self, name: str, canvas: Canvas = UNKNOWN_CANVAS) -> Camera | None:
        """Give the view of one submap; None if it is not shown."""
        return self._view(name, canvas)

    def _view(
        self, name: str | None, canvas: Canvas, forward: Float[Array, "3"] | None = None
    ) -> Camera | None:
        extents = self._extents  # another dataset's, while that is drawn first
        poses = {} if self._shown is None else self._shown.poses
        placed = tuple(
            (extents[one], Placement(*self._local(pose).row[:3], pose.planar.yaw))
            for one, pose in poses.items()
            if one in extents and name in (None, one)
        )
        return frame_camera(placed, canvas, forward=forward) if placed else None

    def path(self) -> Float[Array, "n 3"]:
        """Give the trajectory along the submaps in the scene [m]."""
        poses = {} if self._shown is None else self._shown.poses
        points = [pose.translation - self._origin for pose in poses.values()]
        return np.array(points, dtype=np.float64).reshape(-1, 3)

    def _place(self, poses: Mapping[str, Pose]) -> None:
        """Move the frames to poses, and draw trajectories and loops between them."""
        world, lift = self._shown, self._lift
        assert world is not None
        local = {name: self._local(pose) for name, pose in poses.items()}
        for node in self._nodes:
            if node.name in local:
                node.move(local[node.name])
        tracks = world.trajectories if world.options.trajectories else {}
        for source in TRAJECTORY_COLORS:
            # The trajectory that the submaps stand on moves along with them.
            track = tracks.get(source, {})
            along = (
                local
                if track and source == world.options.poses
                else {name: self._local(pose) for name, pose in track.items()}
            )
            self._lines[f"trajectories/{source}"].put(points=trajectory_lines(along, lift))
        accepted = [loop for loop in self.arches if loop.accepted]
        correction = world.correction
        colors = arch_colors(accepted, correction.highest_score, correction.wrong)
        loops = arches(accepted, local, lift)
        self._lines["loops"].put(points=loops, colors=for_line_ends(colors))
        refused = [loop for loop in self.arches if not loop.accepted]
        self._lines["refused"].put(points=arches(refused, local, lift))
        marked = [loop for loop in correction.loops if loop.pair == correction.marked]
        self._lines["marked"].put(points=arches(marked, local, 1.1 * lift))
        outlines = {
            name: outline(pose.apply(self._extents[name].corners)) for name, pose in local.items()
        }
        self._lines["outlines"].put(points=np.concatenate([NO_LINES, *outlines.values()]))
        self._lines["selected"].put(points=outlines.get(world.selected or "", NO_LINES))
        self._lines["ellipses"].put(points=ellipses(world.certain, local, lift))

    def _local(self, pose: Pose) -> Pose:
        """The pose in the scene's frame, whose numbers are small enough for the browser."""
        return Pose(pose.translation - self._origin, pose.quaternion)


class _Node:
    """One submap of the world."""

    def __init__(self, host: Host, root: str) -> None:
        self.name = ""
        self._frame = host.scene.add_frame(root, show_axes=False)
        self._surface = points_node(host, f"{root}/surface")
        self._host, self._root = host, root
        self._label: viser.LabelHandle | None = None  # most of many submaps have none

    def show(self, name: str, box: Box, ground: Surfels | None, side: Side | None) -> None:
        """Show a submap with the ground that it owns; None leaves that as it is.

        Its name stands at a side of its middle; None leaves it out.
        """
        self.name = name
        self._frame.visible = True
        if ground is not None:
            self._surface.put(**ground.properties)
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

    def move(self, pose: Pose) -> None:
        x, y, z, w = pose.quaternion
        self._frame.position = pose.translation
        self._frame.wxyz = np.array([w, x, y, z])

    def hide(self) -> None:
        self._frame.visible = False
        self.name = ""

    def remove(self) -> None:
        self._frame.remove()


def has_grown(before: Dataset, after: Dataset) -> bool:
    """Tell whether a dataset has all submaps of another, and then some more."""
    return after.submaps[: len(before.submaps)] == before.submaps


def _middle(poses: Mapping[str, Pose]) -> Float[Array, "3"]:
    points = np.array([pose.translation for pose in poses.values()])
    return (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)
