"""A drive: submaps as they come, and what each of them decided, from the first to the last."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import TypeAlias

import numpy as np
from jaxtyping import Float
from typing_extensions import Unpack

from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.records.files import replacing
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.slam.graph import GraphParams, PoseGraph
from gpgrad_core.slam.loop_closer import LoopCloser, TableOptions
from gpgrad_core.slam.moment import Moment, PairOfIds
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    SolverParams,
    check_solver,
    shifted_rows,
)
from gpgrad_core.slam.run_file import Run, RunSettings, RunWriter
from gpgrad_core.types import Array, LoopClosure, Submap

Listener: TypeAlias = Callable[[Moment], None]
"""Called with each new moment, from the thread that adds the submap; it must be quick."""
MEASURED_AT_ONCE = 10
"""Number of covariances that an incremental drive measures anew with each submap: each takes longer
the longer the drive is."""
SOLVED = 0.1
"""Share of the progress that judging and solving take."""


class Drive:
    """Submaps in the order in which they come, each with its `Moment`.

    Attributes:
        settings: What the drive was made with.

    After every submap the moment's poses are those that `gpgrad slam` gives of all submaps so far,
    bit for bit, if it runs with the same parameters; of an incremental drive, after `settle`.
    Parameters that are automatic are fitted to
    the first submap; give settled ones (`resolve_parameters`) to have the same as a whole dataset.

    One thread adds submaps; any thread may read. The submaps are stored unchanged, so their
    points take no memory if they are mapped from a file.

    >>> from gpgrad_core import demo_path, load_dataset
    >>> with Drive() as drive:
    ...     for submap in load_dataset(demo_path()).submaps[:2]:
    ...         moment = drive.add(submap)
    >>> moment.number, moment.ids, len(moment.closures)
    (1, ('000', '001'), 1)
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
        record: RunWriter | None = None,
        name: str = "drive",
        **table: Unpack[TableOptions],
    ) -> None:
        """Begin with no submap.

        Args:
            params: Parameters of all stages of the detection.
            graph: How certain odometry and closures are.
            solver: When a closure counts as wrong.
            search_radius: See `LoopCloser`.
            executor: Threads or processes that share the comparisons; see `LoopCloser`.
            incremental: See `LoopCloser`. The covariances are then measured in turn, some with each
                submap, and all of them when new closures have all weighed anew.
            record: Keeps each submap before it is compared, and each moment before any listener
                hears of it. Make it with `settings`.
            name: The name that people see.
            table: What else `Pairs` takes; see `LoopCloser`.

        Raises:
            InputError: As `LoopCloser`, or if GTSAM is not installed.
        """
        check_solver()
        self._closer = LoopCloser(
            params,
            graph,
            solver,
            search_radius=search_radius,
            executor=executor,
            incremental=incremental,
            **table,
        )
        self.settings = RunSettings(
            name,
            params or PipelineParams(),
            graph or GraphParams(),
            solver or SolverParams(),
            table.get("candidates", "automatic"),
            search_radius,
            incremental,
        )
        self._record = record
        self._lock = Lock()
        self._submaps: tuple[Submap, ...] = ()
        self._moments: tuple[Moment, ...] = ()
        self._settled: Moment | None = None  # what takes the place of the last one
        self._accepted: frozenset[PairOfIds] = frozenset()
        self._measured = 0  # up to which submap, in turn
        self._listeners: list[tuple[Listener, Callable[[], None]]] = []
        self._finished = False

    def __enter__(self) -> "Drive":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove temporary files; no more submaps can be added, and all else stays."""
        self._closer.close()

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """The submaps so far, unchanged."""
        return self._submaps

    @property
    def moments(self) -> tuple[Moment, ...]:
        """The moments so far, one for each submap."""
        with self._lock:
            last = () if self._settled is None else (self._settled,)
            return (*self._moments[: len(self._moments) - len(last)], *last)

    @property
    def closures(self) -> tuple[LoopClosure, ...]:
        """The verdicts on all pairs compared so far, as they are now."""
        return self._closer.closures

    @property
    def graph(self) -> PoseGraph:
        """The pose graph of all submaps so far."""
        return self._closer.graph

    @property
    def result(self) -> OptimisedGraph:
        """The solved graph of all submaps so far."""
        return self._closer.result

    @property
    def is_settled(self) -> bool:
        """Whether the last moment has what all submaps so far give at once."""
        return not self._moments or self._closer.is_whole

    @property
    def finished(self) -> bool:
        """Whether no more submaps will come."""
        return self._finished

    @property
    def run(self) -> Run:
        """All that its record has so far."""
        with self._lock:
            submaps = self._submaps
        moments = self.moments[: len(submaps)]
        starts = frozenset(moment.submap_id for moment in moments if moment.starts_traverse)
        return Run(self.settings, submaps, starts, moments)

    def write(self, record: RunWriter) -> None:
        """Write all that its record has so far into another one."""
        with self._lock:
            submaps, moments, settled = self._submaps, self._moments, self._settled
        for submap, moment in zip(submaps, moments, strict=True):
            record.keep(submap, starts_traverse=moment.starts_traverse)
            record.add(moment)
        if settled is not None:
            record.settle(settled)

    def listen(
        self, listener: Listener, ended: Callable[[], None] = lambda: None
    ) -> Callable[[], None]:
        """Call a listener with each moment from now on; what is returned ends that.

        Args:
            listener: Called with each moment.
            ended: Called once no more will come.
        """
        heard = listener, ended
        with self._lock:
            self._listeners.append(heard)

        def stop() -> None:
            with self._lock:
                if heard in self._listeners:
                    self._listeners.remove(heard)

        return stop

    def finish(self) -> None:
        """Settle, and end the drive; all listeners are called before this returns."""
        self.settle()
        with self._lock:
            told = () if self._finished else tuple(self._listeners)
            self._finished = True
        self.close()
        for _, ended in told:
            ended()

    def compare_alone(self) -> None:
        """Do without the executor from now on; see `LoopCloser.compare_alone`."""
        self._closer.compare_alone()

    def add(
        self, submap: Submap, progress: Progress = silent, *, starts_traverse: bool = False
    ) -> Moment:
        """Take the next submap, and decide what it closes; all listeners are called before it ends.

        Args:
            submap: The submap, with an odometry pose.
            progress: Called with the fraction done; if it raises Cancelled, the submap is not
                added.
            starts_traverse: Whether another traverse begins, to which no odometry leads.

        Raises:
            InputError: If the submap has no odometry pose, its id is not new, or its map cannot be
                made. It is not added then.
            OSError: If a process of the executor has died. It is not added then either.
        """
        if self._record is not None:
            self._record.keep(submap, starts_traverse=starts_traverse)
        step = self._closer.add(
            submap, part(progress, 0.0, 1.0 - SOLVED), starts_traverse=starts_traverse
        )
        result, before = self._closer.result, self._moments
        assert submap.pose_odometry is not None
        places = _places(result)
        moment = Moment(
            submap_id=submap.id,
            odometry=submap.pose_odometry,
            starts_traverse=starts_traverse,
            closures=step.closures,
            shortlist=step.shortlist,
            turned=self._turned(step.closures),
            left_out=_left_out(result),
            ids=tuple(result.poses),
            places=places,
            covariances=self._covariances(result),
            moved=_moved(before, places, [*self._submaps, submap]),
        )
        if self._record is not None:
            self._record.add(moment)
        with self._lock:
            self._submaps += (submap,)
            self._moments += (moment,)
            self._settled = None
        self._tell(moment)
        progress(1.0)
        return moment

    def settle(self, progress: Progress = silent) -> Moment | None:
        """Give the last moment the poses that all submaps so far give at once, and tell of it.

        Only an incremental drive may have others. The moments that come later are the same as if
        it had not been settled.

        Args:
            progress: Called with the fraction done; if it raises Cancelled, nothing is settled.

        Returns:
            The moment that takes the place of the last one; None if that is settled already.
        """
        if self.is_settled:
            return None
        self._closer.settle(progress)
        result, last = self._closer.result, self._moments[-1]
        places = _places(result)
        moment = replace(
            last,
            left_out=_left_out(result),
            places=places,
            covariances=self._closer.measure_covariances(),
            moved=_moved(self._moments[:-1], places, self._submaps),
        )
        if self._record is not None:
            self._record.settle(moment)
        with self._lock:
            self._settled = moment
        self._tell(moment)
        return moment

    def _tell(self, moment: Moment) -> None:
        with self._lock:
            listeners = tuple(self._listeners)
        for listener, _ in listeners:
            listener(moment)

    def _covariances(self, result: OptimisedGraph) -> Float[Array, "n 3 3"]:
        """Measure the covariances: all, or in turn."""
        if self._closer.is_whole:
            return self._closer.measure_covariances()
        names, last = list(result.poses), len(result.poses) - 1
        turn = range(self._measured, self._measured + min(MEASURED_AT_ONCE, last))
        self._measured = turn.stop % last
        some = [*(k % last for k in turn), last]
        covariances = np.concatenate([self._moments[-1].covariances, np.empty((1, 3, 3))])
        covariances[some] = self._closer.measure_covariances([names[k] for k in some])
        return covariances

    def _turned(self, new: Iterable[LoopClosure]) -> tuple[LoopClosure, ...]:
        """Find the earlier verdicts that are others now, and remember those of now."""
        before, self._accepted = self._accepted, self._closer.accepted_pairs
        others = (before ^ self._accepted) - {closure.pair for closure in new}
        order = {submap.id: k for k, submap in enumerate(self._submaps)}
        return self._closer.closures_of(
            sorted(others, key=lambda pair: (order[pair[0]], order[pair[1]]))
        )


def _places(result: OptimisedGraph) -> Float[Array, "n 7"]:
    rows = [[*pose.translation, *pose.quaternion] for pose in result.poses.values()]
    return np.array(rows).reshape(-1, 7)


def _left_out(result: OptimisedGraph) -> tuple[PairOfIds, ...]:
    return tuple(fit.edge.pair for fit in result.refused)


def _moved(
    earlier: Sequence[Moment], places: Float[Array, "n 7"], submaps: Sequence[Submap]
) -> float:
    """Measure how far [m] new places move any submap's centre from where it was before."""
    if not earlier:
        return 0.0
    before = earlier[-1].places
    centres = np.array([submap.centre for submap in submaps[: len(before)]])
    was, now = (shifted_rows(rows, centres) for rows in (before, places[: len(before)]))
    return float(np.linalg.norm((now - was)[:, :3], axis=1).max(initial=0.0))


def write_run(path: Path | str, drive: Drive) -> None:
    """Write the record of a drive as it is now, completely or not at all.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If the disk is full.
    """
    with (
        replacing(path) as unfinished,
        RunWriter(unfinished, drive.settings, is_locked=True) as writer,
    ):
        drive.write(writer)
