"""An unfinished dataset, which a later run can resume and which nobody mistakes for a finished one.

Everything is written to ``DATASET.partial``, and the clouds to a folder in it that no reader of
datasets looks at. The journal has one line per finished submap, with the hash of its cloud. What a
killed run left after its last complete line is made again. At the end the folder is renamed in one
step.
"""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

from msgspec import Struct, structs, to_builtins

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import JOURNAL, check_vacant
from gpgrad_core.reading.paths import check_path
from gpgrad_core.reading.records import as_record, parse_json
from gpgrad_core.reading.text import lines_of, read_text, write_lines
from gpgrad_core.run.folders import empty, locked, put_in_place, staging, to_disk

Kind = TypeVar("Kind")
UNFINISHED_CLOUDS, CLOUDS = "unfinished", "submaps"


class Entry(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A line of the journal: what became of the scans of a submap."""

    id: str  # the submap's name
    scans: tuple[int, int]  # its first scan, and the one after its last
    # number of points before conditions were asked, if there are any
    before_keep: int | None = None
    kept: int | None = None  # number of points that met them
    points: int  # number of points of the submap
    measured: int  # number of points of its scans
    not_finite: int  # number of those that were not finite
    too_close: int  # number of those that were too close to the sensor
    too_far: int  # number of those that were too far from it
    empty_scans: int  # number of scans without a usable point
    hash: str | None = None  # hash of the submap's cloud; None if it was left out


@dataclass(frozen=True, eq=False)
class Journal:
    """An unfinished dataset."""

    directory: Path  # where the finished dataset will be
    folder: Path  # where the unfinished dataset is
    entries: tuple[Entry, ...]  # one entry per finished submap

    @property
    def clouds(self) -> Path:
        return self.folder / UNFINISHED_CLOUDS

    def added(self, entry: Entry, cloud: Path | None) -> "Journal":
        """Add a submap to the journal, after its cloud has been written to the disk."""
        if cloud is not None:
            to_disk(cloud)
            entry = structs.replace(entry, hash=_hash(cloud))
        with (self.folder / JOURNAL).open("a", encoding="utf-8", newline="\n") as file:
            file.write(_line(entry) + "\n")
            file.flush()
            os.fsync(file.fileno())
        return Journal(self.directory, self.folder, (*self.entries, entry))

    def abandon(self) -> None:
        shutil.rmtree(self.folder)

    def finish(self, *, overwrite: bool = False) -> None:
        """Rename the dataset to its final name; from then on it is finished."""
        self.clouds.rename(self.folder / CLOUDS)
        to_disk(self.folder)
        with staging(self.directory) as stage:
            put_in_place(self.folder, self.directory, stage, replace=overwrite)
        to_disk(self.directory.parent)


@contextlib.contextmanager
def open_journal(
    directory: Path,
    header: Mapping[str, object],
    *,
    restart: bool = False,
    overwrite: bool = False,
) -> Generator[Journal]:
    """Begin a dataset, or resume an unfinished one with the same header of all parameters."""
    directory = check_path(directory).resolve()
    folder = directory.with_name(f"{directory.name}.partial")
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with staging(directory):
            pass  # brings back what a process had moved away that was killed in `finish`
        with locked(folder):
            try:
                check_vacant(directory, overwrite=overwrite)
                if restart:
                    empty(folder)
                begun = any(folder.iterdir())
                yield (_resume if begun else _begin)(directory, folder, header)
            finally:
                with contextlib.suppress(OSError):
                    folder.rmdir()  # if nothing was begun
    except OSError as error:
        place = error.filename or directory
        raise InputError(f"{place}: cannot be written: {error.strerror or error}") from None


def _begin(directory: Path, folder: Path, header: Mapping[str, object]) -> Journal:
    (folder / UNFINISHED_CLOUDS).mkdir(parents=True)
    write_lines(folder / JOURNAL, [json.dumps(header)])
    to_disk(folder / JOURNAL)
    return Journal(directory, folder, ())


def _resume(directory: Path, folder: Path, header: Mapping[str, object]) -> Journal:
    path = folder / JOURNAL
    lines = lines_of(read_text(path)) if path.is_file() else []
    if not lines:
        if any(entry.name not in (JOURNAL, UNFINISHED_CLOUDS) for entry in folder.iterdir()):
            raise InputError(
                f"{folder}: is in the way and is not an unfinished build; move it away"
            )
        empty(folder)  # the run was killed before it wrote a line
        return _begin(directory, folder, header)
    before: dict[str, Any] | None = _parse(lines[0], dict)
    now = json.loads(json.dumps(header))
    if before != now:
        raise InputError(
            f"{folder}: holds an unfinished build with {_difference(before, now)}; "
            "use the same to resume it, or delete it with --restart"
        )
    if (folder / CLOUDS).exists():  # the run was killed while the folder was renamed
        (folder / CLOUDS).rename(folder / UNFINISHED_CLOUDS)
    clouds = folder / UNFINISHED_CLOUDS
    clouds.mkdir(exist_ok=True)
    entries: list[Entry] = []
    for line in lines[1:]:
        entry = _parse(line, Entry)
        if entry is None or not _is_whole(entry, clouds):
            break
        entries.append(entry)
    rewritten = [lines[0], *map(_line, entries)]
    unfinished = path.with_suffix(".new")
    write_lines(unfinished, rewritten)
    to_disk(unfinished)
    unfinished.replace(path)
    listed = {f"{entry.id}.ply" for entry in entries}
    for cloud in clouds.iterdir():
        if cloud.name not in listed:
            cloud.unlink()
    return Journal(directory, folder, tuple(entries))


def _line(entry: Entry) -> str:
    return json.dumps(to_builtins(entry))


def _parse(line: str, kind: type[Kind]) -> Kind | None:
    try:
        return as_record(parse_json(line, JOURNAL), kind, JOURNAL)
    except InputError:
        return None  # the run was killed while it wrote this line


def _is_whole(entry: Entry, clouds: Path) -> bool:
    if Path(entry.id).name != entry.id:
        return False
    cloud = clouds / f"{entry.id}.ply"
    return entry.hash is None or (cloud.is_file() and _hash(cloud) == entry.hash)


def _difference(before: dict[str, Any] | None, now: dict[str, Any]) -> str:
    """Name the first thing in which two headers differ."""
    if before is None:
        return "something else"
    key = next((key for key, value in now.items() if before.get(key) != value), None)
    if key is None:
        return "something else"
    old, new = before.get(key), now[key]
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return f"another {key}"
    values = [cast("dict[str, object]", table) for table in (old, new)]
    name = next((n for n in values[1] if values[0].get(n) != values[1][n]), key)
    return f"{name} = {values[0].get(name)}, not {values[1].get(name)}"


def _hash(file: Path) -> str:
    return hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest()
