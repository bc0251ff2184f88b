"""Submaps from a recording that still grows: scans with poses, or a bag."""

import io
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpgrad_core.errors import InputError
from gpgrad_core.ground import submap_of_cloud
from gpgrad_core.live.source import LOOK, PATIENCE, Arrival, News, Source, Stamp, Trouble, mark_of
from gpgrad_core.reading.files import open_regular
from gpgrad_core.recordings.bag import open_bag
from gpgrad_core.recordings.bag_reader import ENDINGS
from gpgrad_core.recordings.build import gather, open_recording
from gpgrad_core.recordings.level import level_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.recording import Recording, RecordingSources
from gpgrad_core.se2 import level_pose

SHARE = 4.0
"""After reading what a bag holds, it pauses for this many times as long."""
QUIET_S = 0.5
"""A submap is complete once a scan so long [s] after its last one has a pose, so that poses lie on
both sides of each of its scans."""
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
"""What a record begins with: its kind, and the bytes that follow."""
FOOTER = RECORD.pack(2, 20) + bytes(20) + MAGIC
"""The end of a file without a summary."""


class GrowingRecording(Source):
    """Reads a growing recording anew, and makes the submaps that are complete by now."""

    def __init__(self, path: Path, params: BuildParams | None = None) -> None:
        super().__init__(str(path))
        self._path, self._params, self._sources = path, params or BuildParams(), RecordingSources()
        if self._params.gravity != "poses":
            raise InputError(
                f"{path}: a recording that still grows cannot tell the direction up by its ground; "
                "take it from the poses"
            )
        self._whole_until: dict[Path, int] = {}

    def news(self, stopped: threading.Event) -> Iterator[News]:
        stored = frozenset(self._stored_ids())
        done, previous = 0, list[tuple[Path, Stamp]]()
        reported: set[str] = set()
        wrong, since = "", time.monotonic()
        while not stopped.is_set():
            begun = time.monotonic()
            state = self._state()
            if state != previous:
                previous, since, wrong = state, begun, ""
                try:
                    recording, finished = self._open()
                    for note in recording.notes:
                        if note not in reported:
                            reported.add(note)
                            yield Trouble(note)
                    for number, scans in self._complete(recording, finished=finished):
                        if stopped.is_set():
                            return
                        if number < done:
                            continue
                        if not (number and f"{number:03d}" in stored):
                            yield self._news_of(recording, number, scans)
                        done = number + 1
                    if finished:
                        return
                except InputError as error:  # perhaps something is not written yet
                    wrong = str(error)
            elif wrong and wrong not in reported and begun - since >= PATIENCE:
                reported.add(wrong)
                yield Trouble(wrong)
            stopped.wait(max(LOOK, SHARE * (time.monotonic() - begun)))

    def _state(self) -> list[tuple[Path, Stamp]]:
        """The state of the recording: it differs when something has grown."""
        folders = [self._path, *(p for p in self._path.glob("*") if p.is_dir())]
        files = [self._path] if self._path.is_file() else [p for f in folders for p in f.iterdir()]
        return [(file, mark) for file in sorted(files) if (mark := mark_of(file)) is not None]

    def _open(self) -> tuple[Recording, bool]:
        """Open what there is by now, and say whether it will not grow any more."""
        bag = _bag_of(self._path)
        if bag is None or (bag.is_dir() and (bag / "metadata.yaml").exists()):
            recording = open_recording(self._path, self._sources, self._params)
            return level_recording(recording, self._params)[0], bag is not None
        finished = bag.suffix.lower() == ".bag" or bag.with_name("metadata.yaml").exists()
        path = bag
        if bag.suffix.lower() == ".mcap":
            finished = _is_finished(bag)
            if not finished:
                path = GrowingMcap(bag)
                path.whole = whole_until(bag, self._whole_until.get(bag, path.whole))
                self._whole_until[bag] = path.whole
        recording = open_bag(path, self._sources, self._params)
        return level_recording(recording, self._params)[0], finished

    def _complete(self, recording: Recording, *, finished: bool) -> Iterator[tuple[int, range]]:
        """The scans of each submap that will not change any more."""
        pieces, stamps = recording.pieces(self._params), recording.stamps
        for number, scans in enumerate(pieces):
            is_last = number == len(pieces) - 1
            later = stamps is None or stamps[-1] - stamps[scans.stop - 1] > QUIET_S
            if finished or (not is_last and later):
                yield number, scans

    def _news_of(self, recording: Recording, number: int, scans: range) -> News:
        voxels, name = gather(recording, scans, self._params).voxels, f"{number:03d}"
        pose = level_pose(recording.body.one(scans.start))
        if len(voxels.keys) < self._params.min_points:
            return Trouble(
                f"submap {name} is left out: its {len(voxels.keys):,} points are fewer than "
                f"{self._params.min_points:,}"
            )
        try:
            submap = submap_of_cloud(
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


def _is_finished(path: Path) -> bool:
    with open_regular(path) as file:
        size = file.seek(0, io.SEEK_END)
        file.seek(max(0, size - len(MAGIC)))
        return size > 2 * len(MAGIC) and file.read() == MAGIC


def whole_until(path: Path, since: int = len(MAGIC)) -> int:
    """Find where the last whole record of an MCAP file ends [bytes] (mcap.dev/spec)."""
    with open_regular(path) as file:
        size = file.seek(0, io.SEEK_END)
        end = since
        while end + RECORD.size <= size:
            file.seek(end)
            _, length = RECORD.unpack(file.read(RECORD.size))
            if end + RECORD.size + length > size:
                break
            end += RECORD.size + length
    return end


if TYPE_CHECKING:
    SystemPath = Path
else:
    SystemPath = type(Path())


class GrowingMcap(SystemPath):
    """The path of a growing MCAP, opened as if it ended after its last whole record."""

    whole: int = len(MAGIC)
    """Where the last whole record ends [bytes]."""

    def open(self, *_args: Any, **_options: Any) -> Any:
        return io.BufferedReader(_Ended(io.FileIO(str(self)), self.whole))


class _Ended(io.RawIOBase):
    """A file up to a place, with a footer after it."""

    def __init__(self, file: io.FileIO, whole: int) -> None:
        super().__init__()
        self._file, self._whole, self._place = file, whole, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        self._place = (0, self._place, self._whole + len(FOOTER))[whence] + offset
        return self._place

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        left = self._whole - self._place
        if left > 0:
            self._file.seek(self._place)
            data = self._file.read(min(left, len(view)))
        else:
            data = FOOTER[-left : len(view) - left]
        view[: len(data)] = data
        self._place += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()
