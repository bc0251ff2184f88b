"""Files that are written completely or not at all, and never over what they are made from."""

import importlib.util
import json
import os
import re
from collections.abc import Generator, Iterable, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds import is_cloud
from gpgrad_core.io.folder import INFO_FILE, ODOMETRY_FILES, POSITIONS_FILE, TRUTH_FILE
from gpgrad_core.run.folders import NameLock, ProcessLock, naming

OWN_FILES = (INFO_FILE, TRUTH_FILE, POSITIONS_FILE, *ODOMETRY_FILES)
OWN_FOLDERS = ("submaps", "images")
"""What a dataset is read from, in its folder."""


def check_output(
    path: Path | str, endings: tuple[str, ...] = (), *, overwrite: bool = True
) -> Path:
    """Check that a file can be written; call this before the long work that makes its content."""
    path = Path(path)
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{path}: the ending must be one of {', '.join(endings)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot write: there is no folder {path.parent}; make it first")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: cannot write: no permission to write to {path.parent}")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; name another file, or replace it: --overwrite")
    return path


def check_apart(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Check that no output would replace an input, or become a part of it or of any dataset."""
    read = [path for path in inputs if path is not None]
    for output in (path for path in outputs if path is not None):
        folder = output.resolve().parent
        of_clouds = folder.name == OWN_FOLDERS[0] and folder.is_dir()
        if of_clouds and any(map(is_cloud, folder.iterdir())):
            raise InputError(
                f"{output}: lies among the submaps of {folder.parent}, which are inputs; name "
                "another output"
            )
        for source in read:
            if _same(output, source):
                raise InputError(f"{output}: is read as an input; name another output")
            if source.resolve().is_relative_to(output.resolve()):
                raise InputError(f"{output}: holds the input {source}; name another output")
            if source.is_dir() and _belongs(output, source):
                raise InputError(f"{output}: belongs to the input {source}; name another output")


def _same(first: Path, second: Path) -> bool:
    if first.resolve() == second.resolve():
        return True
    try:
        return first.samefile(second)  # hard links, and names that differ in case only
    except OSError:
        return False


def _belongs(output: Path, folder: Path) -> bool:
    """Whether a dataset in the folder is, or would be, read from an output."""
    place, folder = output.resolve(), folder.resolve()
    if any(place.is_relative_to(folder / name) for name in OWN_FOLDERS):
        return True
    if any(_same(place, folder / name) for name in OWN_FILES):
        return True
    inner = next((folder / name for name in OWN_FOLDERS if (folder / name).is_dir()), folder)
    if is_cloud(place) and inner == folder and place.parent == folder:
        return True
    # A link elsewhere may lead to a cloud of the dataset, or a cloud may be a link to the output.
    return place.exists() and any(_same(place, cloud) for cloud in inner.iterdir())


@contextmanager
def replacing(path: Path | str) -> Generator[Path]:
    """Provide a temporary path to write to, and rename it to `path` if the block succeeds."""
    path = check_output(path)
    _remove_left(path)
    # The ending stays the same, because writers choose the format by it.
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    with naming(path), ExitStack() as ends:
        ends.callback(NameLock(path).release)
        ends.callback(unfinished.unlink, missing_ok=True)
        unfinished.touch()
        ends.callback(ProcessLock(unfinished).release)
        yield unfinished
        unfinished.replace(path)


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write JSON for people to read, whole or not at all; each value must be a JSON value."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    with replacing(path) as unfinished:
        unfinished.write_text(text + "\n", encoding="utf-8", newline="\n")


def _remove_left(path: Path) -> None:
    """Remove what killed processes left of the same file."""
    if importlib.util.find_spec("fcntl") is None:
        return  # without locks nobody can tell it from what others are writing
    name = re.compile(re.escape(f".{path.stem}.") + r"[0-9]+" + re.escape(f".part{path.suffix}"))
    for left in path.parent.iterdir():
        if name.fullmatch(left.name):
            with suppress(OSError):
                lock = ProcessLock(left)
                if lock.held:
                    left.unlink()
                lock.release()
