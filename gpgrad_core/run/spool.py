"""Arrays that wait in a temporary file instead of in memory, and are used like any others."""

import mmap
import tempfile
import weakref
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from gpgrad_core.arrays import NDArray

Waiting: TypeAlias = Callable[[mmap.mmap], NDArray[Any]]

ALIGNED = 64
"""Arrays begin at multiples of this [bytes]."""

_MAPPED: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


class Spool:
    """A temporary file of arrays, which ends with the last of them.

    The system reads a part of it when it is looked at, and forgets that part when it needs the
    memory. What was read still counts as memory of this process, until `forget_pages`.
    """

    def __init__(self) -> None:
        """Begin with an empty file, in the folder for temporary files.

        Raises:
            OSError: If it cannot be made.
        """
        self._file = tempfile.TemporaryFile(prefix="gpgrad-")  # noqa: SIM115 - `finish` closes it
        self._size = 0

    def write(self, array: NDArray[Any]) -> Waiting:
        """Append an array.

        Returns:
            What gives the array back, unwritable, once it is called with what `finish` returns.

        Raises:
            OSError: If the disk is full.
        """
        content, shape, kind = np.ascontiguousarray(array), array.shape, array.dtype
        start = self._size
        self._file.write(content.data)
        padding = -content.nbytes % ALIGNED
        self._file.write(bytes(padding))
        self._size += content.nbytes + padding
        count = content.size

        def give(mapped: mmap.mmap) -> NDArray[Any]:
            return np.frombuffer(mapped, kind, count, start).reshape(shape)

        return give

    def finish(self) -> mmap.mmap:
        """Close the file for writing; nothing can be appended any more.

        Raises:
            OSError: If the disk is full.
        """
        with self._file as file:
            file.flush()
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        _MAPPED.add(mapped)
        return mapped

    def close(self) -> None:
        """Give up what was not finished; what was, stays."""
        self._file.close()


def forget_pages() -> None:
    """Hold nothing in memory of what waits in files; it is read again when it is looked at."""
    for mapped in list(_MAPPED):
        if hasattr(mmap, "MADV_DONTNEED"):  # Windows has no such advice
            mapped.madvise(mmap.MADV_DONTNEED)
