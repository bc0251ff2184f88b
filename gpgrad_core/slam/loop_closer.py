"""Loop closing while the robot drives: submaps are added one by one."""

from collections.abc import Callable, Iterable, MutableMapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import attrgetter
from typing import Any, TypedDict, TypeVar, cast

import numpy as np
from jaxtyping import Float
from typing_extensions import Unpack

from gpgrad_core.detection import Pairs, PipelineParams
from gpgrad_core.detection.shortlist import Candidate, Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.former import former_parameter
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
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
    pose_rows,
    poses_of,
)
from gpgrad_core.slam.traverses import JoinedDatasets, place_traverses
from gpgrad_core.types import (
    Array,
    Dataset,
    LoopClosure,
    LoopDetector,
    PairOfIds,
    Registration,
    Submap,
    read_only,
)

T = TypeVar("T")

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
    """What adding a submap decided, and where all submaps lie then.

    Attributes:
        closures: The verdict on the new submap and each earlier one that it was compared with.
        shortlist: The earlier submaps that it was compared with and why, the best first; None if
            it was compared with all that are near enough.
        ids: Ids of all submaps so far, in their order; the new one is the last.
        places: Their ``T_world_submap`` (n, 7): x, y, z [m], qx, qy, qz, qw.
    """

    closures: tuple[LoopClosure, ...]
    shortlist: tuple[Candidate, ...] | None
    ids: tuple[str, ...]
    places: Float[Array, "n 7"]

    def __post_init__(self) -> None:
        read_only(self.places)

    @property
    def submap_id(self) -> str:
        """Id of the submap that was added."""
        return self.ids[-1]

    @property
    def number(self) -> int:
        """Number of the submap in the drive, from 0."""
        return len(self.ids) - 1

    @property
    def poses(self) -> dict[str, Pose]:
        """``T_world_submap`` of all submaps so far, by id."""
        return poses_of(self.ids, self.places)

    @property
    def accepted(self) -> tuple[LoopClosure, ...]:
        """The loop closures of the new submap."""
        return tuple(closure for closure in self.closures if closure.accepted)

    @property
    def refused(self) -> tuple[LoopClosure, ...]:
        """The other pairs that it was compared in."""
        return tuple(closure for closure in self.closures if not closure.accepted)


@dataclass(frozen=True, eq=False)
class Moment(Step):
    """A step of a `Drive`: its poses are corrected by all closures so far.

    Attributes:
        odometry: The submap's pose by odometry, ``T_odometry_submap``.
        starts_traverse: Whether it begins another traverse, to which no odometry leads.
        flipped: The new verdicts on earlier pairs that it has changed: from refused to accepted, or
            back.
        rejected: Accepted pairs of all so far that the solved graph contradicts, and leaves out.
        covariances: Covariance (n, 3, 3) of the x [m], y [m] and yaw [rad] of each, in the world.
        moved: Distance [m] by which this submap moved the earlier one that it moved the most.
    """

    odometry: Pose
    starts_traverse: bool
    flipped: tuple[LoopClosure, ...]
    rejected: tuple[PairOfIds, ...]
    covariances: Float[Array, "n 3 3"]
    moved: float

    def __post_init__(self) -> None:
        read_only(self.places, self.covariances)

    @cached_property
    def loops(self) -> tuple[LoopClosure, ...]:
        """Its loop closures, without the one with the submap that it follows by odometry."""
        before = () if self.starts_traverse else self.ids[-2:-1]
        return tuple(closure for closure in self.accepted if closure.database_id not in before)

    turned = property(attrgetter("flipped"), doc="The former name of `flipped`.")
    left_out = property(attrgetter("rejected"), doc="The former name of `rejected`.")


def verdicts_at(moments: Iterable[Moment]) -> dict[PairOfIds, LoopClosure]:
    """The verdict on every pair as it was after the last of some moments."""
    closures = (one for moment in moments for one in (*moment.closures, *moment.flipped))
    return {closure.pair: closure for closure in closures}


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
        self._graph, self._solver = graph or GraphParams(), solver or SolverParams()
        self._radius, self._executor, self._incremental = search_radius, executor, incremental
        self._traverses: list[int] = []  # number of each submap's traverse
        self._poses: dict[str, Pose] = {}
        self._variance_factor = 1.0  # by which the graph's closures were weighed
        self._cache: dict[str, tuple[int, Any]] = {}  # what was made last, of how many submaps
        self._last: Step | None = None
        self._posed: Problem | None = None
        self._unsettled: OptimisedGraph | None = None  # from which the next solution starts
        self._is_whole = True  # whether that did not start from another

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
        return self._now("closures", lambda: tuple(self._pairs.judge()))

    @property
    def accepted_pairs(self) -> frozenset[PairOfIds]:
        """Ids (query, database) of all accepted pairs so far; quicker than `closures`."""
        return frozenset(self._pairs.accepted)

    @property
    def graph(self) -> PoseGraph:
        """The odometry and the accepted closures so far; joined traverses share one frame."""
        return self._now("graph", self._build)

    @property
    def result(self) -> OptimisedGraph:
        """The solved graph of all submaps so far; each new submap causes one solution at most."""
        return self._now("result", self._solve)

    @property
    def is_whole(self) -> bool:
        """Whether `result` is what all submaps at once give."""
        return self.result is not self._unsettled or self._is_whole

    @property
    def _submaps(self) -> Sequence[Submap]:
        return self._pairs.submaps

    def _now(self, name: str, make: Callable[[], T]) -> T:
        """Make something of all submaps so far, unless it is known."""
        count, result = self._cache.get(name, (-1, None))
        if count != len(self._submaps):
            result = make()
            self._cache[name] = len(self._submaps), result
        return cast("T", result)

    def _build(self) -> PoseGraph:
        """Build the graph as `build_pose_graph` does; edges of the last one are not made again."""
        traverse = Dataset("the traverse", tuple(self._submaps))
        poses, centres = odometry_poses(traverse), traverse.centres
        earlier = self._cache["graph"][1].edges if "graph" in self._cache else ()
        last_factor, self._variance_factor = self._variance_factor, self._pairs.variance_factor
        reusable = {
            (*edge.pair, edge.kind): edge
            for edge in earlier
            if edge.kind == "odometry" or last_factor == self._variance_factor
        }
        edges = [
            reusable.get((end.id, start.id, "odometry")) or odometry_edge(start, end, self._graph)
            for (start, end), (before, number) in zip(
                pairwise(self._submaps), pairwise(self._traverses), strict=True
            )
            if number == before
        ]
        for pair, score in self._pairs.accepted.items():
            edge = reusable.get((*pair, "loop"))
            if edge is None:
                (closure,) = self._pairs.judge(pairs=[pair])
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

    def _solve(self) -> OptimisedGraph:
        onward = None
        if self._incremental and self._unsettled is not None:
            onward = optimise_onward(self._problem, self._unsettled, self._solver)
        self._is_whole = onward is None
        self._unsettled = onward or optimise_pose_graph(self._problem, self._solver)
        return self._unsettled

    def measure_covariances(self, names: Sequence[str] | None = None) -> Float[Array, "n 3 3"]:
        """Measure how certain poses of `result` are; see `optimise.measure_covariances`."""
        return measure_covariances(self._problem, self.result, names)

    def settle(self, progress: Progress = silent) -> Step | None:
        """Make `result` what all submaps at once give; later solutions do not start from it.

        Only with `incremental` may it have been another. If the progress raises Cancelled, nothing
        is settled.

        Returns:
            The step that takes the place of the last one; None if that is settled already.
        """
        if self._last is None or self.is_whole:
            return None
        whole = optimise_pose_graph(self._problem, self._solver, progress)
        self._cache["result"] = len(self._submaps), whole
        return replace(self._last, places=pose_rows(whole.poses))

    @former_parameter("solve")
    def add(
        self,
        submap: Submap,
        progress: Progress = silent,
        *,
        starts_traverse: bool = False,
    ) -> Step:
        """Add the next submap of the traverse; an accepted closure corrects the poses at once.

        Args:
            submap: The submap, with an odometry pose.
            progress: Called with the fraction done; if it raises Cancelled, the submap is not
                added.
            starts_traverse: Whether a new traverse begins, to which no odometry leads.

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
            others = zip(self._submaps, self._traverses, strict=True)
            here = shifted(predicted, submap.centre).translation
            near = {
                other.id
                for other, traverse in others
                if traverse != number
                or np.linalg.norm((here - self._centre(other))[:2]) <= self._radius
            }
        compared = self._pairs.add(submap, self._executor, progress, among=near)
        self._traverses.append(number)
        self._poses[submap.id] = predicted
        closures = tuple(self._pairs.judge(pairs=compared))  # others are judged if asked for
        if any(closure.accepted for closure in closures):
            self._poses = dict(self.result.poses)
        shortlist = self._pairs.shortlists.get(submap.id)
        self._last = Step(closures, shortlist, tuple(self._poses), pose_rows(self._poses))
        return self._last

    def add_all(
        self,
        joined: JoinedDatasets,
        on_step: Callable[[Step], None],
        on_note: Callable[[str], None],
        progress: Progress = silent,
    ) -> dict[str, int]:
        """Add the submaps of datasets in their order, without those that have no terrain.

        Returns:
            The number of points of each submap that was taken, by its id.
        """
        total, sizes, following = len(joined.outline.clouds), dict[str, int](), 0
        for k, submap in joined.sound(on_note):
            passed = joined.outline.dataset.submaps[following : k + 1]
            following = k + 1
            step = self.add(
                submap,
                part(progress, (k / total) ** 2, ((k + 1) / total) ** 2),
                starts_traverse=any(one.id in joined.starts for one in passed),
            )
            sizes[submap.id] = len(submap.points)
            on_step(step)
        return sizes

    def _predicted(self, odometry: Pose, *, starts_traverse: bool) -> Pose:
        """Predict the next pose by odometry from the last submap's."""
        if not self._submaps or starts_traverse:
            return odometry
        last = self._submaps[-1]
        assert last.pose_odometry is not None
        return self._poses[last.id] @ last.pose_odometry.inverse() @ odometry

    def _centre(self, submap: Submap) -> Float[Array, "3"]:
        return shifted(self._poses[submap.id], submap.centre).translation
