"""The pose graph: wires closures, decisions by hand and the optimiser to the world."""

import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import viser

from app.viewer.all_pairs.judging import Judged
from app.viewer.capacity import Turns
from app.viewer.draw.colors import legend_uri
from app.viewer.feature import Part
from app.viewer.host import Host
from app.viewer.pair.panel import legend_html
from app.viewer.pose_graph.decisions import Decisions, Pair, decide, with_motion, with_verdict
from app.viewer.pose_graph.panel import (
    Format,
    Listed,
    PoseGraphCalls,
    PoseGraphPanel,
    Verdict,
)
from app.viewer.runner import Runner
from app.viewer.state import ViewState
from app.viewer.world.lines import SCORE_MAP, Loop
from app.viewer.world.tab import Correction, Explore
from gpgrad_core.datasets.folder import index_of
from gpgrad_core.datasets.poses import write_poses
from gpgrad_core.outputs import report_closures, write_closures
from gpgrad_core.pipeline import DetectionResult
from gpgrad_core.run.progress import Progress
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import (
    OptimisedGraph,
    build_pose_graph,
    optimise_pose_graph,
    write_graph,
)
from gpgrad_core.slam.truth import trajectory_error, true_poses
from gpgrad_core.types import Dataset, LoopClosure, Registration

FILES: dict[Format, str] = {
    "closures": "closures.json",
    "g2o": "graph.g2o",
    "TUM": "poses_corrected.txt",
}
ACCEPTABLE: dict[Verdict, bool | None] = {"accept": True, "refuse": False, "as found": None}
NOT_FOUND = (
    "No closures yet.",
    "Find closures compares all pairs with the parameters as they are; the thresholds on the right "
    "then decide which are accepted.",
)


@dataclass(frozen=True, eq=False)
class _Task:
    """What the optimiser works on."""

    dataset: Dataset
    closures: tuple[LoopClosure, ...]
    trusted: tuple[Pair, ...]

    @property
    def key(self) -> object:
        """Equal for tasks of the same solution."""
        accepted = [
            (one.query_id, one.database_id, one.registration)
            for one in self.closures
            if one.accepted
        ]
        return accepted, sorted(self.trusted)


@dataclass(frozen=True, eq=False)
class _Order:
    """A file that a page wants."""

    client: viser.ClientHandle
    kind: Format
    task: _Task
    state: ViewState
    graph: OptimisedGraph | None


class PoseGraph(Part):
    """Gathers the accepted closures, optimises when asked, and tells the world."""

    def __init__(
        self,
        host: Host,
        state: ViewState,
        turns: Turns,
        explore: Explore,
        *,
        on_find: Callable[[], None],
        on_cancel_find: Callable[[], None],
        on_tune: Callable[[str, str], None],
        message_of: Callable[[Exception], str],
    ) -> None:
        """Make the panel in the current container.

        Args:
            host: Whose GUI it joins.
            state: The session as it is.
            turns: Held while the graph is optimised.
            explore: The world that shows it.
            on_find: Called when all pairs are to be compared.
            on_cancel_find: Called when they no longer are.
            on_tune: Given the query and the database to tune.
            message_of: Says what went wrong in one line.
        """
        self._host = host
        self._explore = explore
        self._on_tune = on_tune
        self._on_cancel_find = on_cancel_find
        self._lock = threading.Lock()
        self._state = state
        self._found: tuple[LoopClosure, ...] = ()
        self._history: list[Decisions] = [Decisions()]
        self._chosen: Pair | None = None
        self._graph: OptimisedGraph | None = None
        self._solved: object = None  # what it was optimised from
        self._panel = PoseGraphPanel(
            host,
            PoseGraphCalls(
                on_find=on_find,
                on_cancel=self._cancel,
                on_optimise=self._optimise,
                on_shown=lambda loops, refused: explore.set_loops_shown(
                    loops=loops, refused=refused
                ),
                on_choose=self._choose,
                on_verdict=self._decide,
                on_undo=self._undo,
                on_tune=self._tune,
                on_export=self._order,
            ),
        )

        def failed(job: object, error: Exception) -> None:
            del job
            self._panel.stopped(message_of(error), bad=True)

        def cancelled(job: object) -> None:
            del job
            self._panel.stopped("Cancelled.")

        self._solver: Runner[_Task, OptimisedGraph] = Runner(
            self._solve,
            self._on_solved,
            failed,
            on_cancel=cancelled,
            turns=turns.long,
            name="pose graph",
        )
        self._writer: Runner[_Order, bytes] = Runner(
            _write, self._hand_over, failed, name="pose graph's files"
        )
        self._panel.show(NOT_FOUND, (), chosen=None, can_undo=False)

    def follow(self, state: ViewState) -> None:
        """Follow the session; another dataset has other closures."""
        with self._lock:
            before, self._state = self._state, state
            if before.dataset is state.dataset:
                return
            self._found, self._history = (), [Decisions()]
            self._chosen, self._graph, self._solved = None, None, None
        self._solver.cancel()
        self._panel.show_result(())
        self._panel.show_legend("")
        self._panel.show(NOT_FOUND, (), chosen=None, can_undo=False)

    def judged(self, judged: Judged) -> None:
        """Take all pairs as the thresholds judge them."""
        with self._lock:
            if judged.survey.dataset is not self._state.dataset:
                return
            self._found = judged.closures
        self._show()

    def finding(self, fraction: float | None, message: str) -> None:
        """Take how far the comparison of all pairs is; None once nothing runs."""
        if fraction is None:
            self._panel.stopped(message)
        else:
            self._panel.running("Comparing all pairs", fraction)

    def take_motion(self, query: str, database: str, registration: Registration) -> None:
        """Take a registration set by hand, and accept it."""
        self._remember(lambda decisions: with_motion(decisions, (query, database), registration))

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """All closures as decided."""
        with self._lock:
            return self._closures()

    @property
    def graph(self) -> OptimisedGraph | None:
        """The graph as last optimised."""
        return self._graph

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs; says whether that came true within the timeout [s]."""
        return self._solver.wait_idle(timeout) and self._writer.wait_idle(timeout)

    def close(self) -> None:
        """Stop."""
        self._solver.close()
        self._writer.close()

    # What the widgets ask for.

    def _cancel(self) -> None:
        self._on_cancel_find()
        self._solver.cancel()

    def _choose(self, pair: Pair | None) -> None:
        with self._lock:
            self._chosen = pair
        self._tell_world()

    def _decide(self, verdict: Verdict) -> None:
        pair = self._chosen
        if pair is None:
            self._panel.stopped("Choose a closure first.", bad=True)
            return
        self._panel.stopped()
        self._remember(lambda decisions: with_verdict(decisions, pair, ACCEPTABLE[verdict]))

    def _remember(self, change: Callable[[Decisions], Decisions]) -> None:
        with self._lock:
            self._history.append(change(self._history[-1]))
        self._show()

    def _undo(self) -> None:
        with self._lock:
            if len(self._history) > 1:
                self._history.pop()
        self._show()

    def _tune(self) -> None:
        if self._chosen is not None:
            self._on_tune(*self._chosen)

    def _optimise(self) -> None:
        task = self._task()
        if not any(closure.accepted for closure in task.closures):
            self._panel.stopped(
                "No closure is accepted: find closures, lower the thresholds, or accept one by "
                "hand.",
                bad=True,
            )
            return
        self._panel.running("Optimising", 0.0)
        self._solver.submit(task)

    def _order(self, client: viser.ClientHandle, kind: Format) -> None:
        task = self._task()
        graph = self._graph if task.key == self._solved else None
        if kind == "closures" and not self.closures:
            self._panel.stopped("Find closures first.", bad=True)
            return
        if kind == "TUM" and graph is None:
            self._panel.stopped("Optimise first: these closures have corrected nothing.", bad=True)
            return
        self._writer.submit(_Order(client, kind, task, self._state, graph))

    # What the workers do.

    def _solve(self, task: _Task, progress: Progress) -> OptimisedGraph:
        def report(fraction: float) -> None:
            progress(fraction)
            self._panel.running("Optimising", fraction)

        graph = build_pose_graph(task.dataset, task.closures, trusted=task.trusted)
        return optimise_pose_graph(graph, progress=report)

    def _on_solved(self, task: _Task, graph: OptimisedGraph, seconds: float) -> None:
        with self._lock:
            if task.dataset is not self._state.dataset:
                return  # another was opened in the very last moment
            self._graph, self._solved = graph, task.key
        self._panel.stopped()
        self._panel.show_result(result_rows(task.dataset, graph, seconds))
        self._show(relax=True)
        self._host.flush()

    def _hand_over(self, order: _Order, content: bytes, seconds: float) -> None:
        del seconds
        name = FILES[order.kind]
        order.client.send_file_download(name, content, save_immediately=True)
        self._panel.stopped(f"{name}: {len(content):,} bytes.")

    # What is shown.

    def _closures(self) -> tuple[LoopClosure, ...]:
        return decide(self._found, self._history[-1])

    def _task(self) -> _Task:
        with self._lock:
            return _Task(self._state.dataset, self._closures(), self._history[-1].trusted)

    def _show(self, *, relax: bool = False) -> None:
        with self._lock:
            closures, decisions, chosen = self._closures(), self._history[-1], self._chosen
            can_undo, graph = len(self._history) > 1, self._graph
        outdated = graph is not None and self._task().key != self._solved
        ordered = sorted(closures, key=lambda one: (not one.accepted, -one.registration.score))
        chi_squares = _chi_squares(graph)
        listed = tuple(
            Listed(one.query_id, one.database_id, _label(one, chi_squares)) for one in ordered
        )
        summary = _summary(closures, decisions, outdated=outdated)
        with self._host.atomic():
            self._panel.show(summary, listed, chosen=chosen, can_undo=can_undo)
            self._panel.show_legend(_legend(_highest(closures)) if closures else "")
        self._tell_world(relax=relax)

    def _tell_world(self, *, relax: bool = False) -> None:
        with self._lock:
            closures, graph = self._closures(), self._graph
            chosen = self._chosen
        wrong = set() if graph is None else {(f.edge.end, f.edge.start) for f in graph.refused}
        loops = tuple(
            Loop(
                one.query_id,
                one.database_id,
                one.registration.score,
                one.accepted,
                wrong=(one.query_id, one.database_id) in wrong,
            )
            for one in closures
            if one.registration.T_database_query is not None
        )
        correction = Correction(graph, loops, _highest(closures), chosen)
        self._explore.correct(correction, relax=relax)


def result_rows(
    dataset: Dataset, graph: OptimisedGraph, seconds: float
) -> tuple[tuple[str, str], ...]:
    """Write the figures of an optimised graph as rows of a name and a value."""
    used = len(graph.loops) - len(graph.refused)
    rows = [("closures used", f"{used} of {len(graph.loops)}")]
    before = graph.at(0.0)
    moved = [
        float(np.linalg.norm(pose.translation - before[name].translation))
        for name, pose in graph.poses.items()
    ]
    rows.append(("farthest moved", f"{max(moved):.2f} m"))
    true = true_poses(dataset)
    if len(true) >= 2:
        first, last = (trajectory_error(true, poses) for poses in (before, graph.poses))
        rows += [
            ("error (ATE)", f"{first.absolute:.3f} m → {last.absolute:.3f} m"),
            ("of one step", f"{first.relative:.3f} m → {last.relative:.3f} m"),
        ]
    rows.append(("solved in", f"{seconds:.2f} s"))
    return tuple(rows)


def _write(order: _Order, progress: Progress) -> bytes:
    del progress
    dataset, task = order.task.dataset, order.task
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / FILES[order.kind]
        if order.kind == "closures":
            result = DetectionResult(task.closures, {"total": 0.0})
            write_closures(path, report_closures(dataset, result, order.state.params))
        elif order.kind == "g2o":
            graph = build_pose_graph(dataset, task.closures, trusted=task.trusted)
            write_graph(path, graph, None if order.graph is None else order.graph.poses)
        elif order.graph is not None:
            write_poses(path, _numbered(order.graph.poses))
        return path.read_bytes()


def _numbered(poses: dict[str, Pose]) -> dict[int, Pose]:
    """Number poses as the dataset's files do, or in order where names have no number."""
    numbers = [index_of(name) for name in poses]
    known = [number for number in numbers if number is not None]
    if len(set(known)) == len(numbers):
        return dict(zip(known, poses.values(), strict=True))
    return dict(enumerate(poses.values()))


def _highest(closures: tuple[LoopClosure, ...]) -> float:
    return max((one.registration.score for one in closures), default=1.0) or 1.0


def _chi_squares(graph: OptimisedGraph | None) -> dict[Pair, tuple[float, float]]:
    """Chi-square and weight of each closure in the graph."""
    if graph is None:
        return {}
    return {(fit.edge.end, fit.edge.start): (fit.chi_square, fit.weight) for fit in graph.loops}


def _label(closure: LoopClosure, chi_squares: dict[Pair, tuple[float, float]]) -> str:
    pair = closure.query_id, closure.database_id
    said = closure.reason if closure.reason.endswith("by hand") else ""
    verdict = said or ("accepted" if closure.accepted else "refused")
    label = f"{pair[0]} → {pair[1]} · {closure.registration.score:.1f} · {verdict}"
    if pair in chi_squares and closure.accepted:
        chi_square, weight = chi_squares[pair]
        label += f" · χ² {chi_square:.1f}" + ("" if weight >= 0.5 else ", left out")
    return label


def _summary(
    closures: tuple[LoopClosure, ...], decisions: Decisions, *, outdated: bool
) -> tuple[str, ...]:
    if not closures:
        return NOT_FOUND
    accepted = sum(one.accepted for one in closures)
    lines = [f"{accepted} closures accepted of {len(closures):,} pairs"]
    if decisions.verdicts:
        lines.append(f"{len(decisions.verdicts)} decided by hand.")
    if outdated:
        lines.append("The closures have changed since: optimise again.")
    return tuple(lines)


def _legend(highest: float) -> str:
    bar = legend_uri(SCORE_MAP)
    return legend_html(bar, "Loop closures", "score", low=0.0, high=highest)
