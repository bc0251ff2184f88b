"""Submaps from a folder into which somebody writes: a dataset that is not finished yet."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from gpgrad_core.errors import InputError, readable
from gpgrad_core.io.clouds import is_cloud, load_cloud_with_notes
from gpgrad_core.io.folder import CLOUD_FOLDER, ODOMETRY_FILES, index_of
from gpgrad_core.io.poses import read_poses
from gpgrad_core.live.source import Arrival, News, Silent, Trouble
from gpgrad_core.reading.names import with_distinct_numbers
from gpgrad_core.se2 import Pose

LOOK = 0.5
"""The folder is looked at so often [s]. A file that did not change between two looks is whole."""
PATIENCE = 5.0
"""A file that cannot be read, or has no pose, is spoken of after so long [s]."""
ANY_NUMBER = range(10**18)
"""The poses of submaps that are still to come are not wrong."""

Mark: TypeAlias = tuple[int, int]
"""Size [bytes] and time of the last change [ns] of a file."""


class SubmapFolder(Silent):
    """Watches a folder of clouds with a file of poses, in the form of a dataset.

    A cloud comes once its file is whole and has a pose, and again if its file changes.
    """

    def __init__(self, path: Path, look: float = LOOK, patience: float = PATIENCE) -> None:
        """Watch a folder; times are those of `LOOK` and `PATIENCE` [s]."""
        self._path, self._look, self._patience = path, look, patience
        self.name = str(path)
        self._kept: Callable[[], tuple[str, ...]] = tuple
        self._seen: dict[Path, tuple[Mark, float]] = {}  # mark, and since when it is that
        self._taken: dict[Path, Mark] = {}
        self._said: dict[Path, str] = {}
        self._poses: dict[int, Pose] = {}
        self._poses_mark: Mark | None = None

    def keep(self, names: Callable[[], tuple[str, ...]]) -> None:
        """Set what gives the stored ids: of these, only the first submap is read again."""
        self._kept = names

    def news(self, stopped: threading.Event) -> Iterator[News]:
        """Look at the folder until it is stopped."""
        self._skip_kept()
        while not stopped.is_set():
            yield from self._look_once(stopped)
            stopped.wait(self._look)

    def _skip_kept(self) -> None:
        kept = frozenset(self._kept())
        clouds = [cloud for name, cloud in self._clouds() if name in kept]
        for cloud in clouds[1:]:
            mark = _mark(cloud)
            if mark is not None:
                self._taken[cloud] = mark

    def _look_once(self, stopped: threading.Event) -> Iterator[News]:
        now = time.monotonic()
        yield from self._read_poses(now)
        for name, cloud in self._clouds():
            if stopped.is_set():
                return
            mark = self._whole(cloud, now)
            if mark is None or self._taken.get(cloud) == mark:
                continue
            index = index_of(name)
            pose = None if index is None else self._poses.get(index)
            if pose is None:
                words = (
                    f"submap {name} waits for its pose in {ODOMETRY_FILES[0]}"
                    if index is not None
                    else f"{cloud}: has no number in its name, by which a pose could name it"
                )
                yield from self._say(cloud, words, now)
                continue
            try:
                submap, notes = load_cloud_with_notes(cloud)
            except InputError as error:
                yield from self._say(cloud, str(error), now)
                continue
            self._taken[cloud] = mark
            self._said.pop(cloud, None)
            for note in notes:
                yield Trouble(note)
            yield Arrival(replace(submap, id=name, pose_odometry=pose))

    def _clouds(self) -> list[tuple[str, Path]]:
        """List the clouds by the ids of their submaps, in order."""
        folder = self._path / CLOUD_FOLDER
        folder = folder if folder.is_dir() else self._path
        with readable(folder):
            entries = list(folder.iterdir())
        clouds = [e for e in entries if is_cloud(e) and not e.name.startswith(".") and e.is_file()]
        ids = with_distinct_numbers([cloud.stem for cloud in clouds])
        return sorted(
            zip(ids, clouds, strict=True), key=lambda pair: (index_of(pair[0]) or 0, pair)
        )

    def _read_poses(self, now: float) -> Iterator[News]:
        path = next((p for n in ODOMETRY_FILES if (p := self._path / n).exists()), None)
        mark = None if path is None else self._whole(path, now)
        if path is None or mark is None or mark == self._poses_mark:
            return
        try:
            self._poses = read_poses(path, ANY_NUMBER)
            self._poses_mark = mark
            self._said.pop(path, None)
        except InputError as error:  # perhaps half a line
            yield from self._say(path, str(error), now)
        except OSError:
            return  # it was just replaced

    def _whole(self, path: Path, now: float) -> Mark | None:
        """Give the mark of a file that did not change since the last look."""
        mark = _mark(path)
        if mark is None:
            return None
        before = self._seen.get(path)
        if before is None or before[0] != mark:
            self._seen[path] = mark, now
            return None
        return mark if mark[0] else None

    def _say(self, path: Path, words: str, now: float) -> Iterator[News]:
        """Say what is wrong with a file, once, if it is still so after a while."""
        if now - self._seen[path][1] >= self._patience and self._said.get(path) != words:
            self._said[path] = words
            yield Trouble(words)


def _mark(path: Path) -> Mark | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns
