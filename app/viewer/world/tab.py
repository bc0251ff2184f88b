"""Explore: wires the panel of the world to a runner, and the runner to the world's scene."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import viser

from app.viewer.capacity import Turns
from app.viewer.draw.animation import Animation, ease, play
from app.viewer.draw.cameras import set_start, set_view
from app.viewer.draw.colors import legend_uri
from app.viewer.draw.layers import Scale
from app.viewer.draw.placement import Camera
from app.viewer.feature import Part
from app.viewer.host import Host, pages
from app.viewer.pair.panel import legend_html
from app.viewer.runner import Runner
from app.viewer.state import ViewState
from app.viewer.world.lines import Loop
from app.viewer.world.panel import ExploreCalls, ExplorePanel
from app.viewer.world.scene import World, WorldScene
from app.viewer.world.submaps import (
    PoseSource,
    WorldOptions,
    measure,
    pose_sources,
    poses_of,
    statistics_rows,
)
from app.viewer.world.surfaces import NEEDS_INFERENCE, Sight, inferred_sight, quick_sight
from gpgrad_core.run.memo import Memo
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
class _Job:
    state: ViewState
    options: WorldOptions
    correction: Correction
    selected: str | None
    relaxing: bool = False  # move from odometry to the corrected poses


@dataclass(frozen=True, eq=False)
class _Picture:
    world: World
    scale: Scale | None


class Explore(Part):
    """The world in which all submaps lie; drawn only while it is looked at."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        memo: Memo,
        turns: Turns,
        *,
        on_tune: Callable[[str, str], None],
        message_of: Callable[[Exception], str],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI and scene it joins.
            state: The session as it is.
            memo: Shared with the pair that is shown.
            turns: Held while maps are made.
            on_tune: Given the query and the database to tune; must be quick.
            message_of: Says what went wrong in one line.
        """
        self._host = host
        self._memo = memo
        self._message_of = message_of
        self._on_tune = on_tune
        self._lock = threading.Lock()
        self._state = state
        self._options = WorldOptions(poses=pose_sources(state.dataset)[0])
        self._correction = Correction()
        self._selected: str | None = None
        self._picture: _Picture | None = None
        self._framed: object = None  # the dataset that the cameras were brought to
        self.scene = WorldScene(host)
        self._panel = ExplorePanel(
            host,
            self._options,
            ExploreCalls(
                on_options=lambda options: self._change(options=options),
                on_select=self.select,
                on_step=self._step,
                on_role=self._tune,
                on_look=self._look,
                on_all=self._show_all,
                on_cancel=self._cancel,
            ),
        )
        self._offer()
        self._panel.select(None, ())
        self._runner: Runner[_Job, _Picture] = Runner(
            self._draw,
            self._on_result,
            lambda job, error: self._panel.stopped(message_of(error), bad=True),  # noqa: ARG005
            on_cancel=self._on_cancel,
            turns=turns.pictures,
            name="world",
        )

        @host.scene.on_click()
        def _(event: viser.SceneClickEvent) -> None:
            if self.scene.visible:
                self._click(event.ray_origin, event.ray_direction)

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
            self._panel.select(None, ())
            self._submit()
        elif before.params.map != state.params.map or (
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
        self._panel.select(name, () if name is None else self._figures(name))
        self._submit()

    @property
    def world(self) -> World | None:
        """What is shown, or was last."""
        return None if self._picture is None else self._picture.world

    @property
    def scale(self) -> Scale | None:
        """What its colours mean."""
        return None if self._picture is None else self._picture.scale

    @property
    def graph(self) -> OptimisedGraph | None:
        """The optimised pose graph, if there is one."""
        return self._correction.graph

    def camera(self) -> Camera | None:
        """Give the view that shows all."""
        return self.scene.camera()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return self._runner.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._runner.close()

    # What the widgets and the mouse ask for; quick.

    def _change(self, *, options: WorldOptions) -> None:
        with self._lock:
            self._options = options
        self._offer()
        self._submit()

    def _offer(self) -> None:
        dataset = self._state.dataset
        sources = pose_sources(dataset, self._correction.corrected)
        self._panel.offer(self._options, sources, tuple(submap.id for submap in dataset.submaps))

    def _submit(self, *, relaxing: bool = False) -> None:
        if not self.scene.visible:
            return
        with self._lock:
            job = _Job(self._state, self._options, self._correction, self._selected, relaxing)
        self._runner.submit(job)

    def _step(self, step: int) -> None:
        ids = [submap.id for submap in self._state.dataset.submaps]
        if self._selected in ids:
            self.select(ids[(ids.index(self._selected) + step) % len(ids)])
        else:
            self.select(ids[0] if step > 0 else ids[-1])

    def _tune(self, role: str) -> None:
        """Tune the chosen submap with the one that has the other role, or a neighbour of it."""
        state, chosen = self._state, self._selected
        if chosen is None:
            return
        query, database = state.query_id, state.database_id
        if role == "query":
            self._on_tune(chosen, database if database != chosen else query)
        else:
            self._on_tune(query if query != chosen else database, chosen)

    def _click(
        self, origin: tuple[float, float, float], toward: tuple[float, float, float]
    ) -> None:
        hit = self.scene.pick(np.array(origin, float), np.array(toward, float))
        if hit is not None:
            self.select(hit)

    def _look(self, client: viser.ClientHandle | None) -> None:
        if self._selected is not None:
            self._bring(client, self.scene.camera_at(self._selected))

    def _show_all(self, client: viser.ClientHandle | None) -> None:
        self._bring(client, self.camera())

    def _bring(self, client: viser.ClientHandle | None, camera: Camera | None) -> None:
        if client is not None and camera is not None:
            set_view(client, camera)

    def _cancel(self) -> None:
        self._runner.cancel()

    # What the worker does.

    def _draw(self, job: _Job, progress: Progress) -> _Picture:
        dataset, options, correction = job.state.dataset, job.options, job.correction
        sights = self._sights(job, progress)
        ways: dict[PoseSource, Mapping[str, Pose]] = {
            source: poses_of(dataset, source, correction.corrected)
            for source in pose_sources(dataset, correction.corrected)
            if source != "in rows"
        }
        world = World(
            dataset,
            sights,
            poses_of(dataset, options.poses, correction.corrected),
            ways,
            options,
            correction.loops,
            job.selected,
            correction.marked,
            correction.highest_score,
        )
        graph = correction.graph
        if not job.relaxing or graph is None:
            return _Picture(world, self.scene.show(world))
        scale = self.scene.show(world, at=graph.at(0.0))
        play(relaxation(graph, self.scene.mover()), progress)
        return _Picture(world, scale)

    def _sights(self, job: _Job, progress: Progress) -> dict[str, Sight]:
        submaps, params = job.state.dataset.submaps, job.state.params
        inferring = job.options.color in NEEDS_INFERENCE
        sights: dict[str, Sight] = {}
        for place, submap in enumerate(submaps):
            if inferring:
                self._panel.running(place / len(submaps))
                of_one = part(progress, place / len(submaps), (place + 1) / len(submaps))
                sights[submap.id] = inferred_sight(submap, params, self._memo, of_one)
            else:
                sights[submap.id] = quick_sight(submap, params, self._memo, len(submaps))
                progress((place + 1) / len(submaps))
        return sights

    def _on_result(self, job: _Job, picture: _Picture, seconds: float) -> None:
        self._picture = picture
        self._panel.stopped()
        self._panel.show_summary(_summary(picture.world, self.scene.num_cells, seconds))
        self._panel.show_legend(world_legend(picture.scale))
        if job.selected is not None and job.options.color in NEEDS_INFERENCE:
            self._panel.select(job.selected, self._figures(job.selected))
        if self._framed is not job.state.dataset:
            self._framed = job.state.dataset
            camera = self.camera()
            if camera is not None:
                if isinstance(self._host, viser.ViserServer):
                    set_start(self._host, camera)
                for client in pages(self._host).values():
                    set_view(client, camera)
        self._host.flush()

    def _on_cancel(self, job: _Job) -> None:
        """Go back to colours that need no maps."""
        del job
        self._change(options=replace(self._options, color="submap"))
        self._panel.stopped("Cancelled.")

    def _figures(self, name: str) -> tuple[tuple[str, str], ...]:
        corrected = (self._correction.corrected or {}).get(name)
        rows = statistics_rows(measure(self._state.dataset.submap(name), corrected))
        sight = None if self.world is None else self.world.sights.get(name)
        if sight is None or self._options.color not in NEEDS_INFERENCE:
            return rows
        trusted = sight.gradient_map.trusted(sight.max_std_ratio)
        if not trusted.any():
            return rows
        return (
            *rows,
            ("median deviation", f"{np.median(sight.gradient_map.std[trusted]):.4f} m"),
            ("median gradient", f"{np.median(sight.gradient_map.gradient[trusted]):.3f} m/m"),
        )


def relaxation(graph: OptimisedGraph, move: Callable[[Mapping[str, Pose]], None]) -> Animation:
    """Let the world relax from odometry to the corrected poses, as the solver went."""
    return Animation(RELAXING_SECONDS, lambda share: move(graph.at(ease(share))), rest=1.5)


def world_legend(scale: Scale | None) -> str:
    """Say what the colours of the world mean, as HTML."""
    if scale is None:
        return ""
    return legend_html(
        legend_uri(scale.color_map),
        scale.label,
        scale.unit,
        low=scale.low,
        high=scale.high,
    )


def _summary(world: World, num_cells: int, seconds: float) -> tuple[str, ...]:
    count, shown = len(world.dataset.submaps), len(world.poses)
    lines = [f"{shown} submaps · {num_cells:,} cells · {1000 * seconds:.0f} ms"]
    if world.options.poses == "in rows":
        lines.append("The dataset has no poses: the submaps lie in rows.")
    elif shown < count:
        lines.append(
            f"{count - shown} of {count} submaps have no pose of this kind and are not shown."
        )
    return tuple(lines)
