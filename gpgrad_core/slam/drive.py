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
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.slam.graph import GraphParams
from gpgrad_core.slam.loop_closer import LoopCloser, Moment, TableOptions
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    SolverParams,
    check_solver,
    pose_rows,
    shifted_rows,
)
from gpgrad_core.slam.run_file import Run, RunSettings, RunWriter
from gpgrad_core.types import Array, LoopClosure, PairOfIds, Submap

Listener: TypeAlias = Callable[[Moment], None]
"""Called with each new moment, from the thread that adds the submap; it must be quick."""
MEASURED_AT_ONCE = 10
"""Number of covariances that an incremental drive measures anew with each submap: each takes longer
the longer the drive is."""
SOLVED = 0.1
"""Share of the progress that judging and solving take."""


class Drive(LoopCloser):
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
        """Begin with no submap; see `LoopCloser` for what is not named here.

        Args:
            incremental: The covariances are then measured in turn, some with each submap, and all
                of them when new closures have all weighed anew.
            record: Keeps each submap before it is compared, and each moment before any listener
                hears of it. Make it with `settings`.
            name: The name that people see.

        Raises:
            InputError: As `LoopCloser`, or if GTSAM is not installed.
        """
        check_solver()
        super().__init__(
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
            self._graph,
            self._solver,
            table.get("candidates", "automatic"),
            search_radius,
            incremental,
        )
        self._record = record
        self._lock = Lock()
        self._whole_submaps: tuple[Submap, ...] = ()
        self._moments: tuple[Moment, ...] = ()
        self._final: Moment | None = None  # what takes the place of the last one
        self._accepted: frozenset[PairOfIds] = frozenset()
        self._measured = 0  # up to which submap, in turn
        self._listeners: list[tuple[Listener, Callable[[], None]]] = []
        self._finished = False

    def __enter__(self) -> "Drive":
        return self

    @property
    def submaps(self) -> tuple[Submap, ...]:
        """The submaps so far, unchanged."""
        return self._whole_submaps

    @property
    def moments(self) -> tuple[Moment, ...]:
        """The moments so far, one for each submap."""
        return self.run.moments

    @property
    def is_settled(self) -> bool:
        """Whether the last moment has what all submaps so far give at once."""
        return not self._moments or self.is_whole

    @property
    def finished(self) -> bool:
        """Whether no more submaps will come."""
        return self._finished

    @property
    def run(self) -> Run:
        """All that its record has so far."""
        with self._lock:
            submaps, moments, latest = self._whole_submaps, self._moments, self._final
        if latest is not None:
            moments = (*moments[:-1], latest)
        starts = frozenset(moment.submap_id for moment in moments if moment.starts_traverse)
        return Run(self.settings, submaps, starts, moments, settled=latest is not None)

    def listen(
        self, listener: Listener, ended: Callable[[], None] = lambda: None
    ) -> Callable[[], None]:
        """Call a listener with each moment from now on, and `ended` once no more will come.

        Returns:
            What ends that.
        """
        both = listener, ended
        with self._lock:
            self._listeners.append(both)

        def stop() -> None:
            with self._lock:
                if both in self._listeners:
                    self._listeners.remove(both)

        return stop

    def finish(self) -> None:
        """Settle, and end the drive; all listeners are called before this returns."""
        self.settle()
        with self._lock:
            listeners = () if self._finished else tuple(self._listeners)
            self._finished = True
        self.close()
        for _, ended in listeners:
            ended()

    def add(
        self, submap: Submap, progress: Progress = silent, *, starts_traverse: bool = False
    ) -> Moment:
        """Add a submap as `LoopCloser.add` does; all listeners are called before it returns."""
        if self._record is not None:
            self._record.keep(submap, starts_traverse=starts_traverse)
        step = super().add(
            submap, part(progress, 0.0, 1.0 - SOLVED), starts_traverse=starts_traverse
        )
        assert submap.pose_odometry is not None
        result = self.result
        places = pose_rows(result.poses)
        moment = Moment(
            step.closures,
            step.shortlist,
            tuple(result.poses),
            places,
            odometry=submap.pose_odometry,
            starts_traverse=starts_traverse,
            flipped=self._flipped(step.closures),
            rejected=_rejected(result),
            covariances=self._covariances(result),
            moved=self._moved(self._moments, places),
        )
        if self._record is not None:
            self._record.add(moment)
        with self._lock:
            self._whole_submaps += (submap,)
            self._moments += (moment,)
            self._final = None
        self._tell(moment)
        progress(1.0)
        return moment

    def settle(self, progress: Progress = silent) -> Moment | None:
        """Solve the poses of the last moment by all submaps so far at once, and notify listeners.

        The moments that come later are the same as if it had not been settled; see
        `LoopCloser.settle`.
        """
        step = super().settle(progress)
        if step is None:
            return None
        moment = replace(
            self._moments[-1],
            places=step.places,
            rejected=_rejected(self.result),
            covariances=self.measure_covariances(),
            moved=self._moved(self._moments[:-1], step.places),
        )
        if self._record is not None:
            self._record.settle(moment)
        with self._lock:
            self._final = moment
        self._tell(moment)
        return moment

    def _tell(self, moment: Moment) -> None:
        with self._lock:
            listeners = tuple(self._listeners)
        for listener, _ in listeners:
            listener(moment)

    def _covariances(self, result: OptimisedGraph) -> Float[Array, "n 3 3"]:
        """Measure the covariances: all, or in turn."""
        if self.is_whole:
            return self.measure_covariances()
        names, last = list(result.poses), len(result.poses) - 1
        turn = range(self._measured, self._measured + min(MEASURED_AT_ONCE, last))
        self._measured = turn.stop % last
        some = [*(k % last for k in turn), last]
        covariances = np.concatenate([self._moments[-1].covariances, np.empty((1, 3, 3))])
        covariances[some] = self.measure_covariances([names[k] for k in some])
        return covariances

    def _flipped(self, new: Iterable[LoopClosure]) -> tuple[LoopClosure, ...]:
        """Find the earlier verdicts that are others now, and remember those of now."""
        before, self._accepted = self._accepted, self.accepted_pairs
        others = (before ^ self._accepted) - {closure.pair for closure in new}
        order = {submap.id: k for k, submap in enumerate(self._submaps)}
        pairs = sorted(others, key=lambda pair: (order[pair[0]], order[pair[1]]))
        return tuple(self._pairs.judge(pairs=pairs))

    def _moved(self, earlier: Sequence[Moment], places: Float[Array, "n 7"]) -> float:
        """Measure how far [m] new places move any submap's centre from where it was before."""
        if not earlier:
            return 0.0
        before = earlier[-1].places
        centres = np.array([submap.centre for submap in self._submaps[: len(before)]])
        was, now = (shifted_rows(rows, centres) for rows in (before, places[: len(before)]))
        return float(np.linalg.norm((now - was)[:, :3], axis=1).max(initial=0.0))


def _rejected(result: OptimisedGraph) -> tuple[PairOfIds, ...]:
    return tuple(fit.edge.pair for fit in result.refused)


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
        run = drive.run
        for submap, moment in zip(run.submaps, run.moments, strict=True):
            writer.keep(submap, starts_traverse=moment.starts_traverse)
            writer.add(moment)
        if run.settled:
            writer.settle(run.moments[-1])
