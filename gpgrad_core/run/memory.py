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
from typing import BinaryIO, TypeAlias

import numpy as np

from gpgrad_core.arrays import NDArray

Waiting: TypeAlias = Callable[[mmap.mmap], NDArray[np.generic]]

ALIGNED = 64
"""Arrays begin at multiples of this [bytes]."""

_MAPPED: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


class Spool:
    """A temporary file of arrays, which ends with the last of them.

    The system reads a part of it when it is looked at, and forgets that part when it needs the
    memory. What was read still counts as memory of this process, until `forget_pages`.
    """

    def __init__(self) -> None:
        """Begin with an empty file, in the folder for temporary files."""
        self._file = tempfile.TemporaryFile(prefix="gpgrad-")  # noqa: SIM115 - `finish` closes it
        self._size = 0

    def write(self, array: NDArray[np.generic]) -> Waiting:
        """Append an array; the result restores it, unwritable, from what `finish` returns."""
        content, shape, kind = np.ascontiguousarray(array), array.shape, array.dtype
        start = self._size
        self._file.write(content.data)
        padding = -content.nbytes % ALIGNED
        self._file.write(bytes(padding))
        self._size += content.nbytes + padding
        count = content.size

        def give(mapped: mmap.mmap) -> NDArray[np.generic]:
            return np.frombuffer(mapped, kind, count, start).reshape(shape)

        return give

    def finish(self) -> mmap.mmap:
        """Close the file for writing; nothing can be appended any more."""
        with self._file as file:
            file.flush()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        _MAPPED.add(mapped)
        return mapped

    def close(self) -> None:
        """Give up what was not finished; what was, stays."""
        self._file.close()


def map_file(file: BinaryIO, start: int, size: int) -> tuple[mmap.mmap, int]:
    """Map `size` bytes of a file from `start` on; also gives where they begin in the map."""
    offset = start % mmap.ALLOCATIONGRANULARITY
    first = start - offset
    mapped = mmap.mmap(file.fileno(), offset + size, access=mmap.ACCESS_READ, offset=first)
    _MAPPED.add(mapped)
    return mapped, offset


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
