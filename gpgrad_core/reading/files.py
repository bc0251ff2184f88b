"""Files and archives that others name, opened safely."""

import contextlib
import errno
import io
import os
import stat
import struct
import zipfile
import zlib
from collections.abc import Generator
from io import BufferedReader
from pathlib import Path

from gpgrad_core.errors import InputError, message_of

WITHOUT_WAITING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    NotImplementedError,  # a version that zipfile does not know
    RuntimeError,  # a password
    EOFError,
    ValueError,
    OverflowError,
    IndexError,
    KeyError,
)
"""What Python's reader raises where numbers in an archive lead nowhere."""
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


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
    """Check that a library may open a path; see `open_regular`."""
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


@contextlib.contextmanager
def opened_archive(
    source: Path | io.BufferedIOBase, where: str, kind: str
) -> Generator[zipfile.ZipFile]:
    """Open an archive of a kind, such as "NPZ file"; damage in it becomes an InputError."""
    try:
        with zipfile.ZipFile(source) as archive:
            _check_members(archive, where)
            yield archive
    except InputError:
        raise
    except OSError as error:
        if error.errno != errno.EINVAL:  # a seek to before the file's beginning
            raise
        raise InputError(f"{where}: is not a complete {kind}: {error}") from None
    except _DAMAGE as error:
        raise InputError(f"{where}: is not a complete {kind}: {message_of(error)}") from None


def _check_members(archive: zipfile.ZipFile, where: str) -> None:
    names: set[str] = set()
    for member in archive.infolist():
        if member.filename in names:
            raise InputError(f"{where}: holds two files {member.filename!r}")
        names.add(member.filename)
        if member.flag_bits & 1:
            raise InputError(
                f"{where}: {member.filename!r} is encrypted; pack it without a password"
            )
        if member.compress_type not in METHODS:
            raise InputError(
                f"{where}: {member.filename!r} is compressed by an unusual method; "
                "pack it as usual, by 'deflate'"
            )


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, where: str) -> bytes:
    """Unpack a file of checked size; InputError if it holds fewer bytes than the archive says."""
    # zipfile yields no more bytes than the archive says, and checks their checksum.
    with archive.open(member) as file:
        data = file.read()
    if len(data) != member.file_size:
        raise InputError(
            f"{where}: {member.filename!r} should hold {member.file_size:,} bytes, "
            f"but it holds {len(data):,}"
        )
    return data
