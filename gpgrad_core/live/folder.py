"""Submaps from a folder into which somebody writes: a dataset that is not finished yet."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from gpgrad_core.errors import InputError, readable
from gpgrad_core.io.clouds import load_cloud_with_notes
from gpgrad_core.io.folder import CLOUD_FOLDER, ODOMETRY_FILES, index_of, list_clouds
from gpgrad_core.io.poses import read_poses
from gpgrad_core.live.source import LOOK, PATIENCE, Arrival, News, Source, Stamp, Trouble, mark_of
from gpgrad_core.se2 import Pose

ANY_NUMBER = range(10**18)
"""The poses of submaps that are still to come are not wrong."""


class SubmapFolder(Source):
    """Watches a folder of clouds with a file of poses, in the form of a dataset."""

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._path = path
        self._marks: dict[Path, tuple[Stamp, float]] = {}  # mark, and since when it is that
        self._taken: dict[Path, Stamp] = {}
        self._reported: dict[Path, str] = {}
        self._poses: dict[int, Pose] = {}
        self._poses_mark: Stamp | None = None

    def news(self, stopped: threading.Event) -> Iterator[News]:
        stored = frozenset(self._stored_ids())
        for cloud in [cloud for name, cloud in self._clouds() if name in stored][1:]:
            if (mark := mark_of(cloud)) is not None:
                self._taken[cloud] = mark
        while not stopped.is_set():
            yield from self._look_once(stopped)
            stopped.wait(LOOK)

    def _look_once(self, stopped: threading.Event) -> Iterator[News]:
        now = time.monotonic()
        yield from self._read_poses(now)
        for name, cloud in self._clouds():
            if stopped.is_set():
                return
            mark = self._whole(cloud, now)
            if mark is None or self._taken.get(cloud) == mark:
                continue
            try:
                pose = self._pose(name, cloud)
                submap, notes = load_cloud_with_notes(cloud)
            except InputError as error:
                yield from self._report(cloud, str(error), now)
                continue
            self._taken[cloud] = mark
            self._reported.pop(cloud, None)
            for note in notes:
                yield Trouble(note)
            yield Arrival(replace(submap, id=name, pose_odometry=pose))

    def _pose(self, name: str, cloud: Path) -> Pose:
        index = index_of(name)
        if index is None:
            raise InputError(f"{cloud}: has no number in its name, by which a pose could name it")
        if index not in self._poses:
            raise InputError(f"submap {name} waits for its pose in {ODOMETRY_FILES[0]}")
        return self._poses[index]

    def _clouds(self) -> list[tuple[str, Path]]:
        folder = self._path / CLOUD_FOLDER
        folder = folder if folder.is_dir() else self._path
        with readable(folder):
            return list_clouds(folder)

    def _read_poses(self, now: float) -> Iterator[News]:
        path = next((p for n in ODOMETRY_FILES if (p := self._path / n).exists()), None)
        mark = None if path is None else self._whole(path, now)
        if path is None or mark is None or mark == self._poses_mark:
            return
        try:
            self._poses = read_poses(path, ANY_NUMBER)
            self._poses_mark = mark
            self._reported.pop(path, None)
        except InputError as error:  # perhaps half a line
            yield from self._report(path, str(error), now)
        except OSError:
            return  # it was just replaced

    def _whole(self, path: Path, now: float) -> Stamp | None:
        """The mark of a file that did not change since the last look."""
        mark = mark_of(path)
        if mark is None:
            return None
        before = self._marks.get(path)
        if before is None or before[0] != mark:
            self._marks[path] = mark, now
            return None
        return mark if mark[0] else None

    def _report(self, path: Path, words: str, now: float) -> Iterator[News]:
        """Report what is wrong with a file, once, if it is still so after a while."""
        if now - self._marks[path][1] >= PATIENCE and self._reported.get(path) != words:
            self._reported[path] = words
            yield Trouble(words)
