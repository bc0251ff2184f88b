"""The World tab: wires its widgets to a worker, and the worker to the world's scene."""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from typing import TypeAlias, cast

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature, ModeSwitch
from app.viewer.features.work import Work, message_of
from app.viewer.features.world.merged import MergedTerrain, merge
from app.viewer.features.world.rail import WorldRail, map_legend
from app.viewer.features.world.scene import Correction, Past, World, WorldScene
from app.viewer.features.world.submaps import (
    PoseSource,
    Terrain,
    WorldOptions,
    figures_of,
    inferred_surface,
    pose_sources,
    poses_of,
    quick_surface,
)
from app.viewer.scene.cameras import Animation, ease, play, set_start, set_view
from app.viewer.scene.layers import Scale
from app.viewer.server.host import Host, on_scene_click, pages
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import map_params
from app.viewer.session.news import AllPairs, SessionState
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_choice, on_option, on_press_by
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import FAINT, paragraph, summary, table
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.panel import Panel
from app.viewer.widgets.status import WorkBar
from gpgrad_core.arrays import Array
from gpgrad_core.detection.choosing import closest_pair, likely
from gpgrad_core.errors import InputError
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import OptimisedGraph
from gpgrad_core.slam.graph import shifted
from gpgrad_core.types import Dataset, Submap

NOTHING: str = "none"
THEN: PoseSource = "at that time"


class WorldPanel(Panel[WorldOptions]):
    """Widgets of the world and of one submap in it; the tab binds what they do."""

    work_bar: WorkBar
    legend: viser.GuiHtmlHandle

    def __init__(
        self, host: Host, options: WorldOptions, on_change: Callable[[WorldOptions], None]
    ) -> None:
        """Make the widgets in the current container; they report the whole new options."""
        gui = host.gui
        self.summary = gui.add_html("")

        def add_legend() -> None:
            self.legend = gui.add_html("")
            self.work_bar = WorkBar(host, "Cancel maps", "world")

        super().__init__(host, options, on_change, below={"color": add_legend})
        self.chosen: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Submap",
            (NOTHING,),
            initial_value=NOTHING,
            hint="You can also click a submap in the scene.",
        )
        self.figures = gui.add_html("")
        self.look = gui.add_button(
            "Look at it", visible=False, hint="Moves the camera to this submap."
        )
        self.roles = gui.add_button_group(
            "Tune it as",
            ("query", "database"),
            visible=False,
            hint="Opens this submap in Tune, as the query or the database.",
        )

    def offer_world(
        self, options: WorldOptions, sources: tuple[PoseSource, ...], ids: tuple[str, ...]
    ) -> None:
        """Show options, and what there is to choose from; nothing is called."""
        self.offer("poses", sources)
        self.set(options)
        if tuple(self.chosen.options) != (NOTHING, *ids):
            self.chosen.options = (NOTHING, *ids)
            self.chosen.value = NOTHING

    def select(self, name: str | None, rows: tuple[tuple[str, str], ...]) -> None:
        """Show which submap is chosen, and its figures."""
        self.chosen.value = NOTHING if name is None else name
        self.look.visible = self.roles.visible = name is not None
        if name is None:
            self.figures.content = paragraph("Click a submap in the scene.", FAINT)
            return
        self.figures.content = (
            f'<div data-testid="submap-figures" style="padding:.1em .75em .3em">'
            f"<b>Submap {escape(name)}</b>{table(rows)}</div>"
        )


RELAXING_SECONDS = 4.0
CHANGED_AT_ONCE = 8
"""Grids of a dataset that grows are made coarser so many at a time."""
RESTS_FOR = 8.0
"""Before a ground that grows is merged anew, it is left alone for so many times as long as that
took last."""
REST = 0.25
"""A map that has not moved for so long rests [s]."""


@dataclass(frozen=True, eq=False)
class _Drawing:
    state: ViewState
    options: WorldOptions
    correction: Correction
    selected: str | None
    share: float = 1.0  # from before the pose graph to after it
    relaxing: bool = False  # move from odometry to the corrected poses
    past: Past | None = None  # what is shown in place of the whole

    @property
    def dataset(self) -> Dataset:
        """The submaps that may be drawn."""
        return self.state.dataset if self.past is None else self.past.dataset


_DrawnWorld: TypeAlias = tuple[World, Scale | None]
"""What is shown, and what its colours mean."""


class WorldTab(Feature):
    """The world in which all submaps lie; drawn only while it is looked at.

    Attributes:
        scene: Where they lie.
        world: What is shown, or was last.
    """

    def __init__(self, desk: Desk, modes: ModeSwitch) -> None:
        """Make the panel in the current container."""
        self._desk = desk
        self._modes = modes
        self._host = desk.host
        self._lock = threading.Lock()
        self._state = desk.state
        self._options = WorldOptions(poses=pose_sources(desk.state.dataset)[0])
        self._correction = Correction()
        self._selected: str | None = None
        self.world: World | None = None
        # Quick surfaces: of which submap, and of how many each was to be one.
        self._made: tuple[object, dict[str, tuple[Submap, int, Terrain]]] = None, {}
        self._inferred: tuple[object, dict[str, Terrain]] = (None, {})  # as many as there are yet
        self._share = 1.0  # from before the pose graph to after it
        self._place: Float[Array, 2] | None = None  # that was clicked, in the world [m]
        self.rail: WorldRail | None = None
        self._past: Past | None = None
        self._declined: object = None  # what a user did not want to be inferred
        self._framed: object = None  # the dataset that the cameras were brought to
        self.scene = WorldScene(desk.host)
        panel = self.panel = WorldPanel(
            desk.host, self._options, lambda options: self._change(options=options)
        )
        on_choice(panel.chosen, lambda name: self._pick(None if name == NOTHING else name))
        on_option(panel.roles, self._tune)
        on_press_by(panel.look, self._look)
        self._offer()
        self.panel.select(None, ())
        self._work: Work[_Drawing, _DrawnWorld] = Work(
            desk.jobs,
            self.panel.work_bar,
            lambda job: "Making the maps" if self._missing(job) and not _goes_on(job) else "",
            self._draw,
            self._on_result,
            on_cancel=self._on_cancel,
            slots=desk.capacity.pictures,
        )
        self._mover: Lane[float, None] = Lane(
            desk.jobs,
            self._slide,
            lambda _share, _nothing, _seconds: self._settle(),
            lambda _, error: panel.work_bar.failed(message_of(error)),
        )
        self._settler: Lane[None, None] = Lane(
            desk.jobs,
            lambda _nothing, _progress: self._submit(),
            lambda _nothing, _result, _seconds: None,
            lambda _, error: panel.work_bar.failed(message_of(error)),
            rest=REST,
        )
        self._merger: Lane[World, MergedTerrain] = Lane(
            desk.jobs,
            self._merge,
            lambda world, terrain, _seconds: self._take(world, terrain),
            lambda _, error: panel.work_bar.failed(message_of(error)),
        )
        self._rested = 0.0  # when it may do so again

        def clicked(event: viser.SceneClickEvent) -> None:
            if self.scene.visible:
                self.click(event.ray_origin, event.ray_direction)

        on_scene_click(desk.host, clicked)

    def add_rail(self) -> None:
        """Make the rail in the current container."""
        self.rail = WorldRail(self._host, self.move_to)

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Take the full maps that the comparison of all pairs has made."""
        if pairs.verdicts is not before.verdicts:
            with self._lock:
                self._inferred = None, {}

    def move_to(self, share: float) -> None:
        """Move the map from before the pose graph (0) to after it (1)."""
        with self._lock:
            if self._correction.graph is None:
                return
            self._share = share
            begins = self._options.poses != "corrected"
            self._options = replace(self._options, poses="corrected")
        if begins:
            self._offer()
            self._submit()
        self._mover.submit(share)

    def _slide(self, share: float, _progress: Progress) -> None:
        graph, world = self._correction.graph, self.world
        if graph is not None and world is not None and world.options.poses == "corrected":
            self.scene.mover()(graph.at(share))

    def _settle(self) -> None:
        """Merge the ground anew once the map rests."""
        self._settler.cancel()  # or it would rest since the move before
        self._settler.submit(None)

    def add_commands(self, commands: Commands) -> None:
        """Add the steps through the submaps to the palette."""
        for label, step in (("Next submap", 1), ("Previous submap", -1)):
            commands.add("Explore", label, partial(self._step, step))

    # What the session and the other parts tell.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the session; another dataset is another world, and the rail is beside it only."""
        was, now = before.view, state.view
        with self._lock:
            self._state = now
            if was.dataset is not now.dataset:
                self._correction, self._selected = Correction(), None
                self._share, self._place, self._past = 1.0, None, None
                source = pose_sources(now.dataset)[0]
                self._options = replace(self._options, poses=source)
        if was.dataset is not now.dataset:
            self._offer()
            self.panel.select(None, ())
            self._submit()
        elif (was.method, was.given.map) != (now.method, now.given.map) or (
            was.params.features.max_std_ratio != now.params.features.max_std_ratio
        ):
            self._submit()
        if self.rail is not None and state.subject != before.subject:
            self.rail.visible = state.subject == "world"

    def open(self, *, visible: bool) -> None:
        """Show the world, or put it away."""
        self.scene.visible = visible
        if visible:
            self._submit()

    def correct(self, correction: Correction, *, relax: bool = False) -> None:
        """Take what the pose graph says, and show how the submaps relax to it if asked."""
        if relax:
            self._leave_past()
        with self._lock:
            gone = self._options.poses == "corrected" and correction.corrected is None
            self._correction = correction
            sources = pose_sources(self._state.dataset, correction.corrected)
            if relax or correction.graph is None:
                self._share = 1.0
            if relax and correction.corrected is not None:
                self._options = replace(self._options, poses="corrected")
            elif gone:
                self._options = replace(self._options, poses=sources[0])
        self._offer()
        if self._selected is not None:
            self.select(self._selected)
        self._submit(relaxing=relax)

    def show_past(self, past: Past | None) -> None:
        """Show what there was at some time of a drive, or the whole again."""
        with self._lock:
            turns = (past is None) != (self._past is None)
            self._past = past
        if turns:
            self._offer()
        self._submit()

    def _leave_past(self) -> None:
        """Show the whole, because poses of the whole are wanted."""
        if self._past is not None:
            self._desk.notify(lambda feature: feature.on_drive("latest wanted"))

    def is_drawn(self, timeout: float) -> bool:
        """Wait until the last wish is drawn; says whether that came true within the timeout [s]."""
        return self._work.wait_idle(timeout)

    def relax(self) -> None:
        """Show again how the submaps move from odometry to the corrected poses."""
        self.correct(self._correction, relax=True)

    def set_loops_shown(self, *, loops: bool, refused: bool) -> None:
        """Choose which loops are drawn."""
        poses = self._options.poses if self._past is None else THEN
        self._change(options=replace(self._options, poses=poses, loops=loops, refused=refused))

    def select(self, name: str | None) -> None:
        """Choose a submap to look at, or none."""
        with self._lock:
            self._selected = name
            self.panel.select(name, () if name is None else self._figures(name))
        self._submit()

    @property
    def graph(self) -> OptimisedGraph | None:
        """The optimised pose graph, if there is one."""
        return self._correction.graph

    # What the widgets and the mouse ask for; quick.

    def _change(self, *, options: WorldOptions) -> None:
        with self._lock:
            stays = self._past is not None and options.poses == THEN
            self._options = replace(options, poses=self._options.poses) if stays else options
        if not stays:
            self._leave_past()
        self._offer()
        self._submit()

    def _offer(self) -> None:
        dataset = self._state.dataset
        sources = pose_sources(dataset, self._correction.corrected)
        options = self._options
        if self._past is not None:
            options = replace(options, poses=THEN)
            sources = cast("tuple[PoseSource, ...]", (*sources, THEN))
        self.panel.offer_world(options, sources, tuple(submap.id for submap in dataset.submaps))

    def _submit(self, *, relaxing: bool = False) -> None:
        if not self.scene.visible:
            return
        with self._lock:
            job = _Drawing(
                self._state,
                self._options,
                self._correction,
                self._selected,
                self._share,
                relaxing,
                self._past,
            )
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
            own = likely(loop for loop in self._correction.loops if name in loop.pair)
            # Before pairs are compared, the nearest submap that is no neighbour on the way.
            pair = own[0].pair if own else closest_pair(self._state.dataset, of=name)
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
        terrain = self.scene.terrain
        if hit is not None and terrain is not None:
            self._place = terrain.positions[hit, :2].copy()
            name = terrain.names[terrain.owner[hit]]
            if any(submap.id == name for submap in self._state.dataset.submaps):
                self._pick(name)

    def _look(self, page: viser.ClientHandle) -> None:
        if self._selected is not None:
            camera = self.scene.camera_at(self._selected, self._desk.canvases.of(page))
            if camera is not None:
                set_view(page, camera)

    # What the worker does.

    def _draw(self, job: _Drawing, progress: Progress) -> _DrawnWorld:
        quick = self._quick_surfaces(job)
        if _goes_on(job):
            return self._show(job, quick | self._of(job), progress)
        if self._missing(job) and not job.relaxing:
            self._show_drawn(job, self._show(job, quick | self._of(job)))
        self._infer(job, quick, progress)
        return self._show(job, quick | self._of(job), progress)

    def _show(
        self, job: _Drawing, surfaces: Mapping[str, Terrain], progress: Progress = silent
    ) -> _DrawnWorld:
        """Draw the world of such surfaces, and relax it if the job says so."""
        if job.past is not None:
            return self._show_past(job, job.past, surfaces, progress)
        dataset, options, correction = job.state.dataset, job.options, job.correction
        trajectories: dict[PoseSource, Mapping[str, Pose]] = {
            source: poses_of(dataset, source, correction.corrected)
            for source in pose_sources(dataset, correction.corrected)
            if source != "in rows"
        }
        world = World(
            dataset,
            surfaces,
            _poses_of(job),
            trajectories,
            options,
            correction,
            job.selected,
        )
        graph = correction.graph
        if not job.relaxing or graph is None:
            return world, self.scene.show(world)
        scale = self.scene.show(world, at=graph.at(0.0))
        # The maps are there by now; what moves is no progress, but can be cancelled.
        play(relaxation(graph, self.scene.mover()), lambda _: progress(1.0))
        return world, scale

    def _show_past(
        self, job: _Drawing, past: Past, surfaces: Mapping[str, Terrain], progress: Progress
    ) -> _DrawnWorld:
        """Draw what there was at some time, and move it there if the past says so."""
        tracks: dict[PoseSource, Mapping[str, Pose]] = {
            "odometry": past.odometry,
            "corrected": past.poses,
        }
        options = replace(job.options, poses="corrected", refused=True)
        correction = Correction(
            loops=past.loops, wrong=past.wrong, highest_score=past.highest_score
        )
        world = World(past.dataset, surfaces, past.poses, tracks, options, correction, None, past)
        start, merges = past.moves_from, not (past.grows and past.goes_on)
        if merges:
            self._merger.cancel()
        scale = self.scene.show(world, at=start, merges=merges)
        if not merges:
            self._merger.submit(world)
        if start is None:
            return world, scale
        self._tell_of(job, (world, scale))  # what is told comes with the submap, not after its way
        move = self.scene.mover()
        play(
            Animation(past.seconds, lambda share: move(between(start, past.poses, ease(share)))),
            progress,
        )
        return world, scale

    def _quick_surfaces(self, job: _Drawing) -> dict[str, Terrain]:
        """Make the smoothed grids, which stand in for maps that are not there yet."""
        submaps, params, memo = job.dataset.submaps, job.state.params, self._desk.memo
        grows = job.past is not None and job.past.grows
        # Of a dataset that grows, the grids shall not change with each submap, nor all at once.
        count = 1 << (max(len(submaps), 32) - 1).bit_length() if grows else len(submaps)
        before = self._made[1] if self._made[0] == (params.map, grows) else {}
        made, left = dict[str, tuple[Submap, int, Terrain]](), CHANGED_AT_ONCE
        for submap in submaps:
            old = before.get(submap.id)
            if old is not None and old[0] is submap and (old[1] == count or left == 0):
                made[submap.id] = old
                continue
            left -= old is not None
            made[submap.id] = submap, count, quick_surface(submap, params, memo, count)
        self._made = (params.map, grows), made
        return {name: surface for name, (_, _, surface) in made.items()}

    def _merge(self, world: World, progress: Progress) -> MergedTerrain:
        """Merge the ground of a world, but for most of the time leave the processors to others."""
        while time.monotonic() < self._rested:
            progress(0.0)
            time.sleep(0.02)
        start = time.monotonic()
        terrain = merge(world.surfaces, world.poses)
        end = time.monotonic()
        self._rested = end + RESTS_FOR * (end - start)
        return terrain

    def _take(self, world: World, terrain: MergedTerrain) -> None:
        if self.scene.take(world, terrain) and self.world is not None:
            self._say_drawn(self.world)

    def _of(self, job: _Drawing) -> dict[str, Terrain]:
        """Give the surfaces that have been inferred for a job, by submap."""
        state = job.state
        key = state.dataset, state.method, state.given.map, state.given.features.max_std_ratio
        with self._lock:
            if self._inferred[0] != key:
                self._inferred = key, {}
            return self._inferred[1]

    def _missing(self, job: _Drawing) -> int:
        """Count the submaps that the Gaussian process has still to infer for a job."""
        inferred = self._of(job)
        wanted = self._declined is not inferred
        return len(job.dataset.submaps) - len(inferred) if wanted else 0

    def _infer(self, job: _Drawing, quick: Mapping[str, Terrain], progress: Progress) -> None:
        """Infer what is missing, as long as the world is looked at; one that cannot stays quick."""
        submaps, state, memo = job.dataset.submaps, job.state, self._desk.memo
        inferred = self._of(job)
        for place, submap in enumerate(submaps if self._missing(job) else ()):
            if not self.scene.visible:
                return
            share = part(progress, place / len(submaps), (place + 1) / len(submaps))
            if submap.id in inferred:
                share(1.0)
                continue
            try:
                fitted = map_params(submap, state.given, memo, share, state.method)
                made = inferred_surface(submap, fitted, memo, len(submaps), share)
            except InputError:
                made = quick[submap.id]
            inferred[submap.id] = made

    def _on_result(self, job: _Drawing, drawn: _DrawnWorld, _seconds: float) -> None:
        self._show_drawn(job, drawn)

    def _tell_of(self, job: _Drawing, drawn: _DrawnWorld) -> None:
        """Say what is drawn: in the panel, the rail, the legend and to other features."""
        self.world, scale = drawn
        self._say_drawn(self.world)
        self.panel.legend.content = legend_html(scale)
        terrain = self.scene.terrain
        if self.rail is not None:
            self.rail.show(self.world, terrain, job.share)
            self.scene.mark(self.rail.show_place(terrain, self._place))
        self._desk.canvases.legends["world"] = map_legend(self.world, scale)
        self._desk.notify(lambda feature: feature.on_drive("drawn"))
        with self._lock:  # another may be chosen right now
            if self._selected is not None:
                self.panel.select(self._selected, self._figures(self._selected))

    def _show_drawn(self, job: _Drawing, drawn: _DrawnWorld) -> None:
        """Say what is drawn, and bring the cameras to another dataset, or to its relaxed map."""
        self._tell_of(job, drawn)
        grows = job.past is not None and job.past.grows
        dataset = job.dataset if grows else job.state.dataset
        another = self._framed is not dataset
        if another or job.relaxing:
            # Whoever moved the camera since keeps it while the same dataset grows or relaxes.
            kept = not another or (self._framed is not None and grows)
            self._framed = dataset
            camera = self.scene.camera()
            if camera is not None:
                if isinstance(self._host, viser.ViserServer):
                    set_start(self._host, camera)
                for page in pages(self._host).values():
                    if kept and self._desk.canvases.is_by_hand(page):
                        continue
                    whole = self.scene.camera(self._desk.canvases.of(page))
                    assert whole is not None
                    self._desk.canvases.bring(page, whole)
        self._host.flush()

    def _say_drawn(self, world: World) -> None:
        lines = _summary(world, self.scene.terrain, self.scene.num_arches)
        self.panel.summary.content = summary("world-summary", lines)

    def _on_cancel(self, job: _Drawing) -> None:
        """Leave the ground as it is: what has not been inferred stays a smoothed grid."""
        self._declined = self._of(job)

    def _figures(self, name: str) -> tuple[tuple[str, str], ...]:
        dataset, corrected = self._state.dataset, (self._correction.corrected or {}).get(name)
        submap = dataset.submap(name)
        at_origin = corrected and shifted(corrected, -submap.centre)
        rows = figures_of(submap, at_origin, positions_only=dataset.positions_only)
        surface = None if self.world is None else self.world.surfaces.get(name)
        if surface is None:
            return rows
        trusted = surface.gradient_map.trusted(surface.max_std_ratio)
        if not trusted.any():
            return rows
        return (
            *rows,
            ("median deviation", f"{np.median(surface.gradient_map.std[trusted]):.4f} m"),
            ("median gradient", f"{np.median(surface.gradient_map.gradient[trusted]):.3f} m/m"),
        )


def _goes_on(job: _Drawing) -> bool:
    return job.past is not None and job.past.goes_on


def between(start: Mapping[str, Pose], end: Mapping[str, Pose], share: float) -> dict[str, Pose]:
    """Interpolate poses; those that only the end has stand where they end."""
    poses: dict[str, Pose] = {}
    for name, last in end.items():
        first = start.get(name, last)
        turned = first.quaternion * np.copysign(1.0, first.quaternion @ last.quaternion)
        quaternion = (1 - share) * turned + share * last.quaternion
        offset = (1 - share) * first.translation + share * last.translation
        poses[name] = Pose(offset, quaternion / np.linalg.norm(quaternion))
    return poses


def _poses_of(job: _Drawing) -> Mapping[str, Pose]:
    """Give the poses at which a job has the submaps."""
    graph = job.correction.graph
    if job.options.poses == "corrected" and graph is not None and job.share < 1.0:
        return graph.at(job.share)
    return poses_of(job.state.dataset, job.options.poses, job.correction.corrected)


def relaxation(graph: OptimisedGraph, move: Callable[[Mapping[str, Pose]], None]) -> Animation:
    """Animate the world from odometry to the corrected poses, as the solver went."""
    return Animation(RELAXING_SECONDS, lambda share: move(graph.at(ease(share))), rest=1.5)


def _summary(world: World, terrain: MergedTerrain | None, num_arches: int) -> tuple[str, ...]:
    count, shown = len(world.dataset.submaps), len(world.poses)
    area = 0.0 if terrain is None else terrain.area
    lines = [f"{shown} submaps · {area:,.0f} m² of ground"]
    if terrain is not None and np.isfinite(terrain.disagreement):
        lines.append(f"Where they overlap, heights differ by {1000 * terrain.disagreement:.0f} mm.")
    if world.options.poses == "in rows":
        lines.append("The dataset has no poses, so the submaps lie in rows.")
    elif shown < count and world.past is None:
        lines.append(f"{count - shown} of {count} submaps have no such pose and are not shown.")
    wanted = sum(
        world.options.loops if loop.accepted else world.options.refused
        for loop in world.correction.loops
    )
    if num_arches < wanted and world.past is None:
        own = "" if world.selected is None else f", and all of {world.selected}"
        lines.append(
            f"{num_arches:,} of {wanted:,} loops are drawn: those with the highest scores{own}."
        )
    return tuple(lines)
