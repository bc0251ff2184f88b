"""The scene of the world: every submap at its pose, trajectories, and loops.

A submap is a frame with a surface beneath it, so that moving it sends a pose and nothing else.
"""

import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np
import viser
from jaxtyping import Float, UInt8

from app.viewer.features.world.merged import (
    Drape,
    MergedTerrain,
    drape,
    lines_of,
    merge,
    merge_at,
    pieces,
    world_scale,
)
from app.viewer.features.world.model import World
from app.viewer.features.world.submaps import PoseSource, Terrain, WorldOptions, first_surface
from app.viewer.scene.associations import arcs
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.scene.colors import INK, PAPER, Rgb, colorize, for_line_ends
from app.viewer.scene.layers import Scale, Surfels
from app.viewer.scene.nodes import LinePoints, lines_node, points_node
from app.viewer.scene.placement import UNKNOWN_CANVAS, Box, Canvas, Placement, frame_camera
from app.viewer.server.host import Host, pages
from app.viewer.session.state import Camera, ColorMap
from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.choosing import likely
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, LoopClosure, PairOfIds, Submap

NO_LINES = np.zeros((0, 2, 3), np.float32)

TRAJECTORY_COLORS: dict[PoseSource, Rgb] = {
    "true": PAPER,
    "odometry": (240, 132, 28),
    "corrected": (52, 146, 236),
}
SCORE_MAP: ColorMap = "viridis"
MOST_ARCHES = 60
"""Accepted loops that are drawn, and refused pairs; those of the chosen submap come on top."""
LOOP_PIECES = 24
"""Straight pieces of the arch of one loop."""
RISE = 0.35
"""How much higher its middle is than its feet, as a share of its span."""
GLOW = 0.4
"""How bright the glow round an arch is beside the arch."""
NEAR = 0.5
"""A refused pair is near from this share of the lowest score that was accepted on."""

Feet: TypeAlias = Mapping[str, Float[Array, "3"]]
"""Where what belongs to a submap stands: a margin above the ground in its middle [m]."""


def arches(loops: Iterable[LoopClosure], feet: Feet) -> LinePoints:
    """Span each `drawable` loop as an arch from foot to foot."""
    chosen = drawable(loops, feet)
    if not chosen:
        return NO_LINES
    start = np.array([feet[loop.database_id] for loop in chosen])
    end = np.array([feet[loop.query_id] for loop in chosen])
    return arcs(start, end, LOOP_PIECES, RISE)


def arch_colors(
    loops: Sequence[LoopClosure], highest: float, wrong: Collection[PairOfIds]
) -> UInt8[NDArray[np.uint8], "n 3"]:
    """Colour the pieces of `arches` by the score, from 0 to the highest; wrong ones are black."""
    scores = np.array([loop.registration.score for loop in loops], dtype=np.float64)
    colors = colorize(scores, 0.0, highest, SCORE_MAP)
    colors[[loop.pair in wrong for loop in loops]] = 0
    return np.repeat(colors, LOOP_PIECES, axis=0)


def strength_of(loop: LoopClosure, highest: float) -> int:
    """The index in `ARCH_WIDTHS` of a loop, by its score."""
    return int(np.clip(len(ARCH_WIDTHS) * loop.registration.score / highest, 0, 2))


def choose_arches(
    loops: Sequence[LoopClosure], options: WorldOptions, selected: str | None
) -> tuple[LoopClosure, ...]:
    """Choose the best loops, for more would hide the ground, and all of the selected submap."""
    chosen: list[LoopClosure] = []
    least = min((loop.registration.score for loop in loops if loop.accepted), default=np.inf)
    if options.loops and not options.refused:  # what was nearly accepted is shown, faintly
        near = likely(loop for loop in loops if not loop.accepted)[: MOST_ARCHES // 4]
        chosen += [loop for loop in near if loop.registration.score >= NEAR * least]
    for accepted, wanted in ((True, options.loops), (False, options.refused)):
        if wanted:
            ranked = likely(loop for loop in loops if loop.accepted is accepted)
            chosen += ranked[:MOST_ARCHES]
            chosen += [loop for loop in ranked[MOST_ARCHES:] if selected in loop.pair]
    return tuple(chosen)


def drawable(loops: Iterable[LoopClosure], poses: Mapping[str, object]) -> tuple[LoopClosure, ...]:
    """Keep the loops both of whose submaps have a pose."""
    return tuple(loop for loop in loops if poses.keys() >= set(loop.pair))


WORLD = "/world"
SELECTED: Rgb = (235, 40, 140)
MAX_NAMES = 60
Side: TypeAlias = Literal["bottom-center", "top-center", "center-left", "center-right"]
SIDES: dict[Side, tuple[float, float]] = {
    "bottom-center": (0.0, 0.5),
    "top-center": (0.0, -0.5),
    "center-left": (0.5, 0.0),
    "center-right": (-0.5, 0.0),
}
"""Which point of a name lies on its place, and where its middle is then, in its own sizes."""
LETTER, LINE = 0.016, 0.04
"""About how wide a letter of a name and how high a name is, in widths of the map."""
LIFT, LIFT_CELLS = 0.015, 3.0
"""How far tracks stand above the ground: widths of a submap, and cells of the ground at least."""
PIN = 0.24
"""How high the pin of a place is, in widths of a submap."""
DASH = 0.02
"""Length of the dashes of odometry, in widths of the map."""
ARCH_WIDTHS = 2.0, 3.0, 4.5
"""Of arches of low, middling and high scores [pixels]."""
LINES: dict[str, tuple[Rgb | None, float]] = {
    # Dark, a little lower and wider, so that each track stands out from any ground and page.
    **{f"edges/{source}": (INK, 6.0) for source in TRAJECTORY_COLORS},
    **{f"trajectories/{source}": (color, 3.0) for source, color in TRAJECTORY_COLORS.items()},
    "refused": ((165, 165, 165), 1.0),
    "marked": (SELECTED, 6.0),
    "ellipses": (TRAJECTORY_COLORS["corrected"], 2.0),
    "place": (SELECTED, 5.0),
    "selected": (SELECTED, 4.0),
    **{f"glow/{strength}": (None, width + 4.0) for strength, width in enumerate(ARCH_WIDTHS)},
    **{f"loops/{strength}": (None, width) for strength, width in enumerate(ARCH_WIDTHS)},
}
"""The colour and the thickness [pixels] of all lines; those of None have colours of their own."""


def sides_of(places: Mapping[str, Float[Array, "2"]], width: float) -> dict[str, Side]:
    """Choose which submaps have labels, and at which side, so that no label covers another.

    The places are from above with y up [m], on a map of a width [m]. The first that come
    choose first, and prefer to be above their place; without room there is no label.
    """
    chosen: dict[str, Side] = {}
    middles, sizes = np.zeros((0, 2)), np.zeros((0, 2))
    offsets = np.array(list(SIDES.values()))
    for name, place in places.items():
        size = width * np.array([LETTER * (len(name) + 1), LINE])
        candidates = place + offsets * size
        apart = np.abs(candidates[:, None] - middles)
        covered = np.maximum((size + sizes) / 2 - apart, 0.0).prod(axis=-1).sum(axis=-1)
        best = int(np.argmin(covered))
        if covered[best] > 0.05 * size.prod() or len(chosen) == MAX_NAMES:
            continue
        chosen[name] = list(SIDES)[best]
        middles, sizes = np.vstack([middles, candidates[best]]), np.vstack([sizes, size])
    return chosen


ELLIPSE_PIECES = 24
ELLIPSE_STDS = 3.0
"""Half axes of an ellipse, in standard deviations: nearly all of what is possible lies within."""


def ellipses(covariances: Mapping[str, Float[Array, "3 3"]], feet: Feet) -> LinePoints:
    """Draw how certain each position is, as an ellipse round its foot."""
    angles = np.linspace(0.0, 2 * np.pi, ELLIPSE_PIECES + 1)
    circle = ELLIPSE_STDS * np.stack([np.cos(angles), np.sin(angles)])
    rings = [NO_LINES]
    for name, covariance in covariances.items():
        values, axes = np.linalg.eigh(covariance[:2, :2])
        around = (axes * np.sqrt(np.maximum(values, 0.0))) @ circle
        ring = np.column_stack([*around, np.zeros(len(angles))]) + feet[name]
        rings.append(np.stack([ring[:-1], ring[1:]], axis=1).astype(np.float32))
    return np.concatenate(rings)


class WorldScene:
    """All submaps of a dataset under one frame that can be hidden."""

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
        self.terrain: MergedTerrain | None = None  # the ground that is shown
        self._look: tuple[object, object] | None = None  # terrain and colours that the nodes have
        self.scale: Scale | None = None  # what its colours mean
        self._alone: dict[str, Terrain] = {}  # whose nodes have what is not merged yet
        self.arches: tuple[LoopClosure, ...] = ()  # the loops that are drawn
        self._extents: dict[str, Box] = {}
        self._width = 0.0  # of a submap [m]
        self._margin = 0.0  # of what stands on the ground, above it [m]
        self._drapes: dict[str, Drape] = {}  # of tracks over the ground as it lies
        self._rises: dict[str, float] = {}  # of each foot above the pose of its submap [m]
        self._poses: Mapping[str, Pose] = {}  # at which the submaps stand just now
        self._feet: Feet = {}
        self._lock = threading.Lock()

    @property
    def origin(self) -> Float[Array, "3"]:
        """Where the scene's origin is in the world [m]."""
        return self._origin

    @property
    def names(self) -> Feet:
        """Where the names stand that are written, in the scene [m]."""
        down = np.array([0.0, 0.0, self._margin])  # no ground hides them: they stand on it
        return {node.name: self._feet[node.name] - down for node in self._nodes if node.is_named}

    @property
    def visible(self) -> bool:
        return self._root.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._root.visible = visible

    def show(
        self, world: World, at: Mapping[str, Pose] | None = None, *, merges: bool = True
    ) -> Scale | None:
        """Show a world as one consistent change; returns what its colours mean.

        ``at`` are other poses to put the submaps at for the moment, before `mover` moves them on.
        To merge the ground anew takes a while; else each submap keeps its part of it, and a new one
        lies on top, until `take` receives the ground.
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
                self._place(shown.poses)
        self._host.flush()
        return True

    def mover(self) -> Callable[[Mapping[str, Pose]], None]:
        """A mover of the submaps and what hangs on them, until another world is shown."""
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
        self._width = float(np.median(widths))

    def _dress(self, world: World, terrain: MergedTerrain) -> None:
        """Draw each submap's part of a ground; what is not merged yet is shown as it is."""
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
        self._lie(world, terrain)
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
            node.show(name, self._rises[name] - self._margin, made.get(name), sides.get(name))

    def _sides(self, world: World) -> dict[str, Side]:
        if not world.options.names:
            return {}
        names = list(world.poses)
        # Both ends first, and then as evenly along the drive as there is room.
        rank = {name: -(k & -k) for k, name in enumerate(names)}
        rank |= dict.fromkeys([*names[:1], *names[-1:]], -len(names)) | {world.selected: -np.inf}
        middles = {
            name: world.poses[name].translation[:2]
            for name in sorted(names, key=lambda name: rank[name])
        }
        return sides_of(middles, self._reach(world) + self._width)

    def _reach(self, world: World) -> float:
        """The longer side of the box round all poses [m]."""
        points = np.array([pose.translation[:2] for pose in world.poses.values()]).reshape(-1, 2)
        return float(np.ptp(points, axis=0).max()) if len(points) else 0.0

    def _lie(self, world: World, terrain: MergedTerrain) -> None:
        margin = self._margin = max(LIFT * self._width, LIFT_CELLS * terrain.resolution)
        places = np.array([pose.translation for pose in world.poses.values()]).reshape(-1, 3)
        rises = np.nan_to_num(terrain.heights_near(places[:, :2]) - places[:, 2]) + margin
        self._rises = dict(zip(world.poses, rises.tolist(), strict=True))
        self._drapes = {
            f"trajectories/{source}": drape(
                np.array([pose.translation for pose in track.values()]).reshape(-1, 3),
                terrain,
                margin,
            )
            for source, track in world.trajectories.items()
        }

    def pick(self, origin: Float[Array, "3"], direction: Float[Array, "3"]) -> int | None:
        """The cell of the terrain that a ray of the scene hits first."""
        terrain = self.terrain
        return None if terrain is None else terrain.hit(origin + self._origin, direction)

    def spot(self, cell: int) -> Float[Array, "3"]:
        assert self.terrain is not None
        return self.terrain.positions[cell] - self._origin

    def arch(self, pair: tuple[str, str]) -> Float[Array, "n 3"]:
        """The arch between two submaps in the scene [m]; empty if one is not shown."""
        feet = self._feet
        if not feet.keys() >= set(pair):
            return np.zeros((0, 3))
        query, database = (feet[name] for name in pair)
        pieces = arcs(database[None], query[None], LOOP_PIECES, RISE)
        return np.vstack([pieces[:, 0], pieces[-1:, 1]]).astype(np.float64)

    def outline(self, name: str | None) -> Float[Array, "n 3"]:
        """The outline of a submap over the ground, in the scene [m]; empty if not shown."""
        pose, extent = self._poses.get(name or ""), self._extents.get(name or "")
        if pose is None or extent is None:
            return np.zeros((0, 3))
        corners = pose.apply(extent.corners)
        corners = np.vstack([corners, corners[:1]])
        return drape(corners, self.terrain, self._margin).over(corners) - self._origin

    def arch_at(
        self, origin: Float[Array, "3"], direction: Float[Array, "3"], reach: float
    ) -> LoopClosure | None:
        """The loop whose arch a ray of the scene passes within so many radians, if any."""
        loops, feet = self.arches, self._feet
        loops = drawable(loops, feet)
        if not loops:
            return None
        pieces = arches(loops, feet).reshape(len(loops), LOOP_PIECES, 2, 3)
        arm = pieces.mean(axis=2) - origin
        depth = arm @ (direction / np.linalg.norm(direction))
        off = np.sqrt(np.maximum((arm**2).sum(axis=-1) - depth**2, 0.0))
        angles = np.where(depth > 0, off / np.maximum(depth, 1e-9), np.inf).min(axis=1)
        nearest = int(np.argmin(angles))
        return loops[nearest] if angles[nearest] < reach else None

    def mark(self, cell: int | None) -> None:
        pin, terrain = NO_LINES, self.terrain
        if cell is not None and terrain is not None:
            foot = self.spot(cell)
            pin = np.array([[foot, foot + np.array([0.0, 0.0, PIN * self._width])]], np.float32)
        self._lines["place"].put(points=pin)

    def camera(
        self,
        canvas: Canvas = UNKNOWN_CANVAS,
        forward: Float[Array, "3"] | None = None,
        *,
        parallel: bool = False,
        names: Collection[str] | None = None,
    ) -> Camera | None:
        """The view in which all, or some submaps, fill a canvas; None while none is shown."""
        extents = self._extents  # another dataset's, while that is drawn first
        poses = {} if self._shown is None else self._shown.poses
        placed = tuple(
            (extents[one], Placement(*self._local(pose).row[:3], pose.planar.yaw))
            for one, pose in poses.items()
            if one in extents and (names is None or one in names)
        )
        if not placed:
            return None
        return frame_camera(placed, canvas, forward=forward, parallel=parallel)

    def path(self) -> Float[Array, "n 3"]:
        poses = {} if self._shown is None else self._shown.poses
        points = [pose.translation - self._origin for pose in poses.values()]
        return np.array(points, dtype=np.float64).reshape(-1, 3)

    def _place(self, poses: Mapping[str, Pose]) -> None:
        """Move the frames to poses, and draw trajectories and loops between them."""
        world = self._shown
        assert world is not None
        self._poses, local = poses, {name: self._local(pose) for name, pose in poses.items()}
        self._feet = {
            name: pose.translation + np.array([0.0, 0.0, self._rises.get(name, 0.0)])
            for name, pose in local.items()
        }
        for node in self._nodes:
            if node.name in local:
                node.move(local[node.name])
        tracks = world.trajectories if world.options.trajectories else {}
        for source in TRAJECTORY_COLORS:
            # The trajectory that the submaps stand on moves along with them.
            track = tracks.get(source, {})
            along = poses if track and source == world.options.poses else track
            dash = DASH * self._reach(world) if source == "odometry" and len(tracks) > 1 else 0.0
            self._put_way(f"trajectories/{source}", f"edges/{source}", along.values(), dash)
        self._put_arches(world)
        self._lines["selected"].put(points=lines_of(self.outline(world.selected)))
        self._lines["ellipses"].put(points=ellipses(world.certain, self._feet))

    def _put_way(self, name: str, edge: str, poses: Iterable[Pose], dash: float) -> None:
        """Draw a track over the ground, and its dark edge a little lower."""
        places = np.array([self._local(pose).translation for pose in poses]).reshape(-1, 3)
        lying = self._drapes.get(name)
        if lying is None or lying.num_places != len(places) or len(places) < 2:
            lying = drape(places, None, 0.0)
        way = lying.over(places) if len(places) else places
        lines = lines_of(way, dash)
        lower = np.array([0.0, 0.0, 0.2 * self._margin], np.float32)
        self._lines[name].put(points=lines)
        self._lines[edge].put(points=lines - lower)

    def _put_arches(self, world: World) -> None:
        correction = world.correction
        highest = correction.highest_score
        accepted = [loop for loop in self.arches if loop.accepted]
        for strength in range(len(ARCH_WIDTHS)):
            loops = [loop for loop in accepted if strength_of(loop, highest) == strength]
            points = arches(loops, self._feet)
            colors = arch_colors(drawable(loops, self._feet), highest, correction.wrong)
            glow = (GLOW * colors).astype(np.uint8)
            self._lines[f"loops/{strength}"].put(points=points, colors=for_line_ends(colors))
            self._lines[f"glow/{strength}"].put(points=points, colors=for_line_ends(glow))
        refused = [loop for loop in self.arches if not loop.accepted]
        self._lines["refused"].put(points=arches(refused, self._feet))
        marked = [loop for loop in correction.loops if loop.pair == correction.marked]
        self._lines["marked"].put(points=arches(marked, self._feet))

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

    def show(self, name: str, rise: float, ground: Surfels | None, side: Side | None) -> None:
        """Show a submap with the ground that it owns; None leaves that as it is.

        Its name stands at a side of the ground there, so far above its middle [m]; None leaves it
        out. No ground hides it.
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
        self._label.position = (0.0, 0.0, rise)

    @property
    def is_named(self) -> bool:
        return bool(self.name) and self._label is not None and self._label.visible

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
    """Whether a dataset has all submaps of another, and then some more."""
    return after.submaps[: len(before.submaps)] == before.submaps


def _middle(poses: Mapping[str, Pose]) -> Float[Array, "3"]:
    points = np.array([pose.translation for pose in poses.values()])
    return (points.min(axis=0) + points.max(axis=0)) / 2 if len(points) else np.zeros(3)


class Pace:
    """Says when to show what grows, so that showing takes a small part of the time."""

    RESTS_FOR, LEAST = 6.0, 0.3
    """Pause after a showing: so many times as long as that took, and at least so long [s]."""

    def __init__(self) -> None:
        self._due = self._began = 0.0

    @property
    def is_due(self) -> bool:
        """Whether to show now; `rest` ends the showing."""
        self._began = time.monotonic()
        return self._began >= self._due

    def rest(self) -> None:
        now = time.monotonic()
        self._due = now + max(self.LEAST, self.RESTS_FOR * (now - self._began))


class FirstGround:
    """Shows submaps straight from their points, until the session's map takes its place."""

    def __init__(self, server: viser.ViserServer, memo: Memo) -> None:
        self._server, self._memo = server, memo
        self._scene = WorldScene(server, visible=True)
        self._submaps: list[Submap] = []
        self._surfaces: dict[str, Terrain] = {}
        self._pace = Pace()

    def add(self, submap: Submap) -> None:
        """Add one more submap, and show all so far if that is due."""
        self._submaps.append(submap)
        self._surfaces[submap.id] = self._memo(first_surface, submap)
        if not self._pace.is_due:
            return
        dataset = Dataset("", tuple(self._submaps))
        world = World.of(dataset, WorldOptions(trajectories=False, names=False))
        self._scene.show(world.with_surfaces(self._surfaces))
        camera = self._scene.camera()
        assert camera is not None
        set_start(self._server, camera)
        for page in pages(self._server).values():
            set_view(page, camera)
        self._pace.rest()
