"""Jobs in order, an end that leaves nothing running, and the threads of libraries."""

import errno
import pickle
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from unittest.mock import Mock

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gpgrad_core.run import Cancelled, Progress, parallel, part, silent
from gpgrad_core.run.parallel import (
    AHEAD_A_WORKER,
    WORTH_PROCESSES,
    num_side_by_side,
    run_jobs,
    workers,
)
from gpgrad_core.run.threads import num_workers, single_threaded_libraries


@pytest.fixture
def threads() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


def doubled(job: int, progress: Progress) -> int:
    time.sleep(0.002 * (job % 3))  # so that they do not end in the order they began
    progress(0.5)
    progress(1.0)
    return 2 * job


@pytest.mark.parametrize("count", [1, 9])
@pytest.mark.parametrize("parallel", [False, True])
def test_results_come_in_order_and_progress_rises_to_one_in_the_callers_thread(
    threads: ThreadPoolExecutor, parallel: bool, count: int
) -> None:
    executor = threads if parallel else None
    assert run_jobs(doubled, [], executor) == []
    heard: list[tuple[float, threading.Thread]] = []

    def hear(fraction: float) -> None:
        heard.append((fraction, threading.current_thread()))

    assert run_jobs(doubled, range(count), executor, hear) == [2 * job for job in range(count)]
    fractions = [fraction for fraction, _ in heard]
    assert fractions == sorted(fractions)
    assert fractions[-1] == pytest.approx(1.0)
    assert {thread for _, thread in heard} == {threading.current_thread()}


def test_results_are_handed_over_as_they_are_ready(threads: ThreadPoolExecutor) -> None:
    begun, taken, caller = list[int](), list[int](), threading.current_thread()
    ahead, most_ahead = AHEAD_A_WORKER * num_side_by_side(threads), 0

    def work(job: int, _: Progress) -> int:
        nonlocal most_ahead
        begun.append(job)
        most_ahead = max(most_ahead, job - len(taken))
        time.sleep(0.02 if job == 0 else 0)  # the first is the last to end
        return job

    def take(result: int) -> None:
        assert threading.current_thread() is caller
        taken.append(result)

    run_jobs(work, range(3 * ahead), threads, take=take)
    assert taken == list(range(3 * ahead))
    assert sorted(begun) == taken
    assert most_ahead <= ahead


def test_one_who_takes_may_stop_the_rest(threads: ThreadPoolExecutor) -> None:
    done: list[int] = []

    def work(job: int, _: Progress) -> int:
        done.append(job)
        return job

    def take(result: int) -> None:
        if result == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        run_jobs(work, range(100 * AHEAD_A_WORKER), threads, take=take)
    assert len(done) <= AHEAD_A_WORKER * num_side_by_side(threads) + 3
    assert threads.submit(int, "7").result(timeout=60) == 7


class Endless:
    def __init__(self) -> None:
        self.begun: list[int] = []
        self.stopped: list[int] = []

    def __call__(self, job: int, progress: Progress) -> None:
        self.begun.append(job)
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            try:
                progress(0.1)
            except Cancelled:
                self.stopped.append(job)
                raise
            time.sleep(0.002)


@pytest.mark.parametrize("error", [Cancelled, KeyboardInterrupt])
def test_a_hook_that_raises_stops_what_runs_and_drops_the_rest(
    threads: ThreadPoolExecutor, error: type[BaseException]
) -> None:
    work = Endless()

    def stop(_: float) -> None:
        if len(work.begun) == 2:
            raise error

    with pytest.raises(error):
        run_jobs(work, range(50), threads, stop)
    assert sorted(work.stopped) == sorted(work.begun) == [0, 1]
    assert threads.submit(int, "7").result(timeout=60) == 7  # the executor is still the caller's


def test_a_job_that_fails_ends_the_others(threads: ThreadPoolExecutor) -> None:
    endless = Endless()

    def work(job: int, progress: Progress) -> None:
        if job == 1:
            raise ValueError("job 1")
        endless(job, progress)

    with pytest.raises(ValueError, match="job 1"):
        run_jobs(work, range(50), threads)
    assert sorted(endless.stopped) == sorted(endless.begun)


def test_a_process_that_died_is_an_error_of_the_system(threads: ThreadPoolExecutor) -> None:
    """So the command line says in one line that, for example, the memory did not suffice."""

    def die(_: int, __: Progress) -> None:
        raise BrokenProcessPool("abruptly")

    with pytest.raises(OSError, match="a worker process has died: it was killed, or the memory"):
        run_jobs(die, range(3), threads)


def test_the_hook_of_a_job_is_silent_in_another_process() -> None:
    hooks: list[Progress] = []

    with ThreadPoolExecutor(1) as executor:
        run_jobs(lambda _, progress: hooks.append(progress), [0], executor)
    assert pickle.loads(pickle.dumps(hooks[0])) is silent


def test_threads_where_processes_can_share_no_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = Mock(side_effect=OSError(errno.EROFS, "Read-only file system"))
    monkeypatch.setattr(parallel, "ProcessPoolExecutor", refused)
    with workers(2, WORTH_PROCESSES) as executor:
        assert isinstance(executor, ThreadPoolExecutor)
        assert run_jobs(doubled, range(9), executor) == [2 * job for job in range(9)]


def test_a_stage_reports_into_its_stretch_and_passes_a_cancelling_on() -> None:
    heard: list[float] = []
    inner = part(part(heard.append, 0.5, 1.0), 0.0, 0.5)
    for fraction in (0.0, 0.5, 1.0):
        inner(fraction)
    assert heard == [0.5, 0.625, 0.75]

    def stop(fraction: float) -> None:
        raise Cancelled(str(fraction))

    with pytest.raises(Cancelled, match=r"0\.5"):
        part(stop, 0.0, 1.0)(0.5)


def blas_pools() -> dict[str, int]:
    return {
        pool["filepath"]: pool["num_threads"]
        for pool in threadpool_info()
        if pool["user_api"] == "blas"
    }


def blas_threads() -> list[int]:
    """Threads of every BLAS that can have two; some wheels bring one that was built for one."""
    with threadpool_limits(2, user_api="blas"):
        able = [path for path, threads in blas_pools().items() if threads == 2]
    return [blas_pools()[path] for path in able]


@pytest.fixture
def two() -> Iterator[None]:
    with threadpool_limits(2, user_api="blas"):
        assert set(blas_threads()) == {2}
        yield
        assert set(blas_threads()) == {2}


@pytest.mark.usefixtures("two")
def test_blas_is_held_and_let_go() -> None:
    def fail() -> None:
        with single_threaded_libraries():
            with single_threaded_libraries():
                assert set(blas_threads()) == {1}
            assert set(blas_threads()) == {1}
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()


@pytest.mark.parametrize("before", [1, 2])
def test_opencv_is_held_and_let_go(before: int) -> None:
    usual = cv2.getNumThreads()
    cv2.setNumThreads(before)
    try:
        with single_threaded_libraries():
            with single_threaded_libraries():
                assert cv2.getNumThreads() == 1
            assert cv2.getNumThreads() == 1
        assert cv2.getNumThreads() == before
    finally:
        cv2.setNumThreads(usual)


@pytest.mark.usefixtures("two")
def test_the_last_to_leave_lets_go() -> None:
    entered, leave = threading.Event(), threading.Event()

    def linger() -> None:
        with single_threaded_libraries():
            entered.set()
            leave.wait(10)

    other = threading.Thread(target=linger)
    with single_threaded_libraries():
        other.start()
        entered.wait(10)
    assert set(blas_threads()) == {1}  # the first has left, the other still works
    leave.set()
    other.join()


@pytest.mark.usefixtures("two")
def test_any_thread_may_hold_it_after_another() -> None:
    seen: list[int] = []

    def work() -> None:
        with single_threaded_libraries():
            seen.extend(blas_threads())

    work()
    other = threading.Thread(target=work)
    other.start()
    other.join()
    assert set(seen) == {1}


@pytest.mark.parametrize("asked", ["3", "", "0", "-2", "many"])
def test_workers_are_as_many_as_asked(monkeypatch: pytest.MonkeyPatch, asked: str) -> None:
    monkeypatch.setenv("GPGRAD_THREADS", asked)
    assert num_workers() == 3 if asked == "3" else num_workers() >= 1
