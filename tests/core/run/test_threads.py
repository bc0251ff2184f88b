"""BLAS and OpenCV are held to one thread while we work, and get their own back afterwards."""

import threading
from collections.abc import Iterator

import cv2
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from gpgrad_core.run.threads import num_workers, single_threaded_libraries


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
