"""Many similar jobs, in this thread or over an executor, with one progress and one way to stop."""

import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from functools import cache
from multiprocessing.connection import wait as wait_for_any
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path
from threading import Event, Lock
from typing import TypeAlias, TypeVar

from gpgrad_core.run.folders import ProcessLock, claim
from gpgrad_core.run.progress import Cancelled, Progress, part, silent
from gpgrad_core.run.threads import num_workers

J = TypeVar("J")
R = TypeVar("R")
Work: TypeAlias = Callable[[J, Progress], R]
"""The function that does a job; for an executor of processes it must be picklable."""

LOOK_EVERY = 0.05
"""Seconds between two reports while workers are busy."""
AHEAD_A_WORKER = 16
"""Largest number of jobs for each worker that are begun before the first of them is done. So there
is never more to keep, however many jobs there are."""
SOCKETS = "gpgrad-w-"
LONGEST_FOLDER = 50
"""Longest name of a folder for the socket: macOS allows 103 bytes for its whole name."""
WORTH_PROCESSES = 40
"""From this number of pairs on, the comparison takes longer than processes take to start."""


def workers(count: int, num_jobs: int) -> Executor:
    """Start processes for `run_jobs`, or threads where there is little to do.

    Registering a pair is thousands of small NumPy calls, and threads of one process mostly wait
    for each other while they make them: two processes were measured 1.9 times as fast as one, two
    threads 1.1 times. But processes take more than a second to start.

    Args:
        count: Number of processes or threads.
        num_jobs: Number of pairs of submaps to compare.
    """
    if num_jobs < WORTH_PROCESSES:
        return ThreadPoolExecutor(count, thread_name_prefix="worker")
    methods = multiprocessing.get_all_start_methods()
    if "forkserver" in methods:
        _keep_sockets_apart()
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["gpgrad_core.methods"])  # loaded once, for all of them
        _undisturbed(_start_server)
    else:
        context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(count, context, initializer=_follow_the_parent)


def _start_server() -> None:
    """Start the process that starts the workers, deaf to Ctrl-C from its first moment.

    A process inherits the signals that the thread which starts it blocks. The tracker comes first,
    because it unblocks them here once it has been started.
    """
    from multiprocessing import forkserver, resource_tracker  # noqa: PLC0415 - not on Windows

    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    forkserver.ensure_running()


def _undisturbed(work: Callable[[], None], stop: Event | None = None) -> None:
    """Do some work in a thread of its own, which no signal interrupts, and wait for it.

    Python handles signals in the main thread. Within the start of a process, they would leave one
    that nobody knows of.

    Args:
        work: What to do.
        stop: Set if the wait is interrupted; the work must then end soon.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="start") as thread:
        try:
            thread.submit(work).result()
        except BaseException:
            if stop is not None:
                stop.set()
            raise


@cache
def _keep_sockets_apart() -> ProcessLock:
    """Let multiprocessing keep its socket where the next run finds it if this one is killed.

    It makes a temporary folder of its own, once for the process, wherever `tempfile` says.
    """
    usual = tempfile.gettempdir()
    place = "/tmp" if len(usual) > LONGEST_FOLDER else usual
    folder = tempfile.mkdtemp(prefix=SOCKETS, dir=place)
    lock = claim(Path(folder), SOCKETS)
    before, tempfile.tempdir = tempfile.tempdir, folder
    try:
        get_temp_dir()
    finally:
        tempfile.tempdir = before
    # At the end of the process, after multiprocessing has removed its own, of priority -100.
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=-101)
    return lock


def _follow_the_parent() -> None:
    """Leave Ctrl-C to the parent, and end when it ends.

    A worker of a pool waits for its parent's next job for ever, even if the parent was killed. But
    it holds the end of a pipe that the system closes with the parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None  # this runs in a worker

    def watch() -> None:
        wait_for_any([parent.sentinel])
        os._exit(1)  # at once, in the middle of a job: nobody waits for its result

    threading.Thread(target=watch, name="watch", daemon=True).start()


def run_jobs(
    work: Work[J, R],
    jobs: Iterable[J],
    executor: Executor | None = None,
    progress: Progress = silent,
) -> list[R]:
    """Do all jobs and return their results in the order of the jobs; see `take_in_turn`."""
    results: list[R] = []
    take_in_turn(work, jobs, results.append, executor, progress)
    return results


def take_in_turn(
    work: Work[J, R],
    jobs: Iterable[J],
    take: Callable[[R], None],
    executor: Executor | None = None,
    progress: Progress = silent,
) -> None:
    """Do all jobs, and hand over their results in the order of the jobs as they are ready.

    ``take`` and the progress hook are called only from the calling thread. If one of them raises,
    a job raises or Ctrl-C is pressed, jobs that have not begun are dropped. Running ones stop at
    their next report, or in other processes at their end. After that the error is raised. The
    executor stays open; closing it is up to the caller.

    Args:
        work: The function that does a job.
        jobs: Jobs of similar length.
        take: Called with each result.
        executor: Threads or processes; None does all jobs in this thread, one after the other.
        progress: Called with the fraction done; may raise Cancelled.

    Raises:
        OSError: If a process has died, because memory did not suffice or it was killed.
    """
    jobs = list(jobs)
    if executor is None:
        for k, job in enumerate(jobs):
            take(work(job, part(progress, *_share(k, len(jobs)))))
        return
    tally = _Tally(len(jobs))
    begun: deque[tuple[int, Future[R]]] = deque()  # in the order of the jobs, not yet taken
    waiting, ahead = deque(enumerate(jobs)), AHEAD_A_WORKER * num_side_by_side(executor)

    def begin() -> None:
        while waiting and len(begun) < ahead and not tally.stop.is_set():
            k, job = waiting.popleft()
            begun.append((k, executor.submit(work, job, tally.of(k))))

    try:
        while waiting or begun:
            if waiting and len(begun) <= ahead // 2:
                _undisturbed(begin, tally.stop)
            wait([future for _, future in begun if not future.done()], LOOK_EVERY, FIRST_COMPLETED)
            done = [(k, future) for k, future in begun if future.done()]
            for _, future in done:
                future.result()  # raises an error at once, not only when its turn comes
            tally.finish([k for k, _ in done])
            while begun and begun[0][1].done():
                take(begun.popleft()[1].result())
            progress(tally.fraction)
    except BaseException as error:
        tally.stop.set()
        wait([future for _, future in begun if not future.cancel()])
        if isinstance(error, BrokenProcessPool):
            raise OSError(
                "a worker process has died: it was killed, or the memory did not suffice "
                "(GPGRAD_THREADS=1 takes least)"
            ) from error
        raise


def num_side_by_side(executor: Executor | None) -> int:
    """Count the jobs that an executor does at a time."""
    if executor is None:
        return 1
    return getattr(executor, "num_workers", None) or num_workers()


def _share(k: int, count: int) -> tuple[float, float]:
    """Compute the part of the progress that job k of count takes."""
    return k / count, (k + 1) / count


class _Tally:
    """Adds up the progress of jobs that run side by side, and tells them all to stop."""

    def __init__(self, count: int) -> None:
        self.stop = Event()
        self._fractions = [0.0] * count
        self._lock = Lock()

    def of(self, k: int) -> "_Report":
        return _Report(self, k)

    def note(self, k: int, fraction: float) -> None:
        with self._lock:
            self._fractions[k] = max(self._fractions[k], min(fraction, 1.0))

    def finish(self, done: list[int]) -> None:
        for k in done:
            self.note(k, 1.0)

    @property
    def fraction(self) -> float:
        with self._lock:
            return sum(self._fractions) / len(self._fractions)


class _Report:
    """The progress hook of one job; in another process it does nothing."""

    def __init__(self, tally: _Tally, k: int) -> None:
        self._tally, self._k = tally, k

    def __call__(self, fraction: float) -> None:
        if self._tally.stop.is_set():
            raise Cancelled
        self._tally.note(self._k, fraction)

    def __reduce__(self) -> str | tuple[Callable[[], Progress], tuple[()]]:
        return _unheard, ()


def _unheard() -> Progress:
    return silent
