"""Our threads and BLAS's own must not fight over the cores."""

import os
import threading
from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

from threadpoolctl import ThreadpoolController

_own_share: ContextVar[int | None] = ContextVar("_own_share", default=None)


def num_workers() -> int:
    """Threads to use: the cores this process may run on, or ``GPGRAD_THREADS``.

    Within `at_most_workers`, at most as many as given there.
    """
    share = _own_share.get()
    return _all_workers() if share is None else min(share, _all_workers())


@contextmanager
def at_most_workers(count: int) -> Generator[None]:
    """Hold what this thread runs to some threads, because others run beside it."""
    token = _own_share.set(count)
    try:
        yield
    finally:
        _own_share.reset(token)


def _all_workers() -> int:
    asked = os.environ.get("GPGRAD_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()  # looks through all loaded libraries: once is enough


def _take_control() -> None:
    """Let this thread set the limits of BLAS.

    From 3.7 on, threadpoolctl heeds only the first thread that ever set OpenBLAS's limit, and
    passes over all others in silence; here the limit is set and taken back by any thread.
    """
    for library in _controller().lib_controllers:
        clear = getattr(library, "clear_controlling_thread", None)
        if clear is not None:
            clear(force=True)


_lock = threading.Lock()
_inside = 0
_limiter: object | None = None


@contextmanager
def single_threaded_blas() -> Generator[None]:
    """Hold BLAS to one thread while our own threads share out small matrices.

    On matrices of a few hundred rows, BLAS threads wait for each other longer than they work
    (measured: four to six times slower on two busy cores). The limit is the process's, so the
    first to enter sets it and the last to leave takes it back.
    """
    global _inside, _limiter  # noqa: PLW0603 - the limit itself is the process's
    with _lock:
        if _inside == 0:
            _take_control()
            _limiter = _controller().limit(limits=1, user_api="blas")
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
