"""Submaps in the record of a drive, and in memory-mapped files for readers.

The record has a submap before its sender gets the answer, and memory stays flat, however many
submaps come.
"""

import os
import threading
from collections.abc import Callable
from pathlib import Path

from gpgrad_core.errors import InputError, readable, writable
from gpgrad_core.io.folder import spooled
from gpgrad_core.run.folders import NameLock, temporary_folder, to_disk
from gpgrad_core.run.memory import Spool
from gpgrad_core.se2 import PoseRow
from gpgrad_core.slam.loop_closer import Moment
from gpgrad_core.slam.run_file import Run, RunSettings, RunWriter, is_run
from gpgrad_core.types import Submap


class Keeper:
    """Stores submaps and moments, in a record if there is one; any thread may call it."""

    def __init__(
        self,
        path: Path | None = None,
        settings: Callable[[Submap], RunSettings] = lambda _: RunSettings(),
    ) -> None:
        """Continue a record, or begin it; without a path, nothing outlives the keeper."""
        self._lock = threading.Lock()
        self._submaps: dict[str, Submap] = {}
        self._held: NameLock | None = None
        self._writer: RunWriter | None = None
        self.notes: tuple[str, ...] = ()
        self.starts: frozenset[str] = frozenset()
        self._path, self._make_settings = path, settings
        self.settings: RunSettings | None = None
        run = None if path is None else self._open(path)
        self._spool = Spool()
        for submap in () if run is None else run.submaps:
            self._submaps[submap.id] = spooled(submap, self._spool)

    def _open(self, path: Path) -> Run | None:
        with readable(path):
            if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
                raise InputError(f"{path}: cannot be written there; name another file")
            self._held = NameLock(path, is_run)  # of a new one too, so that it has one writer
            if not path.exists():
                return None
            try:
                if not is_run(path):
                    raise InputError(f"{path}: is no record of a drive; name another file")
                self._writer, run = RunWriter.resume(path, is_locked=True)
            except BaseException:
                self._held.release()
                raise
        self.settings, self.notes, self.starts = run.settings, run.notes, run.starts
        return run

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self._submaps)

    def keep(self, submap: Submap) -> bool:
        """Write a submap to the record on the disk; tells whether it is new."""
        if submap.pose_odometry is None:
            raise InputError(f"submap {submap.id} has no odometry pose, which a track needs")
        with self._lock:
            earlier = self._submaps.get(submap.id)
            if earlier is not None:
                if _content(earlier) != _content(submap):
                    raise InputError(
                        f"submap {submap.id} came before with another content; the first one "
                        "stays: give each submap an id of its own"
                    )
                return False
            settings = self.settings or self._make_settings(submap)
            with writable(temporary_folder()):
                placed = spooled(submap, self._spool)
            if self._held is not None and self._path is not None:
                with writable(self._path):
                    writer = self._writer or self._begin(self._path, self._held, settings)
                    writer.keep(submap)
            self.settings = settings
            self._submaps[submap.id] = placed
            return True

    def _begin(self, path: Path, lock: NameLock, settings: RunSettings) -> RunWriter:
        """Begin a record that appears with its settings: a killed process leaves no half of it."""
        if path.exists():
            raise InputError(f"{path}: has appeared meanwhile; move it away, or name another file")
        if not lock.is_on(lock.unfinished):  # which somebody removed
            self._held = lock = NameLock(path, is_run)
        writer = RunWriter(lock.unfinished, settings, is_locked=True)
        lock.unfinished.replace(path)
        writer.path, self._writer = path, writer
        to_disk(path.parent)
        return writer

    def submap(self, name: str) -> Submap:
        """Load a submap, with its arrays in a file; KeyError for an unknown name."""
        return self._submaps[name]

    def add(self, moment: Moment) -> None:
        """Add a moment to the record, unless it has it; OSError if the disk is full."""
        with self._lock:
            if self._writer is not None:
                self._writer.add(moment)

    def settle(self, moment: Moment) -> None:
        """Add what replaces the last moment, unless the record has it; OSError on a full disk."""
        with self._lock:
            if self._writer is not None:
                self._writer.settle(moment)

    def close(self) -> None:
        """Close the record; submaps from `submap` can still be read."""
        with self._lock:
            if self._writer is not None:
                self._writer.close()
            if self._held is not None:
                self._held.release()
            self._spool.close()


def _content(submap: Submap) -> tuple[str, PoseRow]:
    assert submap.pose_odometry is not None
    return submap.fingerprint, submap.pose_odometry.row
