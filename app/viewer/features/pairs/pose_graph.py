"""The pose graph: which closures count, what becomes of each, and the map that they correct."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import viser
from jaxtyping import Float

from app.viewer.features.desk import Desk, Feature, ModeSwitch
from app.viewer.features.pairs.all_pairs import AllPairsTab
from app.viewer.features.pairs.model import PHASES
from app.viewer.features.work import Downloads, Work, write_closure_file
from app.viewer.features.world import SCORE_MAP, Correction, WorldTab
from app.viewer.scene.layers import Scale
from app.viewer.server.host import Host
from app.viewer.session.decisions import DECIDES, count_kinds, with_verdict
from app.viewer.session.news import AllPairs, DriveNews, SessionState
from app.viewer.session.state import same_search
from app.viewer.widgets.actions import on_choice, on_option, on_option_by, on_press, on_step, one_of
from app.viewer.widgets.html import summary, table
from app.viewer.widgets.legend import legend_html
from app.viewer.widgets.status import WorkBar
from gpgrad_core.detection.choosing import likely
from gpgrad_core.errors import count, score_in_words
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
    trusted: frozenset[PairOfIds]  # accepted by hand

    @property
    def key(self) -> object:
        """Equal for tasks of the same solution."""
        accepted = [
            (*closure.pair, closure.registration) for closure in self.closures if closure.accepted
        ]
        return accepted, self.trusted


@dataclass(frozen=True, eq=False)
class _Solved:
    """An optimised graph, and how certain x, y and yaw of its poses are (n, 3, 3)."""

    task: _Task
    graph: OptimisedGraph
    centred: OptimisedGraph  # the same between the submaps' centres
    covariances: Float[Array, "n 3 3"]


MOST_LISTED = 300
"""Longer lists make the browser slow; what is left out is counted."""


class PairList:
    """A dropdown whose first entry chooses no pair."""

    def __init__(
        self,
        host: Host,
        label: str,
        *,
        none: str,
        hint: str,
        on_choose: Callable[[PairOfIds | None], None],
    ) -> None:
        """Add the widgets; the first entry, ``none``, chooses None in place of a pair."""
        self._none = none
        self._on_choose = on_choose
        self._pairs: dict[str, PairOfIds] = {}
        self._list: viser.GuiDropdownHandle[str] = host.gui.add_dropdown(
            label, (none,), initial_value=none, hint=hint
        )
        steps = host.gui.add_button_group(
            f"Step {label.lower()}", ("previous", "next"), hint="Step through the list."
        )
        on_choice(self._list, lambda _: self._report())
        on_step(steps, self._step)

    @property
    def chosen(self) -> PairOfIds | None:
        return self._pairs.get(self._list.value)

    def offer(self, closures: Iterable[tuple[LoopClosure, str]], chosen: PairOfIds | None) -> None:
        """Fill the list with pairs, and words on each, up to `MOST_LISTED`; nothing is called."""
        pairs: dict[str, PairOfIds] = {}
        for closure, words in closures:
            score = score_in_words(closure.registration.score)
            pairs[f"{' → '.join(closure.pair)} · {score} · {words}"] = closure.pair
        self._pairs = dict(list(pairs.items())[:MOST_LISTED])
        first = self._none
        if len(pairs) > MOST_LISTED:
            first += f" (the first {MOST_LISTED} of {len(pairs):,})"
        options = (first, *self._pairs)
        if tuple(self._list.options) != options:
            self._list.options = options
        labels = [label for label, pair in self._pairs.items() if pair == chosen]
        self._list.value = labels[0] if labels else first

    def _step(self, step: int) -> None:
        labels = list(self._pairs)
        if not labels:
            return
        at = labels.index(self._list.value) + step if self.chosen is not None else 0
        self._list.value = labels[at % len(labels)]
        self._report()

    def _report(self) -> None:
        self._on_choose(self.chosen)


class PoseGraphTab(Feature):
    """Gathers the accepted closures, optimises on request, and notifies the world."""

    def __init__(
        self, desk: Desk, world: WorldTab, comparison: AllPairsTab, modes: ModeSwitch
    ) -> None:
        """Make the panel in the current container; the world shows loops and corrected poses."""
        self._desk = desk
        self._world = world
        self._chosen: PairOfIds | None = None
        self._solved: _Solved | None = None
        self._find_closures, self._waits = comparison.compare_pairs, False
        gui = desk.host.gui
        self._summary = gui.add_html("")
        find = gui.add_button(
            "Find closures",
            hint="Compares every submap with all earlier ones, like the tab All pairs.",
        )
        on_press(find, self._find_closures)
        optimise = gui.add_button(
            "Optimise",
            hint="Corrects the poses with the accepted closures, which are found first if need be, "
            "and shows how the map moves, with an ellipse of three standard deviations around each "
            "place. Closures that the others contradict are left out.",
        )
        on_press(optimise, self._optimise)
        self._bar = WorkBar(desk.host, "Cancel work", "graph", starts=(find, optimise))
        self._bar.on_cancel(comparison.stop_comparing)
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
        for box in (loops, refused):
            on_choice(
                box, lambda _: world.set_loops_shown(loops=loops.value, refused=refused.value)
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
        on_option(verdicts, lambda label: self._decide(DECIDES[label]))
        self._undo = gui.add_button(
            "Undo decision", disabled=True, hint="Takes the last decision by hand back."
        )
        on_press(self._undo, desk.take_back)
        tune = gui.add_button(
            "See it in Tune",
            hint="Opens the pair in Tune, where you can also nudge and refine its motion.",
        )
        on_press(tune, lambda: modes.tune(*self._chosen) if self._chosen else None)
        export = gui.add_button_group(
            "Export",
            tuple(FILES),
            hint="closures: all verdicts as JSON. g2o: the vertices and edges of the graph. TUM: "
            "the corrected poses.",
        )
        on_option_by(export, lambda page, label: self._order(page, one_of(tuple(FILES), label)))
        self._solver: Work[_Task, _Solved] = Work(
            desk.jobs,
            self._bar,
            lambda _: "Optimising",
            _solve,
            self._on_solved,
            slots=desk.capacity.long,
        )
        self._downloads = Downloads(desk.jobs, self._bar, desk.capacity.long)
        self._show_panel()

    def on_state(self, before: SessionState, state: SessionState) -> None:
        """Show what the decisions make of the closures; another search has other ones."""
        if not same_search(before.view, state.view):
            self._chosen, self._solved, self._waits = None, None, False
            self._solver.cancel()
            self._result.content = ""
            self._show_panel()
        if state.decisions is not before.decisions:
            self._show()

    def on_drive(self, news: DriveNews) -> None:
        if news == "drawn":
            self._show_summary()

    def on_pairs(self, before: AllPairs, pairs: AllPairs) -> None:
        """Show all pairs as the thresholds judge them, and how far their comparison is."""
        if pairs.verdicts is not before.verdicts:
            self._show()
            if self._waits and self._desk.closures:
                self._optimise()
        if pairs.fraction is not None:
            self._bar.running("Comparing all pairs", pairs.fraction, PHASES)
        elif before.fraction is not None:
            self._waits &= not pairs.message  # for nothing, if it was cancelled or failed
            self._bar.done(pairs.message)

    @property
    def graph(self) -> OptimisedGraph | None:
        return None if self._solved is None else self._solved.graph

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

    def _optimise(self) -> None:
        task = self._task()
        self._waits = not task.closures
        if self._waits:
            self._find_closures()
        elif not any(closure.accepted for closure in task.closures):
            self._bar.failed("No closure is accepted. Lower the thresholds, or accept one by hand.")
        else:
            self._solver.start(task)

    def _order(self, page: viser.ClientHandle, kind: str) -> None:
        task, state, decisions = self._task(), self._desk.state, self._desk.now.decisions
        graph = None if self._is_outdated(task) else self.graph
        if kind == "closures" and not task.closures:
            self._bar.failed("Find closures first.")
            return
        if kind == "TUM" and graph is None:
            self._bar.failed("Optimise first: there are no corrected poses of these closures yet.")
            return
        found = replace(self._desk.verdicts.found, closures=task.closures)

        def write(path: Path, _progress: Progress) -> None:
            write_closure_file(
                path,
                task.dataset,
                found,
                state.given,
                state.method,
                decisions=decisions,
                solved=graph,
            )

        self._downloads.order(page, FILES[kind], write)

    # What the worker does.

    def _on_solved(self, task: _Task, solved: _Solved, seconds: float) -> None:
        if task.dataset is not self._desk.state.dataset:
            return  # another was opened in the very last moment
        self._solved = solved
        rows = table(result_rows(task.dataset, solved.graph, seconds))
        self._result.content = (
            f'<div data-testid="graph-result" style="padding:.1em .75em">{rows}</div>'
        )
        self._show(relax=True)
        self._desk.host.flush()

    # What is shown.

    def _task(self) -> _Task:
        trusted = frozenset(self._desk.now.decisions.trusted)
        return _Task(self._desk.state.dataset, self._desk.closures, trusted)

    def _is_outdated(self, task: _Task) -> bool:
        return self._solved is not None and task.key != self._solved.task.key

    def _show(self, *, relax: bool = False) -> None:
        with self._desk.host.atomic():
            self._show_panel()
        self._tell_world(relax=relax)

    def _show_panel(self) -> None:
        closures, graph = self._desk.closures, self.graph
        fits = {} if graph is None else {fit.edge.pair: fit for fit in graph.loops}
        listed: list[tuple[LoopClosure, str]] = []
        for closure in likely(closures):
            verdict = "accepted" if closure.accepted else "refused"
            words = closure.reason if closure.by_hand else verdict
            if closure.accepted and (fit := fits.get(closure.pair)) is not None:
                words += f" · χ² {fit.chi_square:.1f}{'' if fit.weight >= 0.5 else ', left out'}"
            listed.append((closure, words))
        self._show_summary()
        self._pairs.offer(listed, self._chosen)
        self._undo.disabled = len(self._desk.now.decided) < 2
        scale = Scale("Loop closures", "score", SCORE_MAP, 0.0, _highest(closures))
        self._legend.content = legend_html(scale) if closures else ""

    def _show_summary(self) -> None:
        task, world = self._task(), self._world.world
        lines = _summary(task, len(self._desk.now.decisions.verdicts))
        if self._is_outdated(task) and task.closures:
            lines = (*lines, "The closures have changed since: optimise again.")
        if world is not None and world.past is not None:
            loops, neighbours = world.num_accepted
            drive = (
                f"{count(loops, 'loop closure')} in the drive shown",
                f"and {neighbours:,} odometry neighbours.",
            )
            lines = (*lines, *drive) if task.closures else (*drive, *lines[1:])
        self._summary.content = summary("graph-summary", lines)

    def _tell_world(self, *, relax: bool = False) -> None:
        closures, solved = self._desk.closures, self._solved
        graph = None if solved is None else solved.centred
        wrong = frozenset(() if graph is None else (fit.edge.pair for fit in graph.refused))
        loops = tuple(
            closure for closure in closures if closure.registration.T_database_query is not None
        )
        covariances = None if solved is None else solved.covariances
        correction = Correction(graph, covariances, loops, wrong, _highest(closures), self._chosen)
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
    most, name = max(
        (float(np.linalg.norm(pose.translation - before[name].translation)), name)
        for name, pose in centred.poses.items()
    )
    rows.append(("largest correction", f"{most:.2f} m, of {name}"))
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
    graph = build_pose_graph(task.dataset, task.closures, trusted=task.trusted)
    result = optimise_pose_graph(graph, progress=progress)
    return _Solved(task, result, result.centred, measure_covariances(graph, result))


def _highest(closures: tuple[LoopClosure, ...]) -> float:
    return max((closure.registration.score for closure in closures), default=1.0) or 1.0


def _summary(task: _Task, num_decided: int) -> tuple[str, ...]:
    if not task.closures:
        return NOT_FOUND
    accepted = [closure.pair for closure in task.closures if closure.accepted]
    loops, neighbours = count_kinds(task.dataset, accepted)
    every = count_kinds(task.dataset, (closure.pair for closure in task.closures))
    lines = (
        f"{count(loops, 'loop closure')} accepted of {count(every[0], 'pair')}",
        f"and {neighbours:,} of {every[1]:,} odometry neighbours.",
    )
    return (*lines, f"{num_decided} decided by hand.") if num_decided else lines
