"""Opening the files that others name; a pipe in place of one would be waited for without end."""

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path

from gpgrad_core.errors import InputError

WITHOUT_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def open_regular(path: Path) -> BufferedReader:
    """Open a file to read its bytes; InputError for a pipe, a socket or a device."""
    descriptor = os.open(check_regular(path), WITHOUT_WAITING)
    try:
        _check(os.fstat(descriptor), path)  # it may be another by now
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def check_regular(path: Path) -> Path:
    """Give a path back that a library may open; see `open_regular`."""
    _check(path.stat(), path)
    return path


def _check(status: os.stat_result, path: Path) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(status.st_mode):
        raise InputError(
            f"{path}: is not a regular file but a pipe or a device; write its content to a file"
        )


def read_regular(path: Path) -> bytes:
    """Read the bytes of a file; see `open_regular`."""
    with open_regular(path) as file:
        return file.read()
