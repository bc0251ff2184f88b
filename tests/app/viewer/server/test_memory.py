"""One budget for two processes: measured, kept, and told."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from app.viewer.server import memory
from app.viewer.server.memory import (
    FULL_AFTER,
    HELPER_SHARE,
    PAUSE,
    MemoryKeeper,
    default_budget,
    group_limits,
    read_size,
    resident,
)
from gpgrad_core.arrays import Array
from gpgrad_core.run import Progress
from gpgrad_core.run.helper import Answer, Helper
from gpgrad_core.run.memo import Memo
from tests.support.refusal import assert_refused
from tests.support.waiting import until

MB = 1_000_000
_hoard: list[Array] = []


def ones(megabytes: int, number: int) -> Array:
    """Fill memory; zeros would take none."""
    return np.full(megabytes * MB // 8, float(number))


def hoard(megabytes: int, progress: Progress) -> int:
    """Keep an array for good, in whatever process this is."""
    progress(0.0)
    _hoard.append(ones(megabytes, 1))
    return os.getpid()


def answer_of(helper: Helper, function: Callable[..., int], megabytes: int) -> int:
    """Ask as soon as it is free."""
    asked: list[Answer[int] | None] = []
    until(lambda: asked.append(helper.ask(function, megabytes)) or asked[-1] is not None, "it")
    assert asked[-1] is not None
    return asked[-1].wait()


class Machine:
    """A process that holds its memo's results and other things, and a clock that stands still."""

    def __init__(self, other: int = 0) -> None:
        self.memo, self.other, self.now, self.times_measured = Memo(), other, 100.0, 0

    def held_by(self, process: int) -> int:
        """Give what this process holds as if nothing else were in it; of others, the truth."""
        if process != os.getpid():
            return resident(process)
        self.times_measured += 1
        return self.other + self.memo.num_bytes

    def wait_for_measurements(self, count: int = 5) -> None:
        enough = self.times_measured + count
        until(lambda: self.times_measured >= enough, "measurements")


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., MemoryKeeper]]:
    monkeypatch.setattr(memory, "MEASURE_EVERY", 0.005)
    for of_this_process in ("trim", "give_back"):  # which the tests share
        monkeypatch.setattr(memory, of_this_process, lambda: None)
    made: list[MemoryKeeper] = []

    def keeper(machine: Machine, budget: int, *args: Any) -> MemoryKeeper:
        helper, *others = args or (None,)
        clocks: dict[str, Any] = {"held_by": machine.held_by, "clock": lambda: machine.now}
        made.append(MemoryKeeper(budget, machine.memo, helper, *others, **clocks))
        return made[-1]

    yield keeper
    for keeper in made:
        keeper.close()


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("800MB", 800 * MB),
        ("4GB", 4000 * MB),
        ("1.5 gb", 1500 * MB),
        (" 2GB ", 2000 * MB),
        ("1TB", 10**6 * MB),
    ],
)
def test_sizes_are_read_as_people_write_them(text: str, size: int) -> None:
    assert read_size(text) == size


@pytest.mark.parametrize("text", ["", "4", "4 G", "GB", "-1GB", "1e9GB", "4GiB", "٤GB", "1.GB"])
def test_what_is_no_size_is_refused(text: str) -> None:
    assert_refused(lambda: read_size(text), f"--memory {text}: must be a size such as 800MB or 4GB")


@pytest.mark.parametrize("text", ["0MB", "599MB", "0.5GB"])
def test_what_is_too_little_is_refused(text: str) -> None:
    assert_refused(lambda: read_size(text), f"--memory {text}: the viewer needs 600 MB or more")


@pytest.mark.parametrize(
    ("machine", "limits", "budget"),
    [
        (16_000 * MB, [], 4000 * MB),
        (16_000 * MB, [8000 * MB, 10**19], 2000 * MB),  # of a container
        (1000 * MB, [], 600 * MB),
        (512_000 * MB, [], 8000 * MB),
    ],
)
def test_the_default_is_a_share_of_what_there_is(
    machine: int, limits: list[int], budget: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Machine:
        total = machine

    monkeypatch.setattr(psutil, "virtual_memory", Machine)
    monkeypatch.setattr(memory, "group_limits", lambda: limits)
    assert default_budget() == budget


def test_limits_of_control_groups_are_read(tmp_path: Path) -> None:
    groups = tmp_path / "cgroup"
    (groups / "user" / "viewer").mkdir(parents=True)
    (groups / "user" / "memory.max").write_text("900000000\n")
    (groups / "user" / "viewer" / "memory.max").write_text("max\n")
    old = groups / "memory" / "box"
    old.mkdir(parents=True)
    (old / "memory.limit_in_bytes").write_text("700000000\n")
    mine = tmp_path / "mine"
    mine.write_text("0::/user/viewer\n7:cpu,cpuacct:/box\n6:memory:/box\n")
    assert sorted(group_limits(groups, mine)) == [700 * MB, 900 * MB]
    mine.unlink()
    assert group_limits(groups, mine) == []


def test_beyond_the_budget_the_oldest_results_go(start: Callable[..., MemoryKeeper]) -> None:
    machine = Machine(other=70 * MB)
    keeper = start(machine, 10**12)
    keeper.close()  # measured and relieved by hand
    keeper.budget = 100 * MB
    for number in range(8):
        machine.memo(ones, 5, number)
    assert keeper.measure() == 110 * MB
    assert keeper.relieve() == keeper.measure() == 80 * MB  # no more than is needed
    assert machine.memo.holds(ones, 5, 7)
    assert not machine.memo.holds(ones, 5, 0)


@pytest.mark.parametrize("held", [96, 150])
def test_memory_is_given_back_early_and_once(start: Callable[..., MemoryKeeper], held: int) -> None:
    machine = Machine(other=held * MB)
    machine.memo(ones, 1, 0)
    start(machine, 100 * MB)
    until(lambda: machine.memo.num_bytes == 0, "the result to be dropped")
    machine.wait_for_measurements()
    machine.memo(ones, 1, 1)
    machine.wait_for_measurements()
    assert machine.memo.holds(ones, 1, 1)  # it is too little to try again
    machine.memo(ones, 3, 2)
    until(lambda: machine.memo.num_bytes == 0, "what was added to go")
    if held > 100:  # beyond the budget, it is tried again in any case
        machine.memo(ones, 1, 3)
        machine.now += PAUSE
        until(lambda: machine.memo.num_bytes == 0, "the next attempt")


@pytest.mark.slow
def test_a_helper_that_hoards_is_replaced(start: Callable[..., MemoryKeeper]) -> None:
    helper, machine = Helper(), Machine(other=200 * MB)
    keeper = start(machine, 10**12, helper)
    keeper.close()  # measured and relieved by hand
    try:
        machine.memo(ones, 20, 0)
        first = answer_of(helper, hoard, 1)
        keeper.budget = round(1.2 * keeper.measure())
        assert keeper.relieve() <= keeper.budget
        assert helper.process_id == first  # it may hold that much
        too_much = max(HELPER_SHARE * keeper.budget, keeper.budget - keeper.measure())
        answer_of(helper, hoard, round(too_much / MB) + 100)
        assert keeper.measure() > keeper.budget
        assert keeper.relieve() <= keeper.budget
        assert answer_of(helper, hoard, 1) not in (first, os.getpid())
        assert machine.memo.holds(ones, 20, 0)
    finally:
        helper.close()


@pytest.mark.parametrize(
    ("of_pages", "cause"),
    [(0, "this dataset needs more than"), (70, "with 70 MB that pages have begun to send and not")],
)
def test_what_cannot_be_kept_is_told_once_with_its_cause(
    start: Callable[..., MemoryKeeper], of_pages: int, cause: str
) -> None:
    told: list[str] = []
    machine = Machine(other=140 * MB)
    machine.memo(ones, 5, 0)
    start(machine, 80 * MB, None, told.append, lambda: of_pages * MB)
    machine.wait_for_measurements()
    assert told == []  # work that is done passes it too
    machine.now += FULL_AFTER + 1.0
    until(lambda: bool(told), "the message")
    machine.wait_for_measurements()
    assert len(told) == 1
    assert f"can give nothing back: {cause}" in told[0]
    assert told[0].endswith("--memory 80 MB")
    assert machine.memo.num_bytes == 0


def test_a_process_that_has_ended_holds_nothing() -> None:
    assert resident(2**22 + 5) == 0
    assert resident(os.getpid()) > 10 * MB
