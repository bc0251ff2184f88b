"""Unpacks a zipped dataset from a browser: no file outside of its folder, and no huge ones."""

import io
import shutil
import stat
import zipfile
from pathlib import Path, PurePosixPath

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import CLOUD_ENDINGS, CLOUD_FORMATS, is_cloud, unpacked_bytes
from gpgrad_core.reading.archives import opened_archive
from gpgrad_core.reading.paths import check_name
from gpgrad_core.run.progress import Progress, silent

MOST_GROWTH = 8
"""An archive may unpack to this many times the largest upload; text is packed to a quarter."""
MOST_FILES = 5000
KNOWN = frozenset(CLOUD_FORMATS) | {".txt", ".toml", ".png", ".jpg", ".jpeg"}
"""Endings of the files of a dataset; other files are not unpacked."""


def unpack(
    name: str, content: bytes, folder: Path, most_bytes: int, progress: Progress = silent
) -> tuple[Path, tuple[str, ...]]:
    """Unpack a zipped dataset.

    Args:
        name: Name of the archive, for messages.
        content: The archive.
        folder: The folder to unpack to. It must not exist yet, and an error removes it.
        most_bytes: Largest size of all unpacked files together [bytes].
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The dataset's folder, which is the one folder in the archive if there is just one; and a
        line that counts what was left out, if anything was.

    Raises:
        InputError: If it is not a complete zip archive, is encrypted, names a link or a file
            outside of its own folder, or holds too much.
    """
    folder.mkdir(parents=True)
    try:
        return _unpacked(name, content, folder, most_bytes, progress)
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(f"{name}: cannot be unpacked: {error.strerror or error}") from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _unpacked(
    name: str, content: bytes, folder: Path, most_bytes: int, progress: Progress
) -> tuple[Path, tuple[str, ...]]:
    with opened_archive(io.BytesIO(content), name, "zip archive") as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        if len(members) > MOST_FILES:
            raise InputError(f"{name}: holds {len(members):,} files, more than {MOST_FILES:,}")
        wanted: list[tuple[zipfile.ZipInfo, PurePosixPath]] = []
        for member in members:
            place = _place(name, member)
            if place.suffix.lower() in KNOWN and not _is_hidden(place):
                wanted.append((member, place))
        total = sum(member.file_size for member, _ in wanted)
        if total > most_bytes:
            raise InputError(
                f"{name}: would unpack to {_megabytes(total)}, more than {_megabytes(most_bytes)}"
            )
        done = 0
        for member, place in wanted:
            target = folder / place
            target.parent.mkdir(parents=True, exist_ok=True)
            # A member yields no more bytes than its header says, which were counted above.
            expected = done + member.file_size
            with archive.open(member) as source, target.open("xb") as sink:
                while chunk := source.read(1 << 20):
                    sink.write(chunk)
                    done += len(chunk)
                    progress(done / total)
            if done != expected:
                raise InputError(
                    f"{name}: is not a complete zip archive: {member.filename!r} is cut short"
                )
            _check_unpacked(name, target, most_bytes)
    left_out = sum(not _is_hidden(PurePosixPath(member.filename)) for member in members)
    left_out -= len(wanted)
    if not wanted:
        raise InputError(f"{name}: holds no clouds ({CLOUD_ENDINGS})")
    files = "file was" if left_out == 1 else "files were"
    notes = (f"{name}: {left_out} {files} left out: not part of a dataset",) if left_out else ()
    return _dataset_in(folder), notes


def _place(name: str, member: zipfile.ZipInfo) -> PurePosixPath:
    """Find the path of a member, relative to the folder.

    Raises:
        InputError: If the path is outside of the folder or cannot be a file's, or the member is a
            link.
    """
    try:
        place = check_name(member.filename)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    if stat.S_ISLNK(member.external_attr >> 16):
        raise InputError(f"{name}: {member.filename!r} is a link; pack the files themselves")
    return place


def _is_hidden(place: PurePosixPath) -> bool:
    """Tell whether the system made the file, not the user (.DS_Store, __MACOSX/…)."""
    return any(part.startswith((".", "__MACOSX")) for part in place.parts)


def _check_unpacked(name: str, path: Path, most_bytes: int) -> None:
    """Refuse a compressed cloud that would take too much in memory.

    Raises:
        InputError: If it would, or is broken.
    """
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
            f"{name}: {path.name} would unpack to {_megabytes(total)}, "
            f"more than {_megabytes(most_bytes)}"
        )


def check_cloud(path: Path, most_bytes: int) -> None:
    """Check a single cloud that was uploaded, before it is loaded.

    Raises:
        InputError: If it is of an unknown kind, or would unpack to too much.
    """
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


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
