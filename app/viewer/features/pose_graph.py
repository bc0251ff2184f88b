"""The pose graph: which closures count, what becomes of each, and the map that they correct."""

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.closure_files import write_closure_file
from app.viewer.features.desk import PHASES, Comparison, Desk, Feature, ModeSwitch
from app.viewer.features.work import Downloads, Work
from app.viewer.features.world import SCORE_MAP, Correction, WorldTab
from app.viewer.scene.layers import Scale
from app.viewer.session.decisions import DECIDES, Decisions, count_kinds, decide, with_verdict
from app.viewer.session.methods import MethodName
from app.viewer.session.news import AllPairs, DriveNews, SessionState
from app.viewer.session.state import same_search
from app.viewer.widgets.actions import on_choice, on_option, on_option_by, on_press, one_of
from app.viewer.widgets.html import summary, table
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.pair_list import PairList
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.detection.choosing import likely
from gpgrad_core.errors import score_in_words
from gpgrad_core.run import Progress
from gpgrad_core.slam import (
    OptimisedGraph,
    build_pose_graph,
    measure_covariances,
    optimise_pose_graph,
    trajectory_error,
)
from gpgrad_core.slam.graph import judged_poses
from gpgrad_core.types import Array, Dataset, LoopClosure, PairOfIds

FILES = {
    "closures": "closures.json",
    "g2o": "graph.g2o",
    "TUM": "poses_corrected.txt",
}
NOT_FOUND = (
    "No closures yet.",
    "Find closures compares all pairs with the parameters of Tune. Its thresholds decide "
    "which pairs are accepted.",
)


@dataclass(frozen=True, eq=False)
class _Task:
    """What the optimiser works on."""

    dataset: Dataset
    closures: tuple[LoopClosure, ...]
    decisions: Decisions

    @property
    def key(self) -> object:
        """Equal for tasks of the same solution."""
        accepted = [
            (*closure.pair, closure.registration) for closure in self.closures if closure.accepted
        ]
        return accepted, sorted(self.decisions.trusted)


@dataclass(frozen=True, eq=False)
class _Solved:
    """An optimised graph, and how certain x, y and yaw of its poses are (n, 3, 3)."""

    graph: OptimisedGraph
    centred: OptimisedGraph  # the same between the submaps' centres
    covariances: Float[Array, "n 3 3"]


class PoseGraphTab(Feature):
    """Gathers the accepted closures, optimises when asked, and tells the world."""

    def __init__(
        self, desk: Desk, world: WorldTab, comparison: Comparison, modes: ModeSwitch
    ) -> None:
        """Make the panel in the current container; the world shows loops and corrected poses."""
        self._desk = desk
        self._world = world
        self._modes = modes
        self._lock = threading.Lock()
        self._chosen: PairOfIds | None = None
        self._optimised: _Solved | None = None
        self._solved: object = None  # what it was optimised from
        gui = desk.host.gui
        self._summary = gui.add_html("")
        find = gui.add_button(
            "Find closures",
            hint="Compares every submap with all earlier ones, like the tab All pairs.",
        )
        optimise = gui.add_button(
            "Optimise",
            hint="Corrects the poses with the accepted closures, and shows how the map moves, with "
            "an ellipse of three standard deviations around each place. Closures that the others "
            "contradict are left out.",
        )
        self._bar = WorkBar(desk.host, "Cancel work", "graph", starts=(find, optimise))
        self._result = gui.add_html("")
        self._legend = gui.add_html("")
        loops = gui.add_checkbox(
            "Accepted loops",
            initial_value=True,
            hint="Arches between submaps, coloured by score. A black one contradicts the others.",
        )
        refused = gui.add_checkbox(
            "Refused pairs", initial_value=False, hint="Draws them as thin grey arches."
        )
        self._pairs = PairList(
            desk.host,
            "Loop",
            none="none",
            hint="query → database · score · verdict · chi-square after optimising, which should "
            "be a few. The chosen loop stands out in the scene.",
            on_choose=self._choose,
        )
        verdicts = gui.add_button_group(
            "By hand",
            tuple(DECIDES),
            hint="accept: the pose graph keeps the loop, whatever the others say. refuse: it "
            "leaves the loop out. automatic: the thresholds decide again.",
        )
        self._undo = gui.add_button(
            "Undo decision", disabled=True, hint="Takes the last decision by hand back."
        )
        tune = gui.add_button(
            "See it in Tune",
            hint="Opens the pair in Tune, where you can also nudge and refine its motion.",
        )
        export = gui.add_button_group(
            "Export",
            tuple(FILES),
            hint="closures: all verdicts as JSON. g2o: the vertices and edges of the graph. TUM: "
            "the corrected poses.",
        )
        on_press(find, comparison.compare_pairs)
        on_press(optimise, self._optimise)
        for box in (loops, refused):
            on_choice(
                box,
                lambda _: world.set_loops_shown(loops=loops.value, refused=refused.value),
            )
        on_option(verdicts, lambda label: self._decide(DECIDES[label]))
        on_press(self._undo, desk.take_back)
        on_press(tune, self._tune)
        on_option_by(export, lambda page, label: self._order(page, one_of(tuple(FILES), label)))
        self._bar.on_cancel(comparison.stop_comparing)
        self._solver: Work[_Task, _Solved] = Work(
            desk.jobs,
            self._bar,
            lambda _: "Optimising",
            _solve,
            self._on_solved,
            slots=desk.capacity.long,
        )
        self._downloads = Downloads(desk.jobs, self._bar, desk.capacity.long)
        self._show_pairs({})

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Show what the decisions make of the closures; another search has other ones."""
        if not same_search(before.view, state.view):
            with self._lock:
                self._chosen, self._optimised, self._solved = None, None, None
            self._solver.cancel()
            self._result.content = self._legend.content = ""
            self._show_pairs({})
        if state.decisions is not before.decisions:
            self._show()

    def on_drive(self, news: DriveNews) -> None:
        """Tell of the closures of a drive that the map shows by now."""
        if news == "drawn":
            self._show_summary()

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Show all pairs as the thresholds judge them, and how far their comparison is."""
        if pairs.verdicts is not before.verdicts:
            self._show()
        if pairs.fraction is not None:
            self._bar.running("Comparing all pairs", pairs.fraction, PHASES)
        elif before.fraction is not None:
            self._bar.done(pairs.message)

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """All closures as decided."""
        return decide(self._desk.verdicts.found.closures, self._desk.now.decisions)

    @property
    def graph(self) -> OptimisedGraph | None:
        """The graph as last optimised."""
        return None if self._optimised is None else self._optimised.graph

    # What the widgets ask for.

    def _choose(self, pair: PairOfIds | None) -> None:
        self._chosen = pair
        self._tell_world()
        if pair is not None:
            self._desk.choose(*pair)  # the verdict beside the world is of what is chosen in it

    def _decide(self, accepted: bool | None) -> None:
        pair = self._chosen
        if pair is None:
            self._bar.failed("Choose a closure first.")
            return
        self._bar.idle()
        self._desk.decide(lambda decisions: with_verdict(decisions, pair, accepted))

    def _tune(self) -> None:
        if self._chosen is not None:
            self._modes.tune(*self._chosen)

    def _optimise(self) -> None:
        task = self._task()
        if not any(closure.accepted for closure in task.closures):
            self._bar.failed(
                "No closure is accepted. Find closures, lower the thresholds, or accept one by "
                "hand."
            )
            return
        self._solver.start(task)

    def _order(self, page: viser.ClientHandle, kind: str) -> None:
        task = self._task()
        graph = self.graph if task.key == self._solved else None
        if kind == "closures" and not self.closures:
            self._bar.failed("Find closures first.")
            return
        if kind == "TUM" and graph is None:
            self._bar.failed("Optimise first: there are no corrected poses of these closures yet.")
            return
        state = self._desk.state
        found = replace(self._desk.verdicts.found, closures=task.closures)
        write = partial(_write, task, found, state.given, state.method, graph)
        self._downloads.order(page, FILES[kind], write)

    # What the workers do.

    def _on_solved(self, task: _Task, solved: _Solved, seconds: float) -> None:
        with self._lock:
            if task.dataset is not self._desk.state.dataset:
                return  # another was opened in the very last moment
            self._optimised, self._solved = solved, task.key
        rows = table(result_rows(task.dataset, solved.graph, seconds))
        self._result.content = (
            f'<div data-testid="graph-result" style="padding:.1em .75em">{rows}</div>'
        )
        self._show(relax=True)
        self._desk.host.flush()

    # What is shown.

    def _task(self) -> _Task:
        verdicts, decisions = self._desk.verdicts, self._desk.now.decisions
        closures = decide(verdicts.found.closures, decisions)
        return _Task(verdicts.state.dataset, closures, decisions)

    def _show(self, *, relax: bool = False) -> None:
        closures, chosen, graph = self.closures, self._chosen, self.graph
        chi_squares = _chi_squares(graph)
        listed = {_label(closure, chi_squares): closure.pair for closure in likely(closures)}
        with self._desk.host.atomic():
            self._show_pairs(listed, chosen)
            scale = Scale("Loop closures", "score", SCORE_MAP, 0.0, _highest(closures))
            self._legend.content = legend_html(scale if closures else None)
        self._tell_world(relax=relax)

    def _show_summary(self) -> None:
        task, world = self._task(), self._world.world
        outdated = self.graph is not None and task.key != self._solved
        lines = _summary(task.dataset, task.closures, task.decisions, outdated=outdated)
        if world is not None and world.past is not None:
            loops, neighbours = world.num_accepted
            drive = (
                f"{loops:,} loop closure{'' if loops == 1 else 's'} in the drive shown",
                f"and {neighbours:,} odometry neighbours.",
            )
            lines = (*lines, *drive) if task.closures else (*drive, *lines[1:])
        self._summary.content = summary("graph-summary", lines)

    def _show_pairs(self, listed: Mapping[str, PairOfIds], chosen: PairOfIds | None = None) -> None:
        """Show the closures as they are decided; all that can be chosen, by label and in order."""
        self._show_summary()
        self._pairs.offer(listed, chosen)
        self._undo.disabled = len(self._desk.now.decided) < 2

    def _tell_world(self, *, relax: bool = False) -> None:
        closures, solved, chosen = self.closures, self._optimised, self._chosen
        graph = None if solved is None else solved.centred
        wrong = frozenset(() if graph is None else (fit.edge.pair for fit in graph.refused))
        loops = tuple(
            closure for closure in closures if closure.registration.T_database_query is not None
        )
        covariances = None if solved is None else solved.covariances
        correction = Correction(graph, covariances, loops, wrong, _highest(closures), chosen)
        self._world.correct(correction, relax=relax)


def result_rows(
    dataset: Dataset, graph: OptimisedGraph, seconds: float
) -> tuple[tuple[str, str], ...]:
    """Write the figures of an optimised graph as rows of a name and a value."""
    loops, neighbours = count_kinds(dataset, (fit.edge.pair for fit in graph.loops))
    left_out, others = count_kinds(dataset, (fit.edge.pair for fit in graph.refused))
    rows = [
        ("loop closures used", f"{loops - left_out} of {loops}"),
        ("odometry neighbours", f"{neighbours - others} of {neighbours}"),
    ]
    centred = graph.centred
    before = centred.at(0.0)
    moved = [
        float(np.linalg.norm(pose.translation - before[name].translation))
        for name, pose in centred.poses.items()
    ]
    rows.append(("largest correction", f"{max(moved):.2f} m"))
    true = dataset.true_poses
    if len(true) >= 2:
        judged, *estimates = (
            judged_poses(dataset, poses) for poses in (true, graph.at(0.0), graph.poses)
        )
        first, last = (
            trajectory_error(judged, poses, positions_only=dataset.positions_only)
            for poses in estimates
        )
        rows += [
            ("error (ATE)", f"{first.absolute:.3f} m → {last.absolute:.3f} m"),
            ("error per step (RPE)", f"{first.relative:.3f} m → {last.relative:.3f} m"),
        ]
    if graph.height_drift is not None:
        rows.append(("height", graph.height_note))
    rows.append(("solved in", f"{seconds:.2f} s"))
    return tuple(rows)


def _solve(task: _Task, progress: Progress) -> _Solved:
    graph = build_pose_graph(task.dataset, task.closures, trusted=task.decisions.trusted)
    result = optimise_pose_graph(graph, progress=progress)
    return _Solved(result, result.centred, measure_covariances(graph, result))


def _write(
    task: _Task,
    found: DetectionResult,
    params: PipelineParams,
    method: MethodName,
    graph: OptimisedGraph | None,
    path: Path,
    _progress: Progress,
) -> None:
    write_closure_file(
        path, task.dataset, found, params, method, decisions=task.decisions, solved=graph
    )


def _highest(closures: tuple[LoopClosure, ...]) -> float:
    return max((closure.registration.score for closure in closures), default=1.0) or 1.0


def _chi_squares(graph: OptimisedGraph | None) -> dict[PairOfIds, tuple[float, float]]:
    """Chi-square and weight of each closure in the graph."""
    if graph is None:
        return {}
    return {fit.edge.pair: (fit.chi_square, fit.weight) for fit in graph.loops}


def _label(closure: LoopClosure, chi_squares: dict[PairOfIds, tuple[float, float]]) -> str:
    pair = closure.pair
    verdict = "accepted" if closure.accepted else "refused"
    verdict = closure.reason if closure.by_hand else verdict
    score = score_in_words(closure.registration.score)
    label = f"{pair[0]} → {pair[1]} · {score} · {verdict}"
    if pair in chi_squares and closure.accepted:
        chi_square, weight = chi_squares[pair]
        label += f" · χ² {chi_square:.1f}" + ("" if weight >= 0.5 else ", left out")
    return label


def _summary(
    dataset: Dataset, closures: tuple[LoopClosure, ...], decisions: Decisions, *, outdated: bool
) -> tuple[str, ...]:
    if not closures:
        return NOT_FOUND
    accepted = [closure.pair for closure in closures if closure.accepted]
    loops, neighbours = count_kinds(dataset, accepted)
    all_loops, all_neighbours = count_kinds(dataset, (closure.pair for closure in closures))
    lines = [
        f"{loops:,} loop closures accepted of {all_loops:,} pairs",
        f"and {neighbours:,} of {all_neighbours:,} odometry neighbours.",
    ]
    if decisions.verdicts:
        lines.append(f"{len(decisions.verdicts)} decided by hand.")
    if outdated:
        lines.append("The closures have changed since: optimise again.")
    return tuple(lines)
