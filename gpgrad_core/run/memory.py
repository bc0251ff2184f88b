"""Returns free memory to the system, and keeps arrays in a file instead of in memory.

The C library keeps freed memory in an arena for each few threads, so a process whose threads
allocate megabytes grows to the sum of the largest moments of all arenas.
"""

import ctypes
import gc
import mmap
import tempfile
import weakref
from collections.abc import Callable
from functools import cache
from typing import IO

import numpy as np

from gpgrad_core.arrays import NDArray

ALIGNED = 64
"""Arrays begin at multiples of this [bytes]."""
LARGEST_PIECE = 1 << 26
"""A file is mapped piece by piece, of twice the size each, up to this one or that of an array
[bytes]: each map takes a descriptor of the process, which are few."""

_MAPPED: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


class Spool:
    """A temporary file of arrays, which ends with the last of them."""

    def __init__(self) -> None:
        self._file: IO[bytes] | None = None
        self._piece: mmap.mmap | None = None
        self._begin = self._end = self._until = 0  # of the piece, of the arrays, of the file

    def put(self, array: NDArray[np.generic]) -> NDArray[np.generic]:
        """Append an array; gives it as it is in the file, unwritable; OSError on a full disk."""
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix="gpgrad-")  # noqa: SIM115 - it lasts
        content = np.ascontiguousarray(array)
        if self._piece is None or self._end + content.nbytes > self._until:
            self._piece = self._next_piece(self._file, content.nbytes)
        self._file.seek(self._end)
        self._file.write(content.data)
        self._file.flush()
        place = self._end - self._begin
        self._end += content.nbytes + -content.nbytes % ALIGNED
        return np.frombuffer(self._piece, array.dtype, array.size, place).reshape(array.shape)

    def _next_piece(self, file: IO[bytes], least: int) -> mmap.mmap:
        size = max(min(self._until, LARGEST_PIECE), least, 1)
        size += -size % mmap.ALLOCATIONGRANULARITY
        file.truncate(self._until + size)
        piece = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_READ, offset=self._until)
        self._begin = self._end = self._until
        self._until += size
        _MAPPED.add(piece)
        return piece

    def close(self) -> None:
        """Accept no more arrays; those that were returned stay valid."""
        if self._file is not None:
            self._file.close()


def forget_pages() -> None:
    """Hold nothing in memory of what waits in files; it is read again when it is looked at."""
    for mapped in list(_MAPPED):
        if hasattr(mmap, "MADV_DONTNEED"):  # Windows has no such advice
            mapped.madvise(mmap.MADV_DONTNEED)


def give_back() -> None:
    """Free what only refers to itself, `forget_pages` and `trim`; takes a tenth of a second."""
    gc.collect()
    forget_pages()
    trim()


def trim() -> bool:
    """Free the C library's unused memory in some milliseconds; tells whether it can (GNU's can)."""
    malloc_trim = _malloc_trim()
    if malloc_trim is not None:
        malloc_trim(0)
    return malloc_trim is not None


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):  # another system, or another C library
        return None
