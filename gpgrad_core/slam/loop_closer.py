"""Loop closing while the robot drives: submaps are added one by one."""

from collections.abc import Iterable, MutableMapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypedDict

import numpy as np
from jaxtyping import Float
from typing_extensions import Unpack

from gpgrad_core.detection import Pairs, PipelineParams
from gpgrad_core.detection.shortlist import Candidate, Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.run.store import Store
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import (
    GraphParams,
    PoseGraph,
    loop_edge,
    odometry_edge,
    odometry_poses,
    shifted,
)
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    Problem,
    SolverParams,
    measure_covariances,
    optimise_onward,
    optimise_pose_graph,
)
from gpgrad_core.slam.traverses import place_traverses
from gpgrad_core.types import (
    Array,
    Dataset,
    LoopClosure,
    LoopDetector,
    PairOfIds,
    Registration,
    Submap,
)

BYTES_IN_MEMORY = 1_000_000_000
"""Bytes of maps and keypoints of earlier submaps to hold in memory; the rest is on disk."""
MEMO_BYTES = 200_000_000
"""Small, because each pair is compared only once."""


class TableOptions(TypedDict, total=False):
    """What the table of pairs of a drive takes besides its parameters; see `Pairs`."""

    detector: LoopDetector | None
    candidates: Candidates
    store: Store | None
    registered: MutableMapping[PairOfIds, Registration] | None
    bytes_in_memory: float


@dataclass(frozen=True, eq=False)
class Step:
    """The result of adding a submap.

    Attributes:
        closures: The verdict on the new submap and each earlier one that it was compared to.
        poses: ``T_world_submap`` of all submaps so far, by id.
        shortlist: The earlier submaps that it was compared with and why, the best first; None if
            it was compared with all that are near enough.
    """

    closures: tuple[LoopClosure, ...]
    poses: dict[str, Pose]
    shortlist: tuple[Candidate, ...] | None = None

    @property
    def accepted(self) -> tuple[LoopClosure, ...]:
        """The loop closures among them."""
        return tuple(closure for closure in self.closures if closure.accepted)


class LoopCloser:
    """Finds the closures of each new submap, and keeps the trajectory corrected.

    After the last submap it has found what `detect_loop_closures` and `optimise_pose_graph` find
    on all submaps at once. Points are not stored, and maps beyond 1 GB are stored in a temporary
    folder, which `close` or the end of a ``with`` block removes.

    >>> from gpgrad_core import demo_path, load_dataset
    >>> with LoopCloser() as closer:
    ...     for submap in load_dataset(demo_path()).submaps[:2]:
    ...         step = closer.add(submap)
    >>> len(step.closures), len(step.poses)
    (1, 2)
    """

    def __init__(
        self,
        params: PipelineParams | None = None,
        graph: GraphParams | None = None,
        solver: SolverParams | None = None,
        *,
        search_radius: float | None = None,
        executor: Executor | None = None,
        incremental: bool = False,
        **table: Unpack[TableOptions],
    ) -> None:
        """Begin with no submap.

        Args:
            params: Parameters of all stages of the detection. What is automatic is fitted to the
                first submap (`resolve_parameters`).
            graph: How certain odometry and closures are.
            solver: When a closure counts as wrong.
            search_radius: Compare only submaps whose centres lie within this distance of each
                other in the current estimate [m]; None compares all.
            executor: Threads or processes that share the comparisons; processes read what they
                compare from a detector's store.
            incremental: Whether each solution starts from the last one, as long as new closures
                agree with it: quick, and nearly what the whole gives. `settle` solves the whole.
            table: What else `Pairs` takes: detector, candidates, store, registered,
                bytes_in_memory (1 GB).

        Raises:
            InputError: If the number of candidates is none that is allowed, or if the detector
                has no keypoints to choose them by.
        """
        options: TableOptions = {"bytes_in_memory": BYTES_IN_MEMORY, **table}
        self._pairs = Pairs((), params, memo=Memo(MEMO_BYTES, table.get("store")), **options)
        self._graph, self._solver = graph or GraphParams(), solver
        self._radius, self._executor = search_radius, executor
        self._traverses: list[int] = []  # number of each submap's traverse
        self._poses: dict[str, Pose] = {}
        self._judged: tuple[int, tuple[LoopClosure, ...]] = 0, ()  # of how many submaps
        self._built: tuple[int, PoseGraph] | None = None
        self._posed: Problem | None = None
        self._solved: tuple[int, OptimisedGraph] | None = None
        self._incremental, self._is_whole = incremental, True
        self._settled: tuple[int, OptimisedGraph] | None = None

    def __enter__(self) -> "LoopCloser":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the temporary folder; no more submaps can be added."""
        self._pairs.close()

    def compare_alone(self) -> None:
        """Compare in the calling thread from now on, as when the executor has lost a process."""
        self._executor = None

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """The verdicts on all pairs compared so far, sorted by query and then by database.

        A later submap may change an earlier verdict, because pairs speak for and against others.
        """
        if self._judged[0] != len(self._submaps):
            self._judged = len(self._submaps), tuple(self._pairs.judge())
        return self._judged[1]

    @property
    def graph(self) -> PoseGraph:
        """The odometry and the accepted closures so far; joined traverses share one frame."""
        if self._built is None or self._built[0] != len(self._submaps):
            self._built = len(self._submaps), self._build()
        return self._built[1]

    @property
    def accepted_pairs(self) -> frozenset[PairOfIds]:
        """Ids (query, database) of all accepted pairs so far; quicker than `closures`."""
        return frozenset(self._pairs.accepted)

    def closures_of(self, pairs: Iterable[PairOfIds]) -> tuple[LoopClosure, ...]:
        """Give the verdicts on some pairs that were compared, by ids (query, database)."""
        return tuple(self._pairs.judge(pairs=pairs))

    @property
    def _submaps(self) -> Sequence[Submap]:
        return self._pairs.submaps

    def _build(self) -> PoseGraph:
        """Build the graph as `build_pose_graph` does; edges of the last one are not made again."""
        traverse = Dataset("the traverse", tuple(self._submaps))
        poses, centres = odometry_poses(traverse), traverse.centres
        known = () if self._built is None else self._built[1].edges
        made = {(*edge.pair, edge.kind): edge for edge in known}
        edges = [
            made.get((end.id, start.id, "odometry")) or odometry_edge(start, end, self._graph)
            for (start, end), (before, number) in zip(
                pairwise(self._submaps), pairwise(self._traverses), strict=True
            )
            if number == before
        ]
        for pair, score in self._pairs.accepted.items():
            edge = made.get((*pair, "loop"))
            if edge is None:
                registration = replace(self._pairs.registration(pair), score=score)
                closure = LoopClosure(*pair, registration, True, "")
                edge = loop_edge(closure, poses, centres, self._graph)
            edges.append(edge if edge.score == score else replace(edge, score=score))
        graph = PoseGraph(poses, tuple(edges), self._graph.tilt_std, centres=centres)
        return place_traverses(graph).graph

    @property
    def _problem(self) -> Problem:
        """The graph to be solved; most of it is that of the graph before."""
        graph = self.graph
        if self._posed is None or self._posed.graph is not graph:
            self._posed = Problem(graph, last=self._posed)
        return self._posed

    @property
    def result(self) -> OptimisedGraph:
        """The solved graph of all submaps so far; each new submap causes one solution at most."""
        count = len(self._submaps)
        if self._settled is not None and self._settled[0] == count:
            return self._settled[1]
        if self._solved is None or self._solved[0] != count:
            onward = None
            if self._incremental and self._solved is not None:
                onward = optimise_onward(self._problem, self._solved[1], self._solver)
            self._is_whole = onward is None
            self._solved = count, onward or optimise_pose_graph(self._problem, self._solver)
        return self._solved[1]

    @property
    def is_whole(self) -> bool:
        """Whether `result` is what all submaps at once give."""
        result = self.result
        return self._is_whole or (self._settled is not None and self._settled[1] is result)

    def measure_covariances(self, names: Sequence[str] | None = None) -> Float[Array, "n 3 3"]:
        """Measure how certain poses of `result` are; see `optimise.measure_covariances`."""
        return measure_covariances(self._problem, self.result, names)

    def settle(self, progress: Progress = silent) -> None:
        """Make `result` what all submaps at once give; later solutions do not start from it."""
        if not self.is_whole:
            whole = optimise_pose_graph(self._problem, self._solver, progress)
            self._settled = len(self._submaps), whole

    def add(
        self,
        submap: Submap,
        progress: Progress = silent,
        *,
        starts_traverse: bool = False,
        solve: bool = True,
    ) -> Step:
        """Take the next submap of the traverse.

        Args:
            submap: The submap, with an odometry pose.
            progress: Called with the fraction done; if it raises Cancelled, the submap is not
                added.
            starts_traverse: Whether a new traverse begins, to which no odometry leads.
            solve: Whether an accepted closure corrects the poses at once; otherwise they are
                corrected when `result` is read.

        Raises:
            InputError: If the submap has no odometry pose, its id is not new, or its map cannot be
                made.
            OSError: If a process of the executor has died. The submap is not added then.
        """
        if submap.pose_odometry is None:
            raise InputError(f"submap {submap.id} has no odometry pose, which a pose graph needs")
        number = self._traverses[-1] + starts_traverse if self._traverses else 0
        predicted = self._predicted(submap.pose_odometry, starts_traverse=starts_traverse)
        near = None
        if self._radius is not None:
            near = {
                other.id
                for other, traverse in zip(self._submaps, self._traverses, strict=True)
                if traverse != number
                or self._near(
                    shifted(predicted, submap.centre), shifted(self._poses[other.id], other.centre)
                )
            }
        compared = self._pairs.add(submap, self._executor, progress, among=near)
        self._traverses.append(number)
        self._poses[submap.id] = predicted
        closures = tuple(self._pairs.judge(pairs=compared))  # others are judged if asked for
        if solve and any(closure.accepted for closure in closures):
            self._poses = dict(self.result.poses)
        return Step(closures, dict(self._poses), self._pairs.shortlists.get(submap.id))

    def _predicted(self, odometry: Pose, *, starts_traverse: bool) -> Pose:
        """Predict the next pose by odometry from the last submap's."""
        if not self._submaps or starts_traverse:
            return odometry
        last = self._submaps[-1]
        assert last.pose_odometry is not None
        return self._poses[last.id] @ last.pose_odometry.inverse() @ odometry

    def _near(self, first: Pose, second: Pose) -> bool:
        distance = np.linalg.norm(first.translation[:2] - second.translation[:2])
        return self._radius is None or bool(distance <= self._radius)
