"""A drive to look at while it goes on: its submaps come from outside, or a rover is simulated."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec

from app.viewer.session.session_file import Opened
from gpgrad_core.detection import (
    MapDetector,
    PipelineParams,
    resolve_parameters,
    store_for_run,
    with_store,
)
from gpgrad_core.errors import InputError
from gpgrad_core.live.follower import Counts, Follower, Say
from gpgrad_core.live.frames import Corrected
from gpgrad_core.live.keeping import Keeper
from gpgrad_core.live.source import Source
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.demo import loop_params
from gpgrad_core.simulation.simulate import describe_simulated, drive_over, make_world
from gpgrad_core.slam import Drive, Moment, RunSettings
from gpgrad_core.types import Dataset, Submap

CANDIDATES = 10
"""A submap is compared with so many earlier ones: to compare it with all takes longer each time."""
MEMORY = 1_500_000_000
"""Budget of a viewer that follows, by default [bytes]: it is reached within the first
fifty submaps, and holds for as long as the robot drives."""
STORED = 5_000
"""A store has room for so many submaps; of a longer drive, the oldest maps are inferred anew."""
BYTES_IN_MEMORY = 100_000_000
"""Bytes of maps of earlier submaps to keep in memory; the rest waits in a temporary folder."""


class Following:
    """Follows a source for as long as the viewer serves."""

    def __init__(
        self,
        source: Source,
        asked: PipelineParams,
        say: Say,
        *,
        record: Path | None = None,
        track: Path | None = None,
        store: Store | None = None,
    ) -> None:
        """Be ready to begin.

        What is automatic is fitted to the first submap. If the record exists, the drive goes on
        with it and its parameters. The track is written anew after each submap.
        """
        self.drive: Drive | None = None
        self._requested, self._say, self._source = asked, say, source
        self._ends = contextlib.ExitStack()
        self._memo: Memo | None = None
        self._name = record.stem if record is not None else Path(source.name).name
        self._store = store
        self._ends.callback(source.close)
        try:
            self._keeper = self._ends.enter_context(
                contextlib.closing(Keeper(record, self._settings))
            )
            self._follower = Follower(
                source,
                self._keeper,
                self._compare,
                say,
                track=track,
                ended=self._end,
                settle=self._settle,
            )
        except BaseException:
            self._ends.close()
            raise
        for note in self._keeper.notes:
            say(note)
        if (earlier := len(self._keeper.names)) and record is not None:
            say(f"{record}: goes on with its {earlier:,} submaps and its parameters")

    @property
    def counts(self) -> Counts:
        return self._follower.counts

    @property
    def failure(self) -> BaseException | None:
        return self._follower.failure

    def open(self, memo: Memo, stage: Callable[[str], Progress]) -> Opened:
        """Begin, and wait for the first submap; the drive reports those that come later."""
        self._memo = memo
        told = stage(f"Waiting for the first submap of {self._source.name}")
        self._ends.callback(self._follower.close)
        self._follower.start()
        while not self._follower.wait(lambda counts: counts.compared > 0, 0.2):
            told(0.0)
            if self.failure is not None:
                raise self.failure
            if self._follower.ended:
                raise InputError(f"{self._source.name}: has ended without a submap")
        drive, settings = self.drive, self._keeper.settings
        assert drive is not None
        assert settings is not None
        dataset = Dataset(settings.name, drive.submaps)
        return Opened(dataset, self._requested, "", None, settings.params, drive)

    def close(self) -> None:
        """Stop: what has come is in the record, and the next run goes on with it."""
        self._ends.close()
        if self.drive is not None:
            self.drive.close()

    def _settings(self, first: Submap) -> RunSettings:
        used = resolve_parameters([first], self._requested, self._memo or Memo(0))
        return RunSettings(self._name, used, candidates=CANDIDATES, incremental=True)

    def _compare(self, submap: Submap, progress: Progress) -> Corrected:
        if self.drive is None:
            self.drive = self._begun()
        add = partial(
            self.drive.add, submap, progress, starts_traverse=submap.id in self._keeper.starts
        )
        try:
            moment = add()
        except OSError as error:
            self._say(f"{error}; the comparisons go on in the viewer itself, which is slower")
            self.drive.compare_alone()
            moment = add()
        self._keeper.add(moment)
        return corrected(moment)

    def _settle(self, progress: Progress) -> Corrected | None:
        moment = None if self.drive is None else self.drive.settle(progress)
        if moment is None:
            return None
        self._keeper.settle(moment)
        return msgspec.structs.replace(corrected(moment), closures=[])  # reported before

    def _begun(self) -> Drive:
        settings = self._keeper.settings
        assert settings is not None
        assert self._memo is not None
        # In processes: beside the threads that draw, threads take longer than one alone would.
        store = self._ends.enter_context(store_for_run(self._store, STORED))
        executor = self._ends.enter_context(workers(num_workers(), CANDIDATES * STORED))
        return Drive(
            settings.params,
            settings.graph,
            settings.solver,
            detector=with_store(MapDetector(settings.params, self._memo), store),
            search_radius=settings.search_radius,
            candidates=settings.candidates,
            executor=executor,
            name=settings.name,
            bytes_in_memory=BYTES_IN_MEMORY,
            incremental=settings.incremental,
        )

    def _end(self) -> None:
        self._say(f"{self._source.name} has ended: {self.counts.spelled()}")
        if self.drive is not None:
            self.drive.finish()


def corrected(moment: Moment) -> Corrected:
    """Write a moment as a robot hears it: a submap and the one before it close no loop."""
    poses = {name: pose.row for name, pose in moment.poses.items()}
    return Corrected(moment.submap_id, poses, [closure.pair for closure in moment.loops])


def begin_drive(
    seed: int,
    memo: Memo,
    stage: Callable[[str], Progress],
    show: Callable[[Submap], None] = lambda _: None,
) -> Opened:
    """Begin a drive, whose submaps come from a thread of its own; shows the first."""
    told = stage("Making the ground")
    told(0.0)
    world = make_world(loop_params(seed))
    told = stage("Looking at the first of it")
    told(0.0)
    submaps = drive_over(world)
    first = next(submaps)
    show(first)
    params = PipelineParams()
    used = resolve_parameters([first], params, memo, told)
    executor = ThreadPoolExecutor(num_workers(), thread_name_prefix="drive")
    drive = Drive(
        used, detector=MapDetector(used, memo), executor=executor, name="a simulated drive"
    )
    drive.add(first)
    thread = threading.Thread(
        target=_drive_on, args=(drive, submaps, executor), name="simulated drive", daemon=True
    )
    thread.start()
    dataset = replace(describe_simulated(world.params), name=drive.settings.name, submaps=(first,))
    return Opened(dataset, params, "", None, used, drive)


def _drive_on(drive: Drive, submaps: Iterator[Submap], executor: ThreadPoolExecutor) -> None:
    with executor:
        for submap in submaps:
            drive.add(submap)
    drive.finish()
