"""Unpacks a dataset from a browser: no file outside of its folder, and no huge ones.

It comes as a zip archive, or as a folder that was dropped on the page, which packs it into one
file: a line of JSON that lists names and sizes, and the contents one after the other.
"""

import contextlib
import io
import shutil
import stat
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path, PurePosixPath
from typing import IO, Annotated, TypeAlias

import msgspec

from app.viewer.server.uploads import megabytes
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import CLOUD_ENDINGS, CLOUD_FORMATS, is_cloud, unpacked_bytes
from gpgrad_core.reading.files import opened_archive
from gpgrad_core.reading.paths import check_name
from gpgrad_core.run import Progress, silent

MOST_GROWTH = 8
"""An archive may unpack to this many times the largest upload; text is packed to a quarter."""
MOST_FILES = 5000
MOST_HEAD = 2_000_000
"""Bytes of the list of a packed folder."""
Size: TypeAlias = Annotated[int, msgspec.Meta(ge=0)]
PACKED = ".folder"
"""Ending of a folder that a page has packed."""
KNOWN = frozenset(CLOUD_FORMATS) | {".txt", ".toml", ".png", ".jpg", ".jpeg"}
"""Endings of the files of a dataset; other files are not unpacked."""


@dataclass(frozen=True)
class _Member:
    """A file of an archive; it yields no more bytes than its size."""

    name: str
    size: int
    is_link: bool
    open: Callable[[], IO[bytes]]


def unpack(
    name: str, content: bytes, folder: Path, most_bytes: int, progress: Progress = silent
) -> tuple[Path, tuple[str, ...]]:
    """Unpack a zipped dataset, or a folder that a page has packed, by the ending of its name.

    The folder to unpack to must not exist yet, and an error removes it. Returned are the
    dataset's folder, which is the one folder in the archive if there is just one, and a line that
    counts what was left out, if anything was.
    """
    folder.mkdir(parents=True)
    try:
        if name.endswith(PACKED):
            name = name.removesuffix(PACKED)
            return _unpacked(name, _packed(name, content), folder, most_bytes, progress)
        with opened_archive(io.BytesIO(content), name, "zip archive") as archive:
            members = [
                _Member(
                    member.filename,
                    member.file_size,
                    stat.S_ISLNK(member.external_attr >> 16),
                    partial(archive.open, member),
                )
                for member in archive.infolist()
                if not member.is_dir()
            ]
            return _unpacked(name, members, folder, most_bytes, progress)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if not isinstance(error, OSError):
            raise
        raise InputError(f"{name}: cannot be unpacked: {error.strerror or error}") from error


def _packed(name: str, content: bytes) -> list[_Member]:
    head = content[:MOST_HEAD].partition(b"\n")[0]
    with contextlib.suppress(msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        listed = msgspec.json.decode(head, type=list[tuple[str, Size]])
        ends = list(accumulate((size for _, size in listed), initial=len(head) + 1))
        if ends[-1] == len(content):
            files, whole = zip(listed, pairwise(ends), strict=True), memoryview(content)
            return [
                _Member(path, size, False, partial(io.BytesIO, whole[start:end]))
                for (path, size), (start, end) in files
            ]
    raise InputError(f"{name}: did not arrive as it was packed; drop the folder again")


def _unpacked(
    name: str, members: Sequence[_Member], folder: Path, most_bytes: int, progress: Progress
) -> tuple[Path, tuple[str, ...]]:
    if len(members) > MOST_FILES:
        raise InputError(f"{name}: holds {len(members):,} files, more than {MOST_FILES:,}")
    wanted: list[tuple[_Member, PurePosixPath]] = []
    for member in members:
        place = _place(name, member)
        if place.suffix.lower() in KNOWN and not _is_hidden(place):
            wanted.append((member, place))
    total = sum(member.size for member, _ in wanted)
    if total > most_bytes:
        raise InputError(
            f"{name}: would unpack to {megabytes(total)}, more than {megabytes(most_bytes)}"
        )
    done = 0
    for member, place in wanted:
        target = folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        # It yields no more bytes than its size, which was counted above.
        expected = done + member.size
        with member.open() as source, target.open("xb") as sink:
            while chunk := source.read(1 << 20):
                sink.write(chunk)
                done += len(chunk)
                progress(done / total)
        if done != expected:
            raise InputError(f"{name}: is not a complete zip archive: {member.name!r} is cut short")
        _check_unpacked(name, target, most_bytes)
    left_out = sum(not _is_hidden(PurePosixPath(member.name)) for member in members)
    left_out -= len(wanted)
    if not wanted:
        raise InputError(f"{name}: holds no clouds ({CLOUD_ENDINGS})")
    files = "file was" if left_out == 1 else "files were"
    notes = (f"{name}: {left_out} {files} left out: not part of a dataset",) if left_out else ()
    return _dataset_in(folder), notes


def _place(name: str, member: _Member) -> PurePosixPath:
    """Find the path of a member in the folder; a link, and what lies outside, is refused."""
    try:
        place = check_name(member.name)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if member.is_link:
        raise InputError(f"{name}: {member.name!r} is a link; pack the files themselves")
    return place


def _is_hidden(place: PurePosixPath) -> bool:
    """Whether the system created the file, not the user (.DS_Store, __MACOSX/…)."""
    return any(part.startswith((".", "__MACOSX")) for part in place.parts)


def _check_unpacked(name: str, path: Path, most_bytes: int) -> None:
    """Refuse a compressed cloud that is broken, or would take too much in memory."""
    kind = CLOUD_FORMATS.get(path.suffix.lower())
    if kind is None or kind.unpacked_bytes is None:
        return
    try:
        total = unpacked_bytes(path)
    except InputError as error:
        # The page knows the name of its file, not where it lies here.
        raise InputError(f"{name}: {str(error).replace(str(path), path.name)}") from None
    if total > most_bytes:
        raise InputError(
            f"{name}: {path.name} would unpack to {megabytes(total)}, "
            f"more than {megabytes(most_bytes)}"
        )


def check_cloud(path: Path, most_bytes: int) -> None:
    """Check a single cloud that was uploaded, before it is loaded."""
    if not is_cloud(path):
        raise InputError(
            f"{path.name}: is neither a zipped dataset (.zip) nor a cloud ({CLOUD_ENDINGS})"
        )
    _check_unpacked(path.name, path, most_bytes)


def _dataset_in(folder: Path) -> Path:
    """Enter folders that hold nothing but one folder, unless that is ``submaps``."""
    while True:
        entries = list(folder.iterdir())
        if len(entries) != 1 or not entries[0].is_dir() or entries[0].name == "submaps":
            return folder
        folder = entries[0]
