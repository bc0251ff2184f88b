"""Keeps our threads and those of BLAS and OpenCV from competing for the cores."""

import os
import threading
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

from threadpoolctl import ThreadpoolController

_own_share: ContextVar[int | None] = ContextVar("_own_share", default=None)


def num_workers() -> int:
    """Count the threads to use: cores, ``GPGRAD_THREADS``, or fewer within `at_most_workers`."""
    share = _own_share.get()
    return _all_workers() if share is None else min(share, _all_workers())


@contextmanager
def at_most_workers(count: int) -> Generator[None]:
    """Limit the number of threads that this thread uses, because others run at the same time."""
    token = _own_share.set(count)
    try:
        yield
    finally:
        _own_share.reset(token)


def _all_workers() -> int:
    setting = os.environ.get("GPGRAD_THREADS", "")
    if setting.isdigit() and int(setting) > 0:
        return int(setting)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _controller() -> ThreadpoolController:
    # It knows only what is loaded by now, and SciPy brings a BLAS of its own.
    import scipy.linalg  # noqa: PLC0415

    _ = scipy.linalg
    return ThreadpoolController()  # slow, because it looks at all loaded libraries


def _take_control() -> None:
    # From 3.7 on, threadpoolctl obeys only the first thread that set OpenBLAS's limit.
    for library in _controller().lib_controllers:
        clear = getattr(library, "clear_controlling_thread", None)
        if clear is not None:
            clear(force=True)


_lock = threading.Lock()
_inside = 0
_limiter: object | None = None
_opencv_threads = 1


@contextmanager
def single_threaded_libraries() -> Generator[None]:
    """Limit BLAS and OpenCV to one thread while our own threads work on small arrays.

    On matrices of a few hundred rows BLAS is four to six times slower on two busy cores: threads
    wait. The limit is the process's: the first to enter sets it and the last to leave removes it.
    """
    import cv2  # noqa: PLC0415 - not every command needs it

    global _inside, _limiter, _opencv_threads  # noqa: PLW0603 - the limit itself is the process's
    with _lock:
        if _inside == 0:
            _take_control()
            _limiter = _controller().limit(limits=1, user_api="blas")
            _opencv_threads = cv2.getNumThreads()
            cv2.setNumThreads(1)
        _inside += 1
    try:
        yield
    finally:
        with _lock:
            _inside -= 1
            if _inside == 0 and _limiter is not None:
                _take_control()
                _limiter.restore_original_limits()  # pyright: ignore[reportAttributeAccessIssue]
                _limiter = None
                cv2.setNumThreads(_opencv_threads)


@contextmanager
def own_threads() -> Generator[ThreadPoolExecutor]:
    """Start our threads, in which BLAS and OpenCV work in one thread each."""
    with single_threaded_libraries(), ThreadPoolExecutor(num_workers()) as executor:
        yield executor
