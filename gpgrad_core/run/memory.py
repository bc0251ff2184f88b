"""Gives memory that was freed back to the system.

The C library keeps freed memory for later, in an arena for each few threads. A process whose
threads allocate arrays of megabytes so grows to the sum of the largest moments of all arenas.
"""

import ctypes
import gc
from collections.abc import Callable
from functools import cache


def give_back() -> None:
    """Free what only refers to itself, and let the C library keep nothing that is free.

    Takes some hundredths of a second. Does the first half only where the C library cannot be told:
    that of GNU can.
    """
    gc.collect()
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, TypeError, AttributeError):  # another system, or another C library
        return None
