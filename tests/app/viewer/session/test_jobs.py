import threading
import time
from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

from app.viewer.session.jobs import MOST_THREADS, Jobs, Lane, Slots, Throttle
from gpgrad_core.run import Cancelled, Progress
from tests.support.waiting import PATIENCE, until


class Record:
    """What a lane's callbacks were given, in a pool of its own."""

    def __init__(self) -> None:
        self.jobs = Jobs()
        self.started: list[int] = []
        self.shown: list[int] = []
        self.seconds: list[float] = []
        self.errors: list[tuple[int, Exception]] = []
        self.cancelled: list[int] = []

    def make(self, work: Callable[[int, Progress], int], **settings: Any) -> Lane[int, int]:
        def watched(job: int, progress: Progress) -> int:
            self.started.append(job)
            try:
                return work(job, progress)
            except Cancelled:
                self.cancelled.append(job)
                raise

        callbacks = {"on_result": self.show, "on_error": self.fail}
        return Lane(self.jobs, watched, **{**callbacks, **settings})

    def show(self, _: int, result: int, seconds: float) -> None:
        self.shown.append(result)
        self.seconds.append(seconds)

    def fail(self, job: int, error: Exception) -> None:
        self.errors.append((job, error))


def finish(lane: Lane[int, int], *jobs: int) -> None:
    """Run jobs one after the other."""
    for job in jobs:
        lane.submit(job)
        assert lane.wait_idle(PATIENCE)
    assert lane.wait_idle(PATIENCE)


def slow(seconds: float, ticks: int = 20) -> Callable[[int, Progress], int]:
    """Work that takes a while and asks often enough whether it should go on."""

    def work(job: int, progress: Progress) -> int:
        for tick in range(ticks):
            time.sleep(seconds / ticks)
            progress((tick + 1) / ticks)
        return job

    return work


def endless_before(last: int) -> Callable[[int, Progress], int]:
    """Work that goes on until it is told to stop, for all jobs but the last."""

    def work(job: int, progress: Progress) -> int:
        while job < last:
            time.sleep(0.002)
            progress(0.5)
        return job

    return work


@pytest.mark.slow
@pytest.mark.parametrize("work_seconds", [0.0, 0.02, 0.3])
def test_the_last_value_always_wins_and_nothing_overtakes(work_seconds: float) -> None:
    record = Record()
    # How long a run takes varies with its value, which is what makes naive callbacks overtake.
    lane = record.make(lambda job, progress: slow(work_seconds * (1 + job % 3) / 3)(job, progress))
    for job in range(200):
        lane.submit(job)
        time.sleep(0.002)
    finish(lane)
    assert record.shown[-1] == 199
    assert record.shown == sorted(record.shown)
    assert not record.errors


@pytest.mark.parametrize(("grace", "shown"), [(60.0, [0, 1, 2, 3, 4, 5]), (0.0, [5])])
def test_a_run_finishes_within_its_grace(grace: float, shown: list[int]) -> None:
    record, go = Record(), threading.Semaphore(0)

    def work(job: int, progress: Progress) -> int:
        assert go.acquire(timeout=PATIENCE)
        progress(0.5)
        return job

    lane = record.make(work, grace=grace, max_stale=600.0)
    lane.submit(0)
    for job in range(5):
        until(lambda job=job: job in record.started, "the run")
        lane.submit(job + 1)  # waits while the other is asked to go on
        go.release()
    go.release()
    finish(lane)
    assert record.shown == shown
    assert record.cancelled == [job for job in range(6) if job not in shown]


def test_a_long_drag_over_long_work_is_not_blind() -> None:
    record = Record()
    lane = record.make(slow(0.2), grace=0.02, max_stale=0.2)
    jobs = count()

    def drag_on() -> bool:
        lane.submit(next(jobs))
        return len(record.shown) >= 2

    until(drag_on, "pictures during the drag")
    last = next(jobs) - 1
    finish(lane)
    assert record.shown[-1] == last


def rough(job: int, progress: Progress) -> int | None:
    """A preview: the negative of the result; none of job 0."""
    progress(1.0)
    return -job or None


def test_a_preview_comes_first() -> None:
    record = Record()
    finish(record.make(slow(0.02), previews=[rough]), 1, 0, 2)
    assert record.shown == [-1, 1, 0, -2, 2]
    assert 0 <= min(record.seconds) <= max(record.seconds) < PATIENCE


def test_a_drag_over_long_work_shows_previews_and_ends_on_the_last_result() -> None:
    record = Record()
    lane = record.make(endless_before(39), previews=[rough], grace=0.02)
    for job in range(1, 40):
        lane.submit(job)
        until(lambda job=job: -job in record.shown, "the preview")
    finish(lane)
    assert record.shown == [*range(-1, -40, -1), 39]


def test_cancelling_stops_what_runs_and_only_that() -> None:
    record = Record()
    told: list[int] = []
    lane = record.make(endless_before(2), on_cancel=told.append)
    lane.cancel()  # nothing runs: nothing happens
    lane.submit(1)
    until(lambda: record.started, "the run")
    lane.submit(2)
    lane.cancel()  # the waiting one is forgotten too
    assert lane.wait_idle(PATIENCE)
    assert (told, record.started, record.shown) == ([1], [1], [])
    quick = record.make(slow(0.0), on_cancel=told.append)
    quick.cancel()
    quick.submit(3)
    assert quick.wait_idle(PATIENCE)
    assert (told, record.shown) == ([1], [3])


def test_a_job_cancelled_before_the_worker_took_it_is_told_of() -> None:
    told: list[int] = []
    never = Slots(0)  # its turn does not come
    lane = Record().make(slow(0.0), on_cancel=told.append, slots=never)
    for job in range(200):  # at whatever moment the worker is
        lane.submit(job)
        lane.cancel()
        assert lane.wait_idle(PATIENCE)
        assert told == list(range(job + 1))


def test_what_is_cancelled_is_told_before_what_comes_after_it() -> None:
    order, slots, go = list[int](), Slots(0), threading.Event()

    def tell(job: int) -> None:
        order.append(job)
        assert go.wait(PATIENCE)

    record = Record()
    lane = record.make(
        slow(0.0), on_cancel=tell, slots=slots, on_result=lambda job, *_: order.append(job)
    )
    for job in (1, 2):
        lane.submit(job)
        lane.cancel()
        until(lambda: order, "the first cancel")  # the second comes while it is told
    lane.submit(3)
    slots.release()
    go.set()
    finish(lane)
    assert order == [1, 2, 3]


def test_after_a_rest_only_the_newest_job_is_done_and_closing_does_not_wait() -> None:
    record = Record()
    lane = record.make(lambda job, _: job, rest=1.0)
    for job in range(5):
        lane.submit(job)
    finish(lane)
    assert record.shown == [4]
    lane = record.make(lambda job, _: job, rest=10 * PATIENCE)
    lane.submit(5)
    record.jobs.close()
    assert record.shown == [4]


@pytest.mark.parametrize("broken", ["work", "preview", "view"])
def test_an_error_is_a_value_and_the_lane_lives(broken: str) -> None:
    record = Record()

    def act(part: str) -> Any:
        def run(job: int, *_: object) -> int | None:
            if part == broken and job == 1:
                raise RuntimeError("no such node")
            return record.show(job, job, 0.0) if part == "view" else job

        return run

    finish(record.make(act("work"), previews=[act("preview")], on_result=act("view")), 1, 2)
    assert [(job, str(error)) for job, error in record.errors] == [(1, "no such node")]
    assert record.shown[-2:] == [2, 2]


def test_a_broken_error_callback_ends_no_worker(caplog: pytest.LogCaptureFixture) -> None:
    record = Record()

    def broken(*_: object) -> None:
        raise RuntimeError("cannot report")

    finish(record.make(lambda job, _: 1 // job, on_error=broken), 0, 1)
    assert record.shown == [1]
    assert "reporting an error failed" in caplog.text


def test_the_end_stops_what_runs_joins_and_takes_no_jobs() -> None:
    record = Record()
    lane = record.make(endless_before(2))
    lane.submit(1)
    until(lambda: record.started, "the run")
    record.jobs.close()
    assert (record.cancelled, record.shown) == ([1], [])
    lane.submit(2)
    record.jobs.close()
    assert record.started == [1]


def test_submitting_never_waits_for_the_work() -> None:
    record, go = Record(), threading.Event()
    lane = record.make(lambda job, _: job if go.wait(PATIENCE) else -1)
    for job in range(1000):
        lane.submit(job)
    assert record.shown == []
    go.set()
    finish(lane)
    assert record.shown[-1] == 999


def job_threads() -> set[threading.Thread]:
    return {thread for thread in threading.enumerate() if thread.name == "job"}


def test_what_waits_for_its_time_or_for_a_slot_holds_no_thread() -> None:
    record, slots, go = Record(), Slots(1), threading.Event()
    elsewhere = job_threads()
    most = 0

    def work(job: int, _: Progress) -> int:
        nonlocal most
        assert job or go.wait(PATIENCE)
        most = max(most, len(job_threads() - elsewhere))
        return job

    first, *others = (record.make(work, slots=slots) for _ in range(3 * MOST_THREADS))
    first.submit(0)
    until(lambda: record.started, "the run that has the slot")
    for number, lane in enumerate(others, start=1):
        lane.submit(number)
    late = record.make(work, rest=10 * PATIENCE)
    late.submit(98)
    finish(record.make(work), 99)
    assert record.shown == [99]
    others[0].cancel()
    go.set()
    assert all(lane.wait_idle(PATIENCE) for lane in (first, *others))
    assert sorted(record.shown) == [0, *range(2, 3 * MOST_THREADS), 99]
    assert most <= MOST_THREADS
    late.cancel()
    record.jobs.close()
    until(lambda: not job_threads() - elsewhere, "the end of the threads")


def test_a_pool_that_ends_leaves_its_slots_to_others() -> None:
    record, slots = Record(), Slots(0)
    record.make(slow(0.0), slots=slots).submit(1)
    record.jobs.close()
    slots.release()
    assert slots.take(lambda: None)
    assert record.started == []


def test_the_last_wish_is_fulfilled_and_few_between() -> None:
    wish, served = [0], list[int]()
    throttle: Throttle[str] = Throttle(Jobs(), lambda _: served.append(wish[0]), 0.05)
    begun = time.monotonic()
    for number in range(200):
        wish[0] = number
        throttle.request("a")
        time.sleep(0.001)
    assert throttle.wait_idle(PATIENCE)
    assert served[-1] == 199
    assert len(served) <= 2 + (time.monotonic() - begun) / 0.05


def test_each_key_is_served_and_an_error_ends_nothing() -> None:
    served: list[str] = []
    done = threading.Event()

    def act(key: str) -> None:
        if key == "bad":
            raise ValueError(key)
        served.append(key)
        done.set()

    throttle: Throttle[str] = Throttle(Jobs(), act, 0.0)
    for key in ("bad", "a", "b"):
        throttle.request(key)
    assert done.wait(PATIENCE)
    assert throttle.wait_idle(PATIENCE)
    assert sorted(served) == ["a", "b"]
