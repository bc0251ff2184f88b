"""Gives memory that was freed back to the system.

The C library keeps freed memory for later, in an arena for each few threads. A process whose
threads allocate arrays of megabytes so grows to the sum of the largest moments of all arenas.
"""

import ctypes
import gc
from collections.abc import Callable
from functools import cache

from gpgrad_core.run.spool import forget_pages


def give_back() -> None:
    """Free what only refers to itself, `forget_pages` and `trim`; takes a tenth of a second."""
    gc.collect()
    forget_pages()
    trim()


def trim() -> None:
    """Let the C library keep nothing that is free; takes some milliseconds.

    Does nothing where the C library cannot be told. That of GNU can.
    """
    told = _malloc_trim()
    if told is not None:
        told(0)


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):  # another system, or another C library
        return None
