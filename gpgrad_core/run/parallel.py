"""Many similar jobs, in this thread or over an executor, with one progress and one way to stop."""

import contextlib
import hashlib
import multiprocessing
import os
import secrets
import shutil
import signal
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import wait as wait_for_any
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path
from threading import Event
from typing import Any, Generic, ParamSpec, TypeAlias, TypeVar, cast

from gpgrad_core.errors import InputError, message_of
from gpgrad_core.libraries import load_library
from gpgrad_core.run import Cancelled, Progress, part, silent
from gpgrad_core.run.folders import ProcessLock, claim, private_folder, temporary_folder
from gpgrad_core.run.store import code_version
from gpgrad_core.run.threads import at_most_workers, num_workers, single_threaded_libraries

P = ParamSpec("P")
J = TypeVar("J")
R = TypeVar("R")
Client: TypeAlias = Any
"""Of Dask, which may not be installed."""
JobFunction: TypeAlias = Callable[[J, Progress], R]
"""The function that does a job; for an executor of processes it must be picklable."""

LOOK_EVERY = 0.05
"""Seconds between two reports while workers are busy."""
AHEAD_A_WORKER = 16
"""Most jobs a worker that are begun ahead of the first; it bounds what waits in memory."""
SOCKETS = "gpgrad-w-"
LONGEST_FOLDER = 50
"""Longest name of a folder for the socket: macOS allows 103 bytes for its whole name."""
WORTH_PROCESSES = 40
"""From this number of pairs on, the comparison takes longer than processes take to start."""
ANSWER_WITHIN = 10.0
"""Time within which the scheduler must answer [s]."""
RETRIES = 3
"""How often a job is done again if it fails for a reason of the cluster's."""


def workers(count: int, num_jobs: int) -> Executor:
    """Start processes for `run_jobs`; for few pairs threads, which start sooner but are slower."""
    if num_jobs < WORTH_PROCESSES:
        return ThreadPoolExecutor(count, thread_name_prefix="worker")
    methods = multiprocessing.get_all_start_methods()
    if "forkserver" in methods:
        _keep_sockets_apart()
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["gpgrad_core.methods"])  # loaded once, for all of them
        _without_interrupts(_start_server)
    else:
        context = multiprocessing.get_context("spawn")
    try:
        return ProcessPoolExecutor(count, context, initializer=_follow_the_parent)
    except OSError:  # no shared memory for their locks, as in some containers: slower, the same
        return ThreadPoolExecutor(count, thread_name_prefix="worker")


def _start_server() -> None:
    """Start the process that starts the workers, deaf to Ctrl-C as the thread that starts it is.

    The tracker comes first, because it unblocks signals once it has been started.
    """
    from multiprocessing import forkserver, resource_tracker  # noqa: PLC0415 - not on Windows

    resource_tracker.ensure_running()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    forkserver.ensure_running()


def _without_interrupts(work: Callable[[], None], stop: Event | None = None) -> None:
    """Run work in a thread that no signal interrupts, and wait for it.

    A signal within the start of a process would leave one that nobody knows of. If the wait is
    interrupted, `stop` is set, and the work must end soon.
    """
    with ThreadPoolExecutor(1, thread_name_prefix="start") as thread:
        try:
            thread.submit(work).result()
        except BaseException as error:
            if stop is not None:
                stop.set()
            if isinstance(error, KeyboardInterrupt):
                _kill_server()
            raise


def _kill_server() -> None:
    """End the process that starts the workers; whoever waits for it gets an error."""
    server = getattr(sys.modules.get("multiprocessing.forkserver"), "_forkserver", None)
    number = getattr(server, "_forkserver_pid", None)
    if number is not None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(number, signal.SIGKILL)


def _kill_workers(executor: Executor | None) -> bool:
    """End an executor's processes in the middle of their jobs; it can do no other ones."""
    processes = cast("dict[int, Any]", getattr(executor, "_processes", None) or {})
    for process in list(processes.values()):
        process.kill()
    return bool(processes)


@cache
def _keep_sockets_apart() -> ProcessLock:
    """Let multiprocessing keep its socket where the next run finds it if this one is killed."""
    place = private_folder(temporary_folder())
    if len(str(place)) > LONGEST_FOLDER:
        place = private_folder(Path("/tmp"))
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
    """Ignore Ctrl-C, which the parent handles, and end when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None  # this runs in a worker

    def watch() -> None:
        wait_for_any([parent.sentinel])
        os._exit(1)  # at once, in the middle of a job: nobody waits for its result

    threading.Thread(target=watch, name="watch", daemon=True).start()


def run_jobs(
    work: JobFunction[J, R],
    jobs: Iterable[J],
    executor: Executor | None = None,
    progress: Progress = silent,
    take: Callable[[R], None] | None = None,
) -> list[R]:
    """Run all jobs and return their results in order; none if ``take`` receives them.

    ``take`` gets each result as it is ready and all before it are. It and the progress hook are
    called only from the calling thread. If one of them raises, a job raises or Ctrl-C is pressed,
    jobs that have not begun are dropped. Running ones stop at their next report, or in other
    processes at their end; but Ctrl-C ends these processes. After that the error is raised. The
    executor stays open; closing it is up to the caller. Jobs are of similar length. Without an
    executor, this thread does one after the other.

    Raises:
        OSError: If a process has died, because memory did not suffice or it was killed.
    """
    jobs, results = list(jobs), list[R]()
    take = results.append if take is None else take
    if executor is None:
        for k, job in enumerate(jobs):
            take(work(job, part(progress, k / len(jobs), (k + 1) / len(jobs))))
        return results
    stop = Event()
    hooks = [_Hook(stop) for _ in jobs]
    begun: deque[tuple[_Hook, Future[R]]] = deque()  # in the order of the jobs, not yet taken
    waiting, ahead = (
        deque(zip(hooks, jobs, strict=True)),
        AHEAD_A_WORKER * num_side_by_side(executor),
    )

    def begin() -> None:
        while waiting and len(begun) < ahead and not stop.is_set():
            hook, job = waiting.popleft()
            begun.append((hook, executor.submit(work, job, hook)))

    try:
        while waiting or begun:
            if waiting and len(begun) <= ahead // 2:
                _without_interrupts(begin, stop)
            wait([future for _, future in begun if not future.done()], LOOK_EVERY, FIRST_COMPLETED)
            for hook, future in begun:
                if future.done():
                    future.result()  # raises an error at once, not only when its turn comes
                    hook.fraction = 1.0
            while begun and begun[0][1].done():
                take(begun.popleft()[1].result())
            progress(sum(hook.fraction for hook in hooks) / len(hooks))
    except BaseException as error:
        stop.set()
        # If the program ends, nobody waits for the job of a minute. The executor itself then ends
        # the others; one that had been cancelled would make its thread print an error.
        killed = isinstance(error, KeyboardInterrupt) and _kill_workers(executor)
        wait([future for _, future in begun if killed or not future.cancel()])
        if isinstance(error, BrokenProcessPool):
            raise OSError(
                "a worker process has died: it was killed, or the memory did not suffice "
                "(GPGRAD_THREADS=1 takes least)"
            ) from error
        raise
    return results


def side_by_side(
    work: JobFunction[J, R],
    jobs: list[J],
    executor: Executor | None,
    progress: Progress,
    take: Callable[[R], None] | None = None,
) -> list[R]:
    """As `run_jobs`, with all cores for a single job, else with a share of them each."""
    beside = 1 if executor is None else max(1, len(jobs))
    sharing = _Sharing(work, max(1, num_workers() // beside))
    return run_jobs(sharing, jobs, executor, progress, take)


@dataclass(frozen=True, eq=False)
class _Sharing(Generic[J, R]):
    """Work that uses only its share of the cores."""

    work: JobFunction[J, R]
    threads: int

    def __call__(self, job: J, progress: Progress) -> R:
        with at_most_workers(self.threads), single_threaded_libraries():
            return self.work(job, progress)


def num_side_by_side(executor: Executor | None) -> int:
    """Count the jobs that an executor does at a time."""
    return 1 if executor is None else getattr(executor, "num_workers", None) or num_workers()


class _Hook:
    """The progress hook of one job; in another process it does nothing."""

    def __init__(self, stop: Event) -> None:
        self.fraction = 0.0
        self._stop = stop

    def __call__(self, fraction: float) -> None:
        if self._stop.is_set():
            raise Cancelled
        self.fraction = max(self.fraction, min(fraction, 1.0))

    def __reduce__(self) -> str | tuple[Callable[[], Progress], tuple[()]]:
        return _silent, ()


def _silent() -> Progress:
    return silent


class Cluster(Executor):
    """All workers of a Dask cluster, which gives the jobs of one that dies to another."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor: Executor = client.get_executor(pure=False, retries=RETRIES)
        self.num_workers = sum(cast("dict[str, int]", client.nthreads()).values())

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        return self._executor.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._executor.shutdown(wait=wait and not cancel_futures)

    def sees(self, path: Path) -> bool:
        """Whether all workers see the same file, or the same folder, under the same name."""
        if not path.is_dir():
            return self._all_have(path)
        mark = path / f".gpgrad-{secrets.token_hex(8)}"
        try:
            mark.write_text(mark.name)
            return self._all_have(mark)
        except OSError:
            return False
        finally:
            mark.unlink(missing_ok=True)

    def _all_have(self, file: Path) -> bool:
        here = _hash(file)
        there = cast("dict[str, str]", self._client.run(_hash, file.absolute()))
        return here != "" and set(there.values()) == {here}


def _hash(file: Path) -> str:
    """Hash a file; an empty text if there is none."""
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


@contextlib.contextmanager
def connected(address: str) -> Generator[Cluster]:
    """Connect to a Dask scheduler, such as ``tcp://10.0.0.7:8786``, for the time of the block.

    Raises InputError if none answers, it has no workers, or one has another version of gpgrad or of
    a library under it; and OSError if the cluster is lost, or a job has ended several workers.
    """
    distributed = load_library("distributed", "gpgrad[cluster]")
    try:
        client = distributed.Client(address, timeout=ANSWER_WITHIN, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"--scheduler {address}: no Dask scheduler answers there ({message_of(error)}); start "
            "one with: dask scheduler"
        ) from None
    try:
        if not client.nthreads():
            raise InputError(
                f"--scheduler {address}: has no workers; start some with: dask worker {address}"
            )
        _check_versions(client, address)
        yield Cluster(client)
    except distributed.KilledWorker as error:
        raise OSError(
            "a job has ended several workers of the cluster, perhaps because their memory did not "
            f"suffice: {message_of(error)}"
        ) from error
    except distributed.comm.core.CommClosedError as error:
        raise OSError(f"the cluster was lost: {message_of(error)}") from error
    finally:
        client.close()


def _check_versions(client: Client, address: str) -> None:
    try:
        versions = cast("dict[str, str]", client.run(code_version))
    except ModuleNotFoundError as error:
        raise InputError(
            f"--scheduler {address}: its workers have no {error.name}; install gpgrad there"
        ) from None
    for worker, version in sorted(versions.items()):
        if version != code_version():
            raise InputError(
                f"--scheduler {address}: worker {worker} has another gpgrad, or another release of "
                "a library; install the same ones there as here"
            )
