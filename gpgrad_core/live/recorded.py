"""Submaps from a recording that still grows: scans with poses, or a bag."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.live.growing import GrowingMcap, is_finished, whole_until
from gpgrad_core.live.source import Arrival, News, Silent, Trouble
from gpgrad_core.recordings.bag import open_bag
from gpgrad_core.recordings.bag_reader import ENDINGS
from gpgrad_core.recordings.build import Gathered, gather, level_recording, open_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Recording, RecordingSources
from gpgrad_core.recordings.trajectory import cut
from gpgrad_core.se2 import level_pose
from gpgrad_core.types import Submap

LOOK = 0.5
"""The files are looked at so often [s]."""
SHARE = 4.0
"""After reading what a bag holds, it pauses for this many times as long."""
PATIENCE = 5.0
"""What cannot be read is spoken of after it has not changed for so long [s]."""
SETTLED = 0.5
"""A submap is complete once a scan so long [s] after its last one has a pose, so that poses lie on
both sides of each of its scans."""


class GrowingRecording(Silent):
    """Reads a growing recording anew, and makes the submaps that are complete by now.

    They are those that ``gpgrad build`` makes of the whole recording. The last one comes once the
    file itself says that it is finished, as MCAP files and ROS 1 bags do.
    """

    def __init__(
        self,
        path: Path,
        params: BuildParams | None = None,
        sources: RecordingSources | None = None,
        look: float = LOOK,
        patience: float = PATIENCE,
    ) -> None:
        """Watch a file or a folder; times are those of `LOOK` and `PATIENCE` [s]."""
        self._params, self._sources = params or BuildParams(), sources or RecordingSources()
        if self._params.gravity != "poses":
            raise InputError(
                f"{path}: a recording that still grows cannot tell the direction up by its ground; "
                "take it from the poses"
            )
        if self._sources.odometry is not None:
            raise InputError(f"{path}: odometry is made of a recording that is whole: gpgrad build")
        self._path, self._look, self._patience = path, look, patience
        self.name = str(path)
        self._kept: Callable[[], tuple[str, ...]] = tuple
        self._whole_until: dict[Path, int] = {}

    def keep(self, names: Callable[[], tuple[str, ...]]) -> None:
        """Set what gives the stored ids: of these, only the first submap is made again."""
        self._kept = names

    def news(self, stopped: threading.Event) -> Iterator[News]:
        """Look at the recording until it is finished or stopped."""
        kept = frozenset(self._kept())
        done, known = 0, ""
        said: set[str] = set()
        wrong, since = "", time.monotonic()
        while not stopped.is_set():
            begun = time.monotonic()
            state = self._state()
            if state != known:
                known, since, wrong = state, begun, ""
                try:
                    recording, finished = self._open()
                    for note in recording.notes:
                        if note not in said:
                            said.add(note)
                            yield Trouble(note)
                    for number, scans in self._complete(recording, finished=finished):
                        if stopped.is_set():
                            return
                        if number < done:
                            continue
                        if not (number and f"{number:03d}" in kept):
                            yield self._made(recording, number, scans)
                        done = number + 1
                    if finished:
                        return
                except InputError as error:  # perhaps something is not written yet
                    wrong = str(error)
            elif wrong and wrong not in said and begun - since >= self._patience:
                said.add(wrong)
                yield Trouble(wrong)
            stopped.wait(max(self._look, SHARE * (time.monotonic() - begun)))

    def _state(self) -> str:
        """Describe what is there: it differs when something has grown."""
        folders = [self._path, *(p for p in self._path.glob("*") if p.is_dir())]
        files = [self._path] if self._path.is_file() else [p for f in folders for p in f.iterdir()]
        marks: list[str] = []
        for file in sorted(files):
            try:
                status = file.stat()
            except OSError:
                continue
            marks.append(f"{file} {status.st_size} {status.st_mtime_ns}")
        return "\n".join(marks)

    def _open(self) -> tuple[Recording, bool]:
        """Open what there is by now, and say whether it will not grow any more."""
        bag = _bag_of(self._path)
        if bag is None or (bag.is_dir() and (bag / "metadata.yaml").exists()):
            recording = open_recording(self._path, self._sources, self._params)
            return level_recording(recording, self._params)[0], bag is not None
        finished = bag.suffix.lower() == ".bag" or bag.with_name("metadata.yaml").exists()
        path = bag
        if bag.suffix.lower() == ".mcap":
            finished = is_finished(bag)
            if not finished:
                path = GrowingMcap(bag)
                path.whole = whole_until(bag, self._whole_until.get(bag, path.whole))
                self._whole_until[bag] = path.whole
        recording = open_bag(path, self._sources, self._params)
        return level_recording(recording, self._params)[0], finished

    def _complete(self, recording: Recording, *, finished: bool) -> Iterator[tuple[int, range]]:
        """Give the scans of each submap that will not change any more."""
        count = len(recording)
        stamps = np.zeros(count) if recording.stamps is None else recording.stamps
        pieces = cut(stamps, recording.body, self._params, recording.covariance)
        settled = SETTLED if recording.stamps is not None else -1.0
        for number, scans in enumerate(pieces):
            is_last = number == len(pieces) - 1
            if finished or (not is_last and stamps[-1] - stamps[scans.stop - 1] > settled):
                yield number, scans

    def _made(self, recording: Recording, number: int, scans: range) -> News:
        gathered: Gathered = gather(recording, scans, self._params)
        voxels, name = gathered.voxels, f"{number:03d}"
        pose = level_pose(recording.body.one(scans.start))
        if len(voxels.keys) < self._params.min_points:
            return Trouble(
                f"submap {name} is left out: its {len(voxels.keys):,} points are fewer than "
                f"{self._params.min_points:,}"
            )
        try:
            submap = Submap.from_points(
                voxels.points,
                name,
                pose_odometry=pose,
                noise_std=voxels.noise_std,
                ranges=voxels.ranges,
            )
        except InputError as error:
            return Trouble(f"submap {name} is left out: {error}")
        return Arrival(submap)


def _bag_of(path: Path) -> Path | None:
    """Find the bag that a path names, or the newest file of one in a folder; None if none is."""
    if path.is_file():
        return path if path.suffix.lower() in ENDINGS else None
    if (path / "metadata.yaml").exists():
        return path
    files = [file for file in path.iterdir() if file.suffix.lower() in ENDINGS]
    return max(files, key=lambda file: file.stat().st_mtime_ns, default=None)
