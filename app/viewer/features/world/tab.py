"""The World tab: wires its panel to a worker, and the worker to the world's scene."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature, Frame, ModeSwitch
from app.viewer.features.work import Work
from app.viewer.features.world.panel import NOTHING, WorldPanel
from app.viewer.features.world.scene import Loop, World, WorldScene
from app.viewer.features.world.submaps import (
    NEEDS_INFERENCE,
    PoseSource,
    Surface,
    WorldOptions,
    figures_of,
    inferred_surface,
    pose_sources,
    poses_of,
    quick_surface,
)
from app.viewer.scene.animation import Animation, ease, play
from app.viewer.scene.cameras import set_start, set_view
from app.viewer.scene.layers import Scale
from app.viewer.scene.placement import UNKNOWN_CANVAS, Canvas
from app.viewer.server.host import pages
from app.viewer.session.methods import map_params
from app.viewer.session.state import Camera, ViewState, believed_pose
from app.viewer.widgets.actions import on_choice, on_option, on_press_by, on_step
from app.viewer.widgets.legend import legend_html
from gpgrad_core.arrays import Array
from gpgrad_core.run.progress import Progress, part
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import OptimisedGraph

RELAXING_SECONDS = 4.0


@dataclass(frozen=True, eq=False)
class Correction:
    """What the pose graph says of the world.

    Attributes:
        graph: The optimised graph; None before the first optimisation.
        loops: Pairs of submaps, accepted and refused.
        highest_score: Of the last colour of the loops.
        marked: Pair (query, database) whose loop stands out.
    """

    graph: OptimisedGraph | None = None
    loops: tuple[Loop, ...] = ()
    highest_score: float = 1.0
    marked: tuple[str, str] | None = None

    @property
    def corrected(self) -> Mapping[str, Pose] | None:
        """The corrected poses, if there are any."""
        return None if self.graph is None else self.graph.poses


@dataclass(frozen=True, eq=False)
class _Drawing:
    state: ViewState
    options: WorldOptions
    correction: Correction
    selected: str | None
    relaxing: bool = False  # move from odometry to the corrected poses

    @property
    def infers(self) -> bool:
        """Whether it needs maps of the Gaussian process, which take a while."""
        return self.options.color in NEEDS_INFERENCE


@dataclass(frozen=True, eq=False)
class _DrawnWorld:
    world: World
    scale: Scale | None


class WorldTab(Feature):
    """The world in which all submaps lie; drawn only while it is looked at."""

    def __init__(self, desk: Desk, modes: ModeSwitch, frame: Frame) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._modes = modes
        self._host = desk.host
        self._lock = threading.Lock()
        self._state = desk.state
        self._options = WorldOptions(poses=pose_sources(desk.state.dataset)[0])
        self._correction = Correction()
        self._selected: str | None = None
        self._drawn: _DrawnWorld | None = None
        self._made: tuple[object, dict[str, Surface]] | None = None  # quick surfaces
        self._framed: object = None  # the dataset that the cameras were brought to
        self.scene = WorldScene(desk.host)
        panel = self.panel = WorldPanel(
            desk.host, self._options, lambda options: self._change(options=options)
        )
        on_choice(panel.chosen, lambda name: self._pick(None if name == NOTHING else name))
        on_step(panel.steps, self._step)
        on_option(panel.roles, self._tune)
        on_press_by(panel.look, self._look)
        on_press_by(panel.all, frame)
        self._offer()
        self.panel.select(None, ())
        self._work: Work[_Drawing, _DrawnWorld] = Work(
            self.panel.work_bar,
            lambda job: "Making the maps" if job.infers else "",
            self._draw,
            self._on_result,
            on_cancel=self._on_cancel,
            slots=desk.capacity.pictures,
            name="world",
        )
        self.workers = (self._work,)

        @desk.host.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            if self.scene.visible:
                self.click(event.ray_origin, event.ray_direction)

    # What the session and the other parts tell.

    def follow(self, state: ViewState) -> None:
        """Follow the session; another dataset is another world."""
        with self._lock:
            before, self._state = self._state, state
            if before.dataset is not state.dataset:
                self._correction, self._selected = Correction(), None
                source = pose_sources(state.dataset)[0]
                self._options = replace(self._options, poses=source, color="submap")
        if before.dataset is not state.dataset:
            self._offer()
            self.panel.select(None, ())
            self._submit()
        elif (before.method, before.given.map) != (state.method, state.given.map) or (
            before.params.features.max_std_ratio != state.params.features.max_std_ratio
        ):
            self._submit()

    def open(self, *, visible: bool) -> None:
        """Show the world, or put it away."""
        self.scene.visible = visible
        if visible:
            self._submit()

    def correct(self, correction: Correction, *, relax: bool = False) -> None:
        """Take what the pose graph says.

        Args:
            correction: Poses and loops.
            relax: Show how the submaps move from odometry to the corrected poses.
        """
        with self._lock:
            gone = self._options.poses == "corrected" and correction.corrected is None
            self._correction = correction
            sources = pose_sources(self._state.dataset, correction.corrected)
            if relax and correction.corrected is not None:
                self._options = replace(self._options, poses="corrected")
            elif gone:
                self._options = replace(self._options, poses=sources[0])
        self._offer()
        if self._selected is not None:
            self.select(self._selected)
        self._submit(relaxing=relax)

    def relax(self) -> None:
        """Show again how the submaps move from odometry to the corrected poses."""
        self.correct(self._correction, relax=True)

    def set_loops_shown(self, *, loops: bool, refused: bool) -> None:
        """Choose which loops are drawn."""
        self._change(options=replace(self._options, loops=loops, refused=refused))

    def select(self, name: str | None) -> None:
        """Choose a submap to look at, or none."""
        with self._lock:
            self._selected = name
        self.panel.select(name, () if name is None else self._figures(name))
        self._submit()

    @property
    def world(self) -> World | None:
        """What is shown, or was last."""
        return None if self._drawn is None else self._drawn.world

    @property
    def scale(self) -> Scale | None:
        """What its colours mean."""
        return None if self._drawn is None else self._drawn.scale

    @property
    def graph(self) -> OptimisedGraph | None:
        """The optimised pose graph, if there is one."""
        return self._correction.graph

    def camera(
        self, canvas: Canvas = UNKNOWN_CANVAS, forward: Float[Array, "3"] | None = None
    ) -> Camera | None:
        """Give the view in which all fills a canvas; see `frame_camera`."""
        return self.scene.camera(canvas, forward)

    # What the widgets and the mouse ask for; quick.

    def _change(self, *, options: WorldOptions) -> None:
        with self._lock:
            self._options = options
        self._offer()
        self._submit()

    def _offer(self) -> None:
        dataset = self._state.dataset
        sources = pose_sources(dataset, self._correction.corrected)
        self.panel.offer_world(
            self._options, sources, tuple(submap.id for submap in dataset.submaps)
        )

    def _submit(self, *, relaxing: bool = False) -> None:
        if not self.scene.visible:
            return
        with self._lock:
            job = _Drawing(self._state, self._options, self._correction, self._selected, relaxing)
        self._work.start(job)

    def _step(self, step: int) -> None:
        ids = [submap.id for submap in self._state.dataset.submaps]
        if self._selected in ids:
            self._pick(ids[(ids.index(self._selected) + step) % len(ids)])
        else:
            self._pick(ids[0] if step > 0 else ids[-1])

    def _pick(self, name: str | None) -> None:
        """Choose a submap, and its likeliest pair: the verdict beside the world is of that."""
        self.select(name)
        if name is not None:
            pair = _likeliest(name, self._correction.loops, self._state)
            if pair is not None:
                self._desk.choose(*pair)

    def _tune(self, role: str) -> None:
        """Show the chosen submap in Tune, with the submap that has the other role there."""
        state, chosen = self._state, self._selected
        if chosen is None:
            return
        query, database = state.query_id, state.database_id
        if role == "query":
            self._modes.tune(chosen, database if database != chosen else query)
        else:
            self._modes.tune(query if query != chosen else database, chosen)

    def click(self, origin: tuple[float, float, float], toward: tuple[float, float, float]) -> None:
        """Choose the submap that a line of sight meets first, if it meets one."""
        hit = self.scene.pick(np.array(origin, float), np.array(toward, float))
        if hit is not None:
            self._pick(hit)

    def _look(self, page: viser.ClientHandle) -> None:
        if self._selected is not None:
            camera = self.scene.camera_at(self._selected, self._desk.canvases.of(page))
            if camera is not None:
                set_view(page, camera)

    # What the worker does.

    def _draw(self, job: _Drawing, progress: Progress) -> _DrawnWorld:
        dataset, options, correction = job.state.dataset, job.options, job.correction
        surfaces = self._surfaces(job, progress)
        trajectories: dict[PoseSource, Mapping[str, Pose]] = {
            source: poses_of(dataset, source, correction.corrected)
            for source in pose_sources(dataset, correction.corrected)
            if source != "in rows"
        }
        world = World(
            dataset,
            surfaces,
            poses_of(dataset, options.poses, correction.corrected),
            trajectories,
            options,
            correction.loops,
            job.selected,
            correction.marked,
            correction.highest_score,
        )
        graph = correction.graph
        if not job.relaxing or graph is None:
            return _DrawnWorld(world, self.scene.show(world))
        scale = self.scene.show(world, at=graph.at(0.0))
        # The maps are there by now; what moves is no progress, but can be cancelled.
        play(relaxation(graph, self.scene.mover()), lambda _: progress(1.0))
        return _DrawnWorld(world, scale)

    def _surfaces(self, job: _Drawing, progress: Progress) -> dict[str, Surface]:
        submaps, params = job.state.dataset.submaps, job.state.params
        key = job.state.dataset, params.map
        if not job.infers and self._made is not None and self._made[0] == key:
            return self._made[1]
        surfaces: dict[str, Surface] = {}
        for place, submap in enumerate(submaps):
            if job.infers:
                share = part(progress, place / len(submaps), (place + 1) / len(submaps))
                memo, state = self._desk.memo, job.state
                fitted = map_params(submap, state.given, memo, share, state.method)
                surfaces[submap.id] = inferred_surface(submap, fitted, memo, share)
            else:
                surfaces[submap.id] = quick_surface(submap, params, self._desk.memo, len(submaps))
                progress((place + 1) / len(submaps))
        if not job.infers:
            self._made = key, surfaces
        return surfaces

    def _on_result(self, job: _Drawing, drawn: _DrawnWorld, seconds: float) -> None:
        self._drawn = drawn
        self.panel.show_summary(
            _summary(drawn.world, self.scene.num_cells, self.scene.num_arches, seconds)
        )
        self.panel.legend.content = legend_html(drawn.scale)
        self._desk.canvases.scales["world"] = drawn.scale
        if job.selected is not None and job.infers:
            self.panel.select(job.selected, self._figures(job.selected))
        if self._framed is not job.state.dataset:
            self._framed = job.state.dataset
            camera = self.camera()
            if camera is not None:
                if isinstance(self._host, viser.ViserServer):
                    set_start(self._host, camera)
                for page in pages(self._host).values():
                    whole = self.camera(self._desk.canvases.of(page))
                    assert whole is not None
                    self._desk.canvases.bring(page, whole)
        self._host.flush()

    def _on_cancel(self, job: _Drawing) -> None:
        """Go back to colours that need no inferred maps."""
        del job
        self._change(options=replace(self._options, color="submap"))

    def _figures(self, name: str) -> tuple[tuple[str, str], ...]:
        corrected = (self._correction.corrected or {}).get(name)
        rows = figures_of(self._state.dataset.submap(name), corrected)
        surface = None if self.world is None else self.world.surfaces.get(name)
        if surface is None or self._options.color not in NEEDS_INFERENCE:
            return rows
        trusted = surface.gradient_map.trusted(surface.max_std_ratio)
        if not trusted.any():
            return rows
        return (
            *rows,
            ("median deviation", f"{np.median(surface.gradient_map.std[trusted]):.4f} m"),
            ("median gradient", f"{np.median(surface.gradient_map.gradient[trusted]):.3f} m/m"),
        )


def relaxation(graph: OptimisedGraph, move: Callable[[Mapping[str, Pose]], None]) -> Animation:
    """Animate the world from odometry to the corrected poses, as the solver went."""
    return Animation(RELAXING_SECONDS, lambda share: move(graph.at(ease(share))), rest=1.5)


def _likeliest(name: str, loops: tuple[Loop, ...], state: ViewState) -> tuple[str, str] | None:
    """Find the pair of a submap that is most likely a loop closure.

    By the highest score, accepted pairs first. Before pairs are compared, by the nearest submap
    that is no neighbour on the way.
    """
    own = [loop for loop in loops if name in loop.pair]
    if own:
        return max(own, key=lambda loop: (loop.accepted, loop.score)).pair
    submaps = state.dataset.submaps
    ids = [submap.id for submap in submaps]
    poses = [believed_pose(submap) for submap in submaps]
    place = ids.index(name)
    here = poses[place]
    if here is None:
        return None
    away = {
        k: float(np.linalg.norm(pose.translation[:2] - here.translation[:2]))
        for k, pose in enumerate(poses)
        if pose is not None and abs(k - place) > 1
    }
    if not away:
        return None
    other = min(away, key=lambda k: away[k])
    return ids[max(place, other)], ids[min(place, other)]


def _summary(world: World, num_cells: int, num_arches: int, seconds: float) -> tuple[str, ...]:
    count, shown = len(world.dataset.submaps), len(world.poses)
    lines = [f"{shown} submaps · {num_cells:,} cells · {1000 * seconds:.0f} ms"]
    if world.options.poses == "in rows":
        lines.append("The dataset has no poses, so the submaps lie in rows.")
    elif shown < count:
        lines.append(f"{count - shown} of {count} submaps have no such pose and are not shown.")
    wanted = sum(
        world.options.loops if loop.accepted else world.options.refused for loop in world.loops
    )
    if num_arches < wanted:
        own = "" if world.selected is None else f", and all of {world.selected}"
        lines.append(
            f"{num_arches:,} of {wanted:,} loops are drawn: those with the highest scores{own}."
        )
    return tuple(lines)
