"""Folders that appear whole or not at all, whatever ends the process that writes them.

They are written under a temporary name with a lock, which the system drops with the process. What
has such a name and no lock was left by a killed process, and the next one removes it.
"""

import contextlib
import errno
import importlib
import importlib.util
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.reading.files import WITHOUT_WAITING, read_regular
from gpgrad_core.reading.paths import check_path

PART = ".part"
MARK = ".gpgrad-temporary"
"""File by which a temporary folder is known as one that gpgrad made; it holds the folder's name."""
PREPARED, EARLIER = "prepared", "earlier"
"""Folders in `staging`: what is being written, and what it replaces."""


class ProcessLock:
    """A lock on a file or folder against other processes; Windows cannot lock folders."""

    def __init__(self, path: Path, *, create: bool = False) -> None:
        """Try to acquire the lock, in a new file if there is none; `held` is the result."""
        self.held = True
        self._descriptor: int | None = None
        if importlib.util.find_spec("fcntl") is None:
            return
        fcntl = importlib.import_module("fcntl")
        self._descriptor = os.open(path, WITHOUT_WAITING | (os.O_CREAT if create else 0), 0o666)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Its former holder may have renamed or removed it just before.
            self.held = self.is_on(path)
        except BlockingIOError:
            self.held = False
        if not self.held:
            ProcessLock.release(self)

    def is_on(self, path: Path) -> bool:
        """Whether a path still names the locked file."""
        if self._descriptor is None:
            return self.held
        try:
            return os.path.samestat(os.fstat(self._descriptor), path.stat())
        except FileNotFoundError:
            return False

    def release(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


class NameLock(ProcessLock):
    """A lock on the name of a file, whether or not there is one yet; a new one is `unfinished`."""

    def __init__(self, path: Path, is_left: Callable[[Path], bool] | None = None) -> None:
        """Acquire the lock; `is_left` recognises what a killed process may have left unfinished."""
        self.unfinished = path.with_name(f".{path.name}{PART}")
        is_new = not path.exists()
        full = is_new and self.unfinished.exists() and not _is_empty(self.unfinished)
        if full and not (is_left and is_left(self.unfinished)):
            raise _in_the_way(self.unfinished)
        super().__init__(self.unfinished if is_new else path, create=is_new)
        if not self.held or (is_new and path.exists()):  # it was given the name meanwhile
            self.release()
            raise InputError(f"{path}: another process writes this file; name another one")

    def release(self) -> None:
        """Let others have it; what was not given the name is removed."""
        if self._descriptor is not None and self.is_on(self.unfinished):
            self.unfinished.unlink()
        super().release()


def _is_empty(file: Path) -> bool:
    about = file.lstat()
    return stat.S_ISREG(about.st_mode) and about.st_size == 0


def _in_the_way(place: Path) -> InputError:
    return InputError(
        f"{place}: is in the way, and gpgrad cannot tell that it made it; move it away"
    )


@contextlib.contextmanager
def locked(folder: Path, name: Path | None = None) -> Generator[None]:
    """Hold the lock on a folder, made if missing; InputError names it if another process has it."""
    folder.mkdir(exist_ok=True)
    lock = ProcessLock(folder)
    if not lock.held:
        raise InputError(
            f"{name or folder}: another process is working on it; wait until it has finished"
        )
    try:
        yield
    finally:
        lock.release()


@contextlib.contextmanager
def staging(place: Path, *, within: bool = False, name: Path | None = None) -> Generator[Path]:
    """Provide a locked folder beside a place, or within it, to prepare its replacement in.

    It is removed at the end, or after a kill when the next process asks for it. Only a folder with
    gpgrad's mark is touched. What `put_in_place` moved away comes back if nothing took its place.
    """
    stage = (place if within else place.parent) / f".{place.name}{PART}"
    if stage.is_symlink() or (stage.exists() and not stage.is_dir()):
        raise _in_the_way(stage)
    with locked(stage, name):
        others = [entry for entry in stage.iterdir() if entry.name != MARK]
        if others and not is_marked(stage):
            raise _in_the_way(stage)

        def clear() -> None:
            earlier = stage / EARLIER
            if earlier.exists() and not place.exists():
                earlier.rename(place)
            empty(stage, last=MARK)

        try:
            clear()
            _mark(stage)
            yield stage
        finally:
            with contextlib.suppress(OSError):  # the next one tries again
                clear()
                stage.rmdir()


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
"""What a disk says that takes no more; the system does not say of which file."""


@contextlib.contextmanager
def naming(output: Path) -> Generator[None]:
    """Let an error of a disk that takes no more, while it is written to, name the output."""
    try:
        yield
    except OSError as error:
        if error.errno in FULL and (error.filename is None or PART in str(error.filename)):
            error.filename, error.filename2 = str(output), None
        raise


@contextlib.contextmanager
def whole_folder(
    directory: Path, *, earlier: Iterable[str] | None = None, replace: bool = False
) -> Generator[Path]:
    """Provide a temporary folder; its content appears in a directory if the block succeeds.

    `earlier` is None if the directory must be new or empty, or be replaced as a whole. Otherwise
    what is in it stays, but for files of the same name and files with these names, which an earlier
    run may have left. The last of these names appears last: it says that the others are whole.
    """
    place = check_path(directory).resolve()
    place.parent.mkdir(parents=True, exist_ok=True)

    def stays() -> bool:
        return earlier is not None and place.is_dir() and any(place.iterdir())

    # A mounted folder cannot be replaced, and beside it there may be no room or no permission.
    inside = place.is_dir() and (
        stays() or place.is_mount() or not os.access(place.parent, os.W_OK | os.X_OK)
    )
    with naming(directory), staging(place, within=inside, name=directory) as stage:
        unfinished = stage / PREPARED
        unfinished.mkdir()
        yield unfinished
        if inside or stays():
            _move_into(place, unfinished, tuple(earlier or ()))
        else:
            put_in_place(unfinished, place, stage, replace=replace)


def _move_into(place: Path, unfinished: Path, earlier: tuple[str, ...]) -> None:
    """Move what a folder holds into another one that exists, the last of the names at the end."""
    last = earlier[-1:]
    new = sorted((entry.name for entry in unfinished.iterdir()), key=lambda name: name in last)

    def move() -> None:
        for name in (*last, *earlier):
            if name not in new or (unfinished / name).exists():
                (place / name).unlink(missing_ok=True)
        for name in new:
            with contextlib.suppress(FileNotFoundError):  # it was moved already
                (unfinished / name).replace(place / name)
        unfinished.rmdir()

    try:
        move()
    except KeyboardInterrupt:
        # A few renames are left, and half of the files would be worse than a moment's delay.
        move()
        raise


def put_in_place(unfinished: Path, place: Path, stage: Path, *, replace: bool = False) -> None:
    """Rename a folder to its final name; `staging` undoes a replacement that was killed."""
    if replace and place.exists() and any(place.iterdir()):
        place.rename(stage / EARLIER)
    elif place.exists():
        place.rmdir()
    unfinished.rename(place)


def is_unfinished(folder: Path) -> bool:
    """Whether by its name `whole_folder` is filling a folder, or a killed process left it."""
    own = folder.parent if folder.name == PREPARED else folder
    return own.name.startswith(".") and own.name.endswith(PART)


def empty(folder: Path, last: str = "") -> None:
    """Remove everything in a folder."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name == last):
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, would survive a power cut."""
    if path.is_dir() and os.name == "nt":
        return  # Windows cannot open folders
    # Windows can only flush files that are open for writing.
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def temporary_folder() -> Path:
    """Find the system's folder for temporary files; InputError if none can be written."""
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError:
        raise InputError(
            "no folder for temporary files can be written; name one in the environment variable "
            "TMPDIR"
        ) from None


def private_folder(place: Path) -> Path:
    """Make the user's own folder in one for temporary files; this itself without owners."""
    own = os.getuid() if hasattr(os, "getuid") else 0
    folder = place / f".gpgrad-{own}"
    with contextlib.suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.lstat()
        if stat.S_ISDIR(about.st_mode) and about.st_uid == own and not about.st_mode & 0o077:
            return folder
    return place


class TemporaryFolder(tempfile.TemporaryDirectory[str]):
    """A temporary directory that the next of the same prefix removes after a kill."""

    def __init__(self, prefix: str, directory: Path | None = None) -> None:
        """Make the folder, by default in the user's temporary one; InputError if there is none."""
        place = directory or private_folder(temporary_folder())
        super().__init__(prefix=prefix, dir=place, ignore_cleanup_errors=True)
        self._lock = claim(Path(self.name), prefix)

    def cleanup(self) -> None:
        super().cleanup()
        self._lock.release()


def claim(own: Path, prefix: str) -> ProcessLock:
    """Lock a temporary folder, and remove the folders beside it whose processes were killed."""
    lock = ProcessLock(own)
    _mark(own)  # locked before it can be known as one
    if importlib.util.find_spec("fcntl") is not None:
        _remove_left(own, prefix)
    return lock


def _mark(folder: Path) -> None:
    (folder / MARK).write_text(folder.name, encoding="utf-8")


def is_marked(folder: Path) -> bool:
    """Whether gpgrad made a temporary folder of this name; a copy has another name."""
    with contextlib.suppress(FileNotFoundError):
        return read_regular(folder / MARK) == folder.name.encode()
    return False


def _remove_left(own: Path, prefix: str) -> None:
    owner = own.stat().st_uid
    for folder in own.parent.glob(f"{prefix}*"):
        with contextlib.suppress(OSError, InputError):
            if folder.lstat().st_uid != owner or folder.is_symlink():
                continue
            if not is_marked(folder):
                continue  # a user's, or a copy
            lock = ProcessLock(folder)
            if lock.held:
                shutil.rmtree(folder, ignore_errors=True)
            lock.release()
