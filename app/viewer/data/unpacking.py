"""Unpacks a zipped dataset from a browser: no file outside of its folder, and no huge ones."""

import io
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from gpgrad_core.datasets.clouds import READERS
from gpgrad_core.errors import InputError
from gpgrad_core.run.progress import Progress, silent

MOST_GROWTH = 8
"""An archive may unpack to this many times the largest upload; text is packed to a quarter."""
MOST_FILES = 5000
KNOWN = frozenset(READERS) | {".txt", ".toml", ".png", ".jpg", ".jpeg"}
"""Endings of the files of a dataset; other files are not unpacked."""
CHUNK = 1 << 20


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
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(f"{name}: is not a complete zip archive: {error}") from error
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(f"{name}: cannot be unpacked: {error.strerror or error}") from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _unpacked(
    name: str, content: bytes, folder: Path, most_bytes: int, progress: Progress
) -> tuple[Path, tuple[str, ...]]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
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
            with archive.open(member) as source, target.open("xb") as sink:
                while chunk := source.read(CHUNK):
                    sink.write(chunk)
                    done += len(chunk)
                    progress(done / total)
            if target.suffix.lower() == ".npz":
                _check_arrays(name, target, most_bytes)
    left_out = sum(not _is_hidden(PurePosixPath(member.filename)) for member in members)
    left_out -= len(wanted)
    if not wanted:
        raise InputError(f"{name}: holds no clouds ({' '.join(READERS)})")
    files = "file was" if left_out == 1 else "files were"
    notes = (f"{name}: {left_out} {files} left out: not part of a dataset",) if left_out else ()
    return _dataset_in(folder), notes


def _place(name: str, member: zipfile.ZipInfo) -> PurePosixPath:
    """Find the path of a member, relative to the folder.

    Raises:
        InputError: If the path is outside of the folder, or the member is a link or encrypted.
    """
    place = PurePosixPath(member.filename.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or ":" in member.filename or not place.parts:
        raise InputError(f"{name}: names a path outside of its folder: {member.filename!r}")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise InputError(f"{name}: {member.filename!r} is a link; pack the files themselves")
    if member.flag_bits & 1:
        raise InputError(f"{name}: {member.filename!r} is encrypted; pack it without a password")
    return place


def _is_hidden(place: PurePosixPath) -> bool:
    """Tell whether the system made the file, not the user (.DS_Store, __MACOSX/…)."""
    return any(part.startswith((".", "__MACOSX")) for part in place.parts)


def _check_arrays(name: str, path: Path, most_bytes: int) -> None:
    """Check how much memory an NPZ file would take once it is unpacked.

    Raises:
        InputError: If it would take more than `most_bytes`.
    """
    with zipfile.ZipFile(path) as arrays:
        total = sum(member.file_size for member in arrays.infolist())
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
    if path.suffix.lower() not in READERS:
        raise InputError(
            f"{path.name}: is neither a zipped dataset (.zip) nor a cloud ({' '.join(READERS)})"
        )
    if path.suffix.lower() == ".npz":
        try:
            _check_arrays(path.name, path, most_bytes)
        except zipfile.BadZipFile as error:
            raise InputError(f"{path.name}: is not a complete NPZ file: {error}") from error


def _dataset_in(folder: Path) -> Path:
    """Enter folders that hold nothing but one folder, unless that is ``submaps``."""
    while True:
        entries = list(folder.iterdir())
        if len(entries) != 1 or not entries[0].is_dir() or entries[0].name == "submaps":
            return folder
        folder = entries[0]


def _megabytes(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"
