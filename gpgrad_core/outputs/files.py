"""Files that are written completely or not at all."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from gpgrad_core.errors import InputError


def check_output(path: Path | str, endings: tuple[str, ...] = ()) -> Path:
    """Check that a file can be written; call this before the long work that makes its content.

    Args:
        path: The file.
        endings: Allowed endings, such as ``(".npz", ".tif")``; empty allows all.

    Returns:
        The same path.

    Raises:
        InputError: If the folder does not exist or cannot be written to, if the path is a folder,
            or if its ending is not allowed.
    """
    path = Path(path)
    if endings and path.suffix.lower() not in endings:
        raise InputError(f"{path}: the ending must be one of {', '.join(endings)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file to write")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot write: there is no folder {path.parent}; make it first")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: cannot write: no permission to write to {path.parent}")
    return path


@contextmanager
def replacing(path: Path | str) -> Generator[Path]:
    """Give a temporary path to write to, and rename it to `path` if the block succeeds.

    So a reader never sees half a file, and after a failure the old file is still there.

    Args:
        path: Where the file will be.

    Raises:
        InputError: As `check_output`.
    """
    path = check_output(path)
    # The ending stays the same, because writers choose the format by it.
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield unfinished
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
