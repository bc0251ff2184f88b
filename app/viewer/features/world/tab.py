"""The World tab: wires its widgets to a worker, and the worker to the world's scene."""

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from typing import Any, cast

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature, ModeSwitch
from app.viewer.features.work import Work, message_of
from app.viewer.features.world.merged import MergedTerrain, merge
from app.viewer.features.world.model import Correction, Past, World, between
from app.viewer.features.world.rail import WorldRail, map_legend
from app.viewer.features.world.scene import Pace, WorldScene
from app.viewer.features.world.submaps import (
    FEW,
    PoseSource,
    Terrain,
    WorldOptions,
    counts_as_it_grows,
    figures_of,
    first_surface,
    inferred_surface,
    quick_surface,
)
from app.viewer.scene.cameras import Animation, blend, ease, play, set_start, set_view, view_of
from app.viewer.server.host import on_scene_click, pages
from app.viewer.session.jobs import Lane
from app.viewer.session.methods import METHODS
from app.viewer.session.news import AllPairs, SessionState
from app.viewer.session.state import ViewState
from app.viewer.widgets.actions import on_choice, on_option, on_press_by
from app.viewer.widgets.commands import Commands
from app.viewer.widgets.html import FAINT, figures, paragraph, summary
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.panel import Panel
from app.viewer.widgets.status import WorkBar
from gpgrad_core.arrays import Array
from gpgrad_core.detection.choosing import closest_pair, likely
from gpgrad_core.errors import InputError, count
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import OptimisedGraph
from gpgrad_core.slam.graph import shifted
from gpgrad_core.types import LoopClosure

NOTHING: str = "none"
THEN: PoseSource = "at that time"
RELAXING_SECONDS = 4.0
MOVING_SECONDS, LIVE_SECONDS = 0.6, 0.3
"""How long the map of a moment moves [s]; of a drive that goes on, the next may come soon."""
FLIGHT_SECONDS = 0.7
"""How long a camera flies to the submaps of a loop that was clicked [s]."""
REACH = 8.0
"""An arch is meant from so near [pixels]."""
REST = 0.25
"""A map that has not moved for so long rests [s]."""


@dataclass(frozen=True, eq=False)
class _Drawing:
    state: ViewState
    world: World
    relaxing: bool = False  # move from odometry to the corrected poses


@dataclass(eq=False)
class _Inferred:
    """What the Gaussian process has inferred for a key, and whether no more is needed."""

    key: object = None
    surfaces: dict[str, Terrain] = field(default_factory=dict)
    declined: bool = False


class WorldTab(Feature):
    """The world in which all submaps lie; drawn only while it is looked at."""

    _bar: WorkBar
    _legend: viser.GuiHtmlHandle

    def __init__(self, desk: Desk, modes: ModeSwitch, *, visible: bool = False) -> None:
        """Make the panel; a map that is visible at once takes the place of `FirstGround`."""
        self._desk, self._modes, self._host = desk, modes, desk.host
        self._lock = threading.Lock()
        self._state = desk.state
        self._target = World.of(desk.state.dataset)
        self.world: World | None = None  # what is shown, or was last
        self._inferred = _Inferred()
        self._place: Float[Array, 2] | None = None  # that was clicked, in the world [m]
        self._framed: object = None  # the dataset that the cameras were brought to
        self._pace = Pace()  # of merging a ground that grows
        self.rail: WorldRail | None = None
        self.scene = WorldScene(desk.host, visible=visible)  # where they lie
        gui = desk.host.gui
        self._summary = gui.add_html("")

        def add_legend() -> None:
            self._legend = gui.add_html("")
            self._bar = WorkBar(desk.host, "Cancel maps", "world")

        self._options = Panel(
            desk.host, self._target.options, self._change, below={"color": add_legend}
        )
        self._chosen: viser.GuiDropdownHandle[str] = gui.add_dropdown(
            "Submap",
            (NOTHING,),
            initial_value=NOTHING,
            hint="You can also click a submap in the scene.",
        )
        self._figures = gui.add_html("")
        self._look = gui.add_button(
            "Look at it", visible=False, hint="Moves the camera to this submap."
        )
        self._roles = gui.add_button_group(
            "Tune it as",
            ("query", "database"),
            visible=False,
            hint="Opens this submap in Tune, as the query or the database.",
        )
        on_choice(self._chosen, lambda name: self._pick(None if name == NOTHING else name))
        on_option(self._roles, self._tune)
        on_press_by(self._look, self._look_at)
        self._offer()
        self._show_selected()
        self._work: Work[_Drawing, World] = Work(
            desk.jobs,
            self._bar,
            lambda job: "Making the maps" if self._missing(job) and not job.world.goes_on else "",
            self._draw,
            lambda job, world, _seconds: self._show_drawn(job, world),
            on_cancel=self._on_cancel,
            slots=desk.capacity.pictures,
        )
        self._mover: Lane[float, None] = Lane(
            desk.jobs,
            self._slide,
            lambda _share, _nothing, _seconds: self._settle(),
            self._fail,
        )
        self._merger: Lane[World, MergedTerrain] = Lane(
            desk.jobs,
            self._merge,
            lambda world, terrain, _seconds: self._take(world, terrain),
            self._fail,
        )
        self._pilot: Lane[tuple[viser.ClientHandle, LoopClosure], None] = Lane(
            desk.jobs, self._fly, lambda _flight, _nothing, _seconds: None, self._fail
        )
        on_scene_click(desk.host, self._click)

    def add_rail(self) -> None:
        self.rail = WorldRail(self._host, self.move_to)

    def add_commands(self, commands: Commands) -> None:
        for label, step in (("Next submap", 1), ("Previous submap", -1)):
            commands.add("Explore", label, partial(self._step, step))

    # What the session and the other parts tell.

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Follow the session; another dataset is another world, and the rail is beside it only."""
        was, now = before.view, state.view
        another = was.dataset is not now.dataset
        with self._lock:
            self._state = now
            if another:
                self._target, self._place = World.of(now.dataset, self._target.options), None
        if another:
            self._offer()
            self._show_selected()
        if another or _maps_of(was) != _maps_of(now):
            self._submit()
        if self.rail is not None and state.subject != before.subject:
            self.rail.set_visible(state.subject == "world")

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Use the full maps that a comparison of all pairs computed, and closures as they come."""
        if pairs.so_far is not before.so_far and pairs.so_far is not None:
            loops = tuple(
                one
                for one in pairs.so_far.found.closures
                if one.registration.T_database_query is not None
            )
            highest = max((one.registration.score for one in loops), default=1.0) or 1.0
            self._want(correction=Correction(loops=loops, highest_score=highest))
        if pairs.verdicts is not before.verdicts:
            with self._lock:
                self._inferred = _Inferred()

    def open(self, *, visible: bool) -> None:
        self.scene.visible = visible
        if visible:
            self._submit()

    def correct(self, correction: Correction, *, relax: bool = False) -> None:
        """Set the result of the pose graph; ``relax`` shows how the submaps relax to it."""
        if relax:
            self._leave_past()
        solved = correction.graph is not None
        with self._lock:
            wanted = replace(self._target, correction=correction)
            poses = wanted.options.poses
            if relax and solved:
                poses = "corrected"
            elif poses == "corrected" and not solved:
                poses = wanted.pose_sources[0]
            options = replace(wanted.options, poses=poses)
            share = 1.0 if relax or not solved else wanted.share
            self._target = replace(wanted, options=options, share=share)
        self._offer()
        self._show_selected()
        self._submit(relaxing=relax)

    def relax(self) -> None:
        self.correct(self._target.correction, relax=True)

    def move_to(self, share: float) -> None:
        options = replace(self._target.options, poses="corrected")
        if self.graph is None:
            return
        if self._target.options != options:
            self._want(share=share, options=options)
            self._offer()
        else:
            with self._lock:
                self._target = replace(self._target, share=share)
        self._mover.submit(share)

    def show_past(self, past: Past | None) -> None:
        """Show what there was at some time of a drive, or the whole again."""
        turns = (past is None) != (self._target.past is None)
        self._want(past=past)
        if turns:
            self._offer()

    def set_loops_shown(self, *, loops: bool, refused: bool) -> None:
        self._want(options=replace(self._target.options, loops=loops, refused=refused))

    def select(self, name: str | None) -> None:
        self._want(selected=name)
        self._show_selected()

    @property
    def graph(self) -> OptimisedGraph | None:
        return self._target.correction.graph

    def is_drawn(self, timeout: float) -> bool:
        """Wait until the last wish is drawn; says whether that came true within the timeout [s]."""
        return self._work.wait_idle(timeout)

    # What the widgets and the mouse ask for; quick.

    def _want(self, **changes: Any) -> None:
        with self._lock:
            self._target = replace(self._target, **changes)
        self._submit()

    def _change(self, options: WorldOptions) -> None:
        if self._target.past is not None and options.poses == THEN:
            options = replace(options, poses=self._target.options.poses)
        else:
            self._leave_past()
        self._want(options=options)
        self._offer()

    def _leave_past(self) -> None:
        """Show the latest state, because its poses are to be shown."""
        if self._target.past is not None:
            self._desk.notify(lambda feature: feature.on_drive("latest wanted"))

    def _offer(self) -> None:
        """Show the options, and what there is to choose from."""
        wanted = self._target
        options, sources = wanted.options, wanted.pose_sources
        if wanted.past is not None:
            options = replace(options, poses=THEN)
            sources = cast("tuple[PoseSource, ...]", (*sources, THEN))
        self._options.offer("poses", sources)
        self._options.set(options)
        choices = (NOTHING, *(submap.id for submap in wanted.whole.submaps))
        if tuple(self._chosen.options) != choices:
            self._chosen.options, self._chosen.value = choices, NOTHING

    @property
    def _is_seen(self) -> bool:
        return self._desk.now.subject == "world"

    def _submit(self, *, relaxing: bool = False) -> None:
        if not self._is_seen:
            return
        with self._lock:
            job = _Drawing(self._state, self._target, relaxing)
        self._work.start(job)

    def _step(self, step: int) -> None:
        ids, selected = list(self._state.dataset.index), self._target.selected
        if selected in ids:
            self._pick(ids[(ids.index(selected) + step) % len(ids)])
        else:
            self._pick(ids[0] if step > 0 else ids[-1])

    def _pick(self, name: str | None) -> None:
        """Choose a submap, and its likeliest pair: the verdict beside the world is of that."""
        self.select(name)
        if name is not None:
            own = likely(loop for loop in self._target.correction.loops if name in loop.pair)
            # Before pairs are compared, the nearest submap that is no neighbour on the way.
            pair = own[0].pair if own else closest_pair(self._state.dataset, of=name)
            if pair is not None:
                self._desk.choose(*pair)

    def _tune(self, role: str) -> None:
        """Show the chosen submap in Tune, with the submap that has the other role there."""
        state, chosen = self._state, self._target.selected
        if chosen is None:
            return
        query, database = state.query_id, state.database_id
        if role == "query":
            self._modes.tune(chosen, database if database != chosen else query)
        else:
            self._modes.tune(query if query != chosen else database, chosen)

    def _click(self, event: viser.SceneClickEvent) -> None:
        """Choose the submap that a line of sight meets first, or open the pair of an arch."""
        if not self.scene.visible:
            return
        sight = np.array(event.ray_origin, float), np.array(event.ray_direction, float)
        canvas = self._desk.canvases.of(event.client)
        loop = self.scene.arch_at(*sight, REACH / canvas.focal_length(view_of(event.client)))
        if loop is not None:
            self._pilot.submit((event.client, loop))
            return
        hit = self.scene.pick(*sight)
        terrain = self.scene.terrain
        if hit is not None and terrain is not None:
            self._place = terrain.positions[hit, :2].copy()
            name = terrain.names[terrain.owner[hit]]
            if name in self._state.dataset.index:
                self._pick(name)

    def look(
        self, origin: Float[Array, "3"], direction: Float[Array, "3"], reach: float
    ) -> tuple[tuple[str, ...], str]:
        """What a line of sight meets: the submaps of an arch so near, or one; and a card."""
        loop = self.scene.arch_at(origin, direction, reach)
        if loop is not None:
            return (loop.query_id, loop.database_id), loop_card(loop)
        hit, terrain = self.scene.pick(origin, direction), self.scene.terrain
        if hit is None or terrain is None:
            return (), ""
        name = terrain.names[terrain.owner[hit]]
        words = f"elevation {terrain.positions[hit, 2]:z.2f} m"
        return (name,), f"<b>Submap {escape(name)}</b> · {words}"

    def _look_at(self, page: viser.ClientHandle) -> None:
        selected = self._target.selected
        if selected is not None:
            camera = self.scene.camera(self._desk.canvases.of(page), names=(selected,))
            if camera is not None:
                set_view(page, camera)

    # What the workers do.

    def _fly(self, flight: tuple[viser.ClientHandle, LoopClosure], progress: Progress) -> None:
        """Approach the two submaps of a loop, then open them; the map stays where it was."""
        page, loop = flight
        start, canvas = view_of(page), self._desk.canvases.of(page)
        end = self.scene.camera(canvas, names=loop.pair)
        if end is not None:
            way = Animation(
                FLIGHT_SECONDS, lambda share: set_view(page, blend(start, end, ease(share)))
            )
            play(way, progress)
        self._modes.tune(*loop.pair, back_to={page.client_id: start})

    def _slide(self, share: float, progress: Progress) -> None:
        graph, world = self.graph, self.world
        if graph is not None and world is not None and world.options.poses == "corrected":
            self.scene.mover()(graph.at(share))
        rests = time.monotonic() + REST
        while time.monotonic() < rests and not self._mover.newer_waits:
            progress(0.0)
            time.sleep(0.01)

    def _settle(self) -> None:
        if not self._mover.newer_waits:
            self._submit()

    def _merge(self, world: World, progress: Progress) -> MergedTerrain:
        """Merge the ground of a world, but for most of the time leave the processors to others."""
        while not self._pace.is_due:
            progress(0.0)
            time.sleep(0.02)
        terrain = merge(world.surfaces, world.poses)
        self._pace.rest()
        return terrain

    def _take(self, world: World, terrain: MergedTerrain) -> None:
        if self.scene.take(world, terrain) and self.world is not None:
            self._say_drawn(self.world)

    def _fail(self, _job: object, error: Exception) -> None:
        self._bar.failed(message_of(error))

    def _draw(self, job: _Drawing, progress: Progress) -> World:
        quick = self._first_surfaces(job)
        if not job.world.goes_on:
            if self._missing(job) and not job.relaxing:
                self._show_drawn(job, self._show(job, quick | self._of(job).surfaces))
            self._infer(job, quick, progress)
        return self._show(job, quick | self._of(job).surfaces, progress)

    def _first_surfaces(self, job: _Drawing) -> dict[str, Terrain]:
        """Make what stands in for maps: of many that are to be inferred anyway, the coarsest."""
        submaps, memo = job.world.dataset.submaps, self._desk.memo
        if job.world.goes_on or self._missing(job) <= FEW:
            return self._quick_surfaces(job)
        return {submap.id: memo(first_surface, submap) for submap in submaps}

    def _show(
        self, job: _Drawing, surfaces: Mapping[str, Terrain], progress: Progress = silent
    ) -> World:
        """Draw the world of such surfaces, and move it from its state before, if there is one."""
        world = job.world.with_surfaces(surfaces)
        past, graph = world.past, world.correction.graph
        start = None if past is None else past.moves_from
        if graph is not None and job.relaxing:
            start = graph.at(0.0)
        merges = not (world.grows and world.goes_on)
        if merges:
            self._merger.cancel()
        self.scene.show(world, at=start, merges=merges)
        if not merges:
            self._merger.submit(world)
        move = self.scene.mover()
        if past is not None and start is not None:
            self._tell_of(world)  # with the submap that comes, not after its way
            seconds = LIVE_SECONDS if past.grows else MOVING_SECONDS
            way = Animation(seconds, lambda at: move(between(start, past.poses, ease(at))))
            play(way, progress)
        elif graph is not None and start is not None:
            # The maps are there by now; what moves is no progress, but can be cancelled.
            play(relaxation(graph, move), lambda _: progress(1.0))
        return world

    def _quick_surfaces(self, job: _Drawing) -> dict[str, Terrain]:
        submaps, params, memo = job.world.dataset.submaps, job.state.params.map, self._desk.memo
        count = len(submaps)
        counts = counts_as_it_grows(count) if job.world.grows else [count] * count
        return {
            submap.id: memo(quick_surface, submap, params, of, memo=memo)
            for submap, of in zip(submaps, counts, strict=True)
        }

    def _of(self, job: _Drawing) -> _Inferred:
        key = job.state.dataset, *_maps_of(job.state)
        with self._lock:
            if self._inferred.key != key:
                self._inferred = _Inferred(key)
            return self._inferred

    def _missing(self, job: _Drawing) -> int:
        """Count the submaps that the Gaussian process has still to infer for a job."""
        inferred = self._of(job)
        return 0 if inferred.declined else len(job.world.dataset.submaps) - len(inferred.surfaces)

    def _infer(self, job: _Drawing, quick: Mapping[str, Terrain], progress: Progress) -> None:
        """Infer what is missing, as long as the world is looked at; one that cannot stays quick."""
        submaps, state, memo = job.world.dataset.submaps, job.state, self._desk.memo
        inferred, pace = self._of(job).surfaces, Pace()
        for place, submap in enumerate(submaps if self._missing(job) else ()):
            if not self._is_seen:
                return
            share = part(progress, place / len(submaps), (place + 1) / len(submaps))
            if submap.id in inferred:
                share(1.0)
                continue
            try:
                fitted = METHODS[state.method].of_submap(submap, state.given, memo, share)
                made = inferred_surface(submap, fitted, memo, len(submaps), share)
            except InputError:
                made = quick[submap.id]
            inferred[submap.id] = made
            if len(submaps) > FEW and not job.relaxing and pace.is_due:
                self._show(job, {**quick, **inferred})
                pace.rest()

    def _on_cancel(self, job: _Drawing) -> None:
        """Called on cancel: what has not been inferred stays a smoothed grid."""
        self._of(job).declined = True
        if len(job.world.dataset.submaps) > FEW:  # better grids than the first ground
            self._submit()

    # Its display.

    def _tell_of(self, world: World) -> None:
        """Report what is drawn: in the panel, the rail, the legend and to other features."""
        self.world = world
        self._say_drawn(world)
        self._legend.content = legend_html(self.scene.scale)
        terrain = self.scene.terrain
        if self.rail is not None:
            self.rail.show(world, terrain)
            self.scene.mark(self.rail.show_place(terrain, self._place))
        self._desk.canvases.legends["world"] = map_legend(world, self.scene.scale)
        self._desk.notify(lambda feature: feature.on_drive("drawn"))
        if self._target.selected is not None:  # its map may be another
            self._show_selected()

    def _show_drawn(self, job: _Drawing, world: World) -> None:
        """Report what is drawn, and move the cameras to another dataset, or to its relaxed map."""
        self._tell_of(world)
        dataset = world.dataset
        another = self._framed is not dataset
        if another or job.relaxing:
            # Whoever moved the camera since keeps it while the same dataset grows or relaxes.
            kept = not another or (self._framed is not None and world.grows)
            self._framed = dataset
            camera = self.scene.camera()
            if camera is not None:
                if isinstance(self._host, viser.ViserServer):
                    set_start(self._host, camera)
                canvases = self._desk.canvases
                for page in pages(self._host).values():
                    if not (kept and canvases.is_by_hand(page)):
                        canvases.bring(page, self.scene.camera(canvases.of(page)) or camera)
        self._host.flush()

    def _say_drawn(self, world: World) -> None:
        refused = world.options.refused  # others of them are there for being near
        num_arches = sum(loop.accepted or refused for loop in self.scene.arches)
        lines = _summary(world, self.scene.terrain, num_arches)
        self._summary.content = summary("world-summary", lines)

    def _show_selected(self) -> None:
        with self._lock:  # another may be chosen right now
            name = self._target.selected
            self._chosen.value = NOTHING if name is None else name
            self._look.visible = self._roles.visible = name is not None
            self._figures.content = (
                paragraph("Click a submap in the scene.", FAINT)
                if name is None
                else figures(
                    "submap-figures", self._figures_of(name), f"<b>Submap {escape(name)}</b>"
                )
            )

    def _figures_of(self, name: str) -> tuple[tuple[str, str], ...]:
        dataset = self._state.dataset
        submap, poses = dataset.submap(name), self._target.correction.corrected or {}
        corrected = poses.get(name)
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


def _maps_of(state: ViewState) -> tuple[Any, ...]:
    """All that the surfaces of a dataset's submaps depend on."""
    return state.method, state.given.map, state.given.features.max_std_ratio


def loop_card(loop: LoopClosure) -> str:
    """Write of which submaps an arch is, its verdict and why, for the card beside the cursor."""
    verdict = "Loop closure" if loop.accepted else "No loop closure"
    found = loop.registration
    return (
        f"<b>{escape(loop.query_id)} → {escape(loop.database_id)}</b> · {verdict}"
        f"<div>score {found.score:.1f} · {found.num_inliers} keypoints agree</div>"
        f'<div style="max-width:20em">{escape(loop.reason)}</div>'
        f'<div style="opacity:.75">Click to open the pair</div>'
    )


def relaxation(graph: OptimisedGraph, move: Callable[[Mapping[str, Pose]], None]) -> Animation:
    """Animate the world from odometry to the corrected poses, as the solver went."""
    return Animation(RELAXING_SECONDS, lambda share: move(graph.at(ease(share))), rest=1.5)


def _summary(world: World, terrain: MergedTerrain | None, num_arches: int) -> tuple[str, ...]:
    total, shown = len(world.dataset.submaps), len(world.poses)
    area = 0.0 if terrain is None else terrain.area
    lines = [f"{count(shown, 'submap')} · {area:,.0f} m² of ground"]
    if terrain is not None and np.isfinite(terrain.disagreement):
        lines.append(f"Where they overlap, heights differ by {1000 * terrain.disagreement:.0f} mm.")
    if world.options.poses == "in rows":
        lines.append("The dataset has no poses, so the submaps lie in rows.")
    elif shown < total and world.past is None:
        lines.append(f"{total - shown} of {total} submaps have no such pose and are not shown.")
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
