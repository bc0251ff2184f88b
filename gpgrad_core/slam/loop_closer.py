"""Loop closing while the robot drives: submaps are added one by one."""

import pickle
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import inf
from pathlib import Path
from threading import Lock
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.detection import (
    AnyDetector,
    Contexts,
    MapDetector,
    Others,
    PipelineParams,
    as_detector,
    check_searchable,
    judge_pair,
    judge_together,
    resolve_parameters,
    weigh_together,
    with_store,
)
from gpgrad_core.detection.all_pairs import side_by_side
from gpgrad_core.detection.shortlist import Candidate, Candidates, Shortlist, num_wanted
from gpgrad_core.errors import InputError
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.memo import Memo, array_bytes
from gpgrad_core.run.progress import Progress, part, silent
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
from gpgrad_core.types import Array, Dataset, LoopClosure, LoopDetector, Registration, Submap

Pair: TypeAlias = tuple[int, int]
"""Numbers of two submaps (query, database), in the order in which they came."""
BYTES_IN_MEMORY = 1_000_000_000
"""Bytes of maps and keypoints of earlier submaps to keep in memory; the rest is kept on disk."""
MEMO_BYTES = 200_000_000
"""Small, because each pair is compared only once."""


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
    on all submaps at once. Points are not kept, and maps beyond 1 GB are kept in a temporary
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
        detector: LoopDetector | None = None,
        search_radius: float | None = None,
        candidates: Candidates = "automatic",
        executor: Executor | None = None,
        bytes_in_memory: int = BYTES_IN_MEMORY,
        store: Store | None = None,
        incremental: bool = False,
    ) -> None:
        """Begin with no submap.

        Args:
            params: Parameters of all stages of the detection. What is automatic is fitted to the
                first submap (`resolve_parameters`).
            graph: How certain odometry and closures are.
            solver: When a closure counts as wrong.
            detector: Another way to register pairs; None uses the pipeline.
            search_radius: Compare only submaps whose centres lie within this distance of each
                other in the current estimate [m]; None compares all.
            candidates: With how many of these a submap is compared; see `detect_loop_closures`.
            executor: Threads or processes that share the comparisons; processes read what they
                compare from a detector's store.
            bytes_in_memory: Bytes of maps and keypoints to keep in memory.
            store: Keeps the fit, maps, keypoints and registrations for later runs.
            incremental: Whether each solution starts from the last one, as long as new closures
                agree with it: quick, and nearly what the whole gives. `settle` solves the whole.

        Raises:
            InputError: If the number of candidates is none that is allowed, or if the detector
                has no keypoints to choose them by.
        """
        check_searchable(candidates, detector)
        self._params = params or PipelineParams()
        self._graph, self._solver = graph or GraphParams(), solver
        self._detector = None if detector is None else as_detector(detector)
        self._radius, self._executor, self._store = search_radius, executor, store
        self._candidates: Candidates = candidates
        self._shortlist = Shortlist(self._params.registration.seed)
        self._extracted = _Spilled(bytes_in_memory)
        self._images = Memo(MEMO_BYTES)
        self._submaps: list[Submap] = []
        self._traverses: list[int] = []  # number of each submap's traverse
        self._poses: dict[str, Pose] = {}
        self._registrations: dict[Pair, Registration] = {}
        self._acceptable: dict[Pair, float] = {}  # of these, but for their scores, which they have
        self._others, self._weighing = Others(), Lock()
        self._weighed: tuple[int, Contexts] = 0, Contexts({})  # of how many submaps
        self._passed: tuple[int, Mapping[Pair, float]] = 0, {}  # of how many submaps
        self._judged: tuple[int, tuple[LoopClosure, ...]] = 0, ()  # of how many submaps
        self._built: tuple[int, PoseGraph] | None = None
        self._posed: Problem | None = None
        self._solved: tuple[int, OptimisedGraph] | None = None
        self._incremental, self._is_whole = incremental, True
        self._settled: tuple[int, OptimisedGraph] | None = None

    def __enter__(self) -> "LoopCloser":
        """Begin a ``with`` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close at the end of the block."""
        self.close()

    def close(self) -> None:
        """Remove the temporary folder; no more submaps can be added."""
        self._extracted.close()

    def compare_alone(self) -> None:
        """Compare in the calling thread from now on, as when the executor has lost a process."""
        self._executor = None

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """The verdicts on all pairs compared so far, sorted by query and then by database.

        A later submap may change an earlier verdict, because pairs speak for and against others.
        """
        if self._judged[0] != len(self._submaps):
            self._judged = len(self._submaps), tuple(self._judge())
        return self._judged[1]

    @property
    def graph(self) -> PoseGraph:
        """The odometry and the accepted closures so far; joined traverses share one frame."""
        if self._built is None or self._built[0] != len(self._submaps):
            self._built = len(self._submaps), self._build()
        return self._built[1]

    @property
    def accepted_pairs(self) -> frozenset[tuple[str, str]]:
        """Ids (query, database) of all accepted pairs so far; quicker than `closures`."""
        names = [submap.id for submap in self._submaps]
        return frozenset((names[query], names[database]) for query, database in self._accepted())

    def closures_of(self, pairs: Iterable[tuple[str, str]]) -> tuple[LoopClosure, ...]:
        """Give the verdicts on some pairs that were compared, by ids (query, database)."""
        index = {submap.id: k for k, submap in enumerate(self._submaps)}
        return tuple(self._judge((index[query], index[database]) for query, database in pairs))

    def _accepted(self) -> Mapping[Pair, float]:
        """Find the scores of the pairs that are accepted now.

        Of what a verdict goes by, only the scores change when submaps are added.
        """
        if self._passed[0] != len(self._submaps):
            scores, least = self._contexts().scores, self._params.closure.min_score
            passed = {
                pair: score
                for pair, alone in self._acceptable.items()
                if (score := scores.get(pair, alone)) >= least
            }
            self._passed = len(self._submaps), passed
        return self._passed[1]

    def _build(self) -> PoseGraph:
        """Build the graph as `build_pose_graph` does; edges of the last one are not made again."""
        poses = odometry_poses(Dataset("the traverse", tuple(self._submaps)))
        centres = {submap.id: submap.centre for submap in self._submaps}
        known = () if self._built is None else self._built[1].edges
        made = {(edge.end, edge.start, edge.kind): edge for edge in known}
        edges = [
            made.get((end.id, start.id, "odometry")) or odometry_edge(start, end, self._graph)
            for (start, end), (before, number) in zip(
                pairwise(self._submaps), pairwise(self._traverses), strict=True
            )
            if number == before
        ]
        names = tuple(poses)
        for (query, database), score in self._accepted().items():
            edge = made.get((names[query], names[database], "loop"))
            if edge is None:
                registration = replace(self._registrations[query, database], score=score)
                closure = LoopClosure(names[query], names[database], registration, True, "")
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
                corrected when `result` is asked for.

        Raises:
            InputError: If the submap has no odometry pose, its id is not new, or its map cannot be
                made.
            OSError: If a process of the executor has died. The submap is not added then.
        """
        if submap.pose_odometry is None:
            raise InputError(f"submap {submap.id} has no odometry pose, which a pose graph needs")
        if submap.id in self._poses:
            raise InputError(f"submap {submap.id} was already added; ids must differ")
        detector = self._detector_for(submap)
        number = self._traverses[-1] + starts_traverse if self._traverses else 0
        predicted = self._predicted(submap.pose_odometry, starts_traverse=starts_traverse)
        made = side_by_side(detector.infer, [submap], None, part(progress, 0.0, 0.4))[0]
        extracted = side_by_side(detector.extract, [made], None, part(progress, 0.4, 0.5))[0]
        earlier = [
            other.id
            for other, traverse in zip(self._submaps, self._traverses, strict=True)
            if traverse != number
            or self._near(
                shifted(predicted, submap.centre), shifted(self._poses[other.id], other.centre)
            )
        ]
        shortlist = None
        if detector.has_keypoints:
            wanted = num_wanted(self._candidates, len(earlier))
            if wanted < len(earlier):
                keypoints = detector.keypoints(extracted)
                shortlist = self._shortlist.candidates(
                    keypoints, wanted, earlier, promising=self._candidates == "automatic"
                )
                chosen = {candidate.id for candidate in shortlist}
                earlier = [name for name in earlier if name in chosen]
        registrations = side_by_side(
            _Comparison(extracted, detector.compare),
            [_Earlier(self._extracted, name) for name in earlier],
            self._executor,
            part(progress, 0.5, 1.0),
        )
        index = {other.id: k for k, other in enumerate(self._submaps)}
        compared = {
            (len(self._submaps), index[name]): registration
            for name, registration in zip(earlier, registrations, strict=True)
        }
        acceptable = {
            (query, database): registration.score
            for (query, database), registration in compared.items()
            if judge_pair(
                submap,
                self._submaps[database],
                replace(registration, score=inf),
                self._params,
                self._images,
            ).accepted
        }
        self._registrations.update(compared)
        self._acceptable |= acceptable
        self._extracted.put(submap.id, extracted)
        if detector.has_keypoints and self._candidates != "all":
            self._shortlist.add(submap.id, detector.keypoints(extracted))
        self._submaps.append(replace(submap, points=np.empty((0, 3)), colors=None, noise_std=None))
        self._traverses.append(number)
        self._poses[submap.id] = predicted
        closures = tuple(self._judge(compared))  # all others are judged if they are asked for
        if solve and any(closure.accepted for closure in closures):
            self._poses = dict(self.result.poses)
        return Step(closures, dict(self._poses), shortlist)

    def _judge(self, asked: Iterable[Pair] | None = None) -> Iterator[LoopClosure]:
        together = self._submaps, self._registrations, self._params
        return judge_together(*together, self._images, asked, self._contexts())

    def _contexts(self) -> Contexts:
        """Give what others say of each pair; it is weighed once for each number of submaps."""
        with self._weighing:  # any thread may ask first
            if self._weighed[0] != len(self._submaps):
                together = self._submaps, self._registrations, self._params
                self._weighed = len(self._submaps), weigh_together(*together, self._others)
            return self._weighed[1]

    def _detector_for(self, submap: Submap) -> AnyDetector:
        """Return the detector; the first submap determines its automatic parameters."""
        if self._detector is None:
            memo = Memo(MEMO_BYTES, self._store)
            self._params = resolve_parameters([submap], self._params, memo)
            self._detector = with_store(MapDetector(self._params, memo), self._store)
        return self._detector

    def _predicted(self, odometry: Pose, *, starts_traverse: bool) -> Pose:
        """Predict the next pose by odometry from the last submap's."""
        if not self._submaps or starts_traverse:
            return odometry
        last = self._submaps[-1]
        assert last.pose_odometry is not None
        return self._poses[last.id] @ last.pose_odometry.inverse() @ odometry

    def _near(self, first: Pose, second: Pose) -> bool:
        if self._radius is None:
            return True
        distance = np.linalg.norm(first.translation[:2] - second.translation[:2])
        return bool(distance <= self._radius)


class _Spilled:
    """What was extracted of each submap: the most recently used in memory, the others on disk."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes, self._bytes = max_bytes, 0
        self._held: OrderedDict[str, tuple[object, int]] = OrderedDict()
        self._names: dict[str, int] = {}
        self._folder: TemporaryFolder | None = None
        self._lock = Lock()

    def put(self, name: str, extracted: object) -> None:
        with self._lock:
            self._names[name] = len(self._names)
            self._hold(name, extracted)

    def get(self, name: str) -> object:
        with self._lock:
            held = self._held.get(name)
            if held is not None:
                self._held.move_to_end(name)
                return held[0]
            extracted = pickle.loads(self._file(name).read_bytes())
            self._hold(name, extracted)
            return extracted

    def close(self) -> None:
        with self._lock:
            self._held.clear()
            if self._folder is not None:
                self._folder.cleanup()

    def _hold(self, name: str, extracted: object) -> None:
        size = array_bytes(extracted)
        self._held[name] = extracted, size
        self._bytes += size
        while self._bytes > self._max_bytes and len(self._held) > 1:
            oldest, (evicted, freed) = self._held.popitem(last=False)
            self._bytes -= freed
            file = self._file(oldest)
            if not file.exists():
                file.write_bytes(pickle.dumps(evicted, protocol=pickle.HIGHEST_PROTOCOL))

    def _file(self, name: str) -> Path:
        if self._folder is None:
            self._folder = TemporaryFolder("gpgrad-submaps-")
        return Path(self._folder.name) / f"{self._names[name]}.pickle"


@dataclass(frozen=True, eq=False)
class _Earlier:
    """What was extracted of an earlier submap: read when its turn comes, or when it is sent."""

    spilled: _Spilled
    name: str

    def __call__(self) -> object:
        return self.spilled.get(self.name)

    def __reduce__(self) -> tuple[type[partial[object]], tuple[Callable[[object], object], object]]:
        """Become the thing itself in another process."""
        return partial, (_itself, self())


def _itself(thing: object) -> object:
    return thing


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Compares the new submap with an earlier one."""

    new: object
    compare: Callable[[object, object], Registration]

    def __call__(self, job: Callable[[], object], progress: Progress) -> Registration:
        registration = self.compare(self.new, job())
        progress(1.0)
        return registration
