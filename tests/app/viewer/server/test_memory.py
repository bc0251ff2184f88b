"""One budget for two processes: measured, kept, and told."""

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from app.viewer.server import memory
from app.viewer.server.memory import (
    HELPER_SHARE,
    MemoryKeeper,
    default_budget,
    group_limits,
    read_size,
    resident,
)
from gpgrad_core.arrays import Array
from gpgrad_core.run.helper import Answer, Helper
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress
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


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., MemoryKeeper]]:
    monkeypatch.setattr(memory, "MEASURE_EVERY", 0.05)
    made: list[MemoryKeeper] = []

    def keeper(*args: Any) -> MemoryKeeper:
        made.append(MemoryKeeper(*args))
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


def test_beyond_the_budget_the_oldest_results_go_and_their_memory_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # However large the process of the tests is, some of the results are within the share of it.
    monkeypatch.setattr(memory, "RELIEVED", 0.98)
    memo = Memo()
    keeper = MemoryKeeper(10**12, memo, None)
    keeper.close()  # measured and relieved by hand, so that nothing is left to chance
    keeper.relieve()
    keeper.budget = keeper.measure() + 100 * MB
    for number in range(8):
        memo(ones, 20, number)
    assert keeper.measure() > keeper.budget
    assert keeper.relieve() <= keeper.budget
    assert keeper.measure() <= keeper.budget
    assert 0 < memo.num_bytes < 160 * MB
    assert memo.holds(ones, 20, 7)
    assert not memo.holds(ones, 20, 0)


def test_it_is_measured_all_the_time(start: Callable[..., MemoryKeeper]) -> None:
    memo = Memo()
    start(1 * MB, memo, None)
    memo(ones, 5, 0)
    until(lambda: memo.num_bytes == 0, "the result to be dropped")


def test_memory_is_given_back_before_the_budget_is_passed(
    start: Callable[..., MemoryKeeper], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(MemoryKeeper, "measure", lambda keeper: round(0.96 * keeper.budget))
    memo = Memo()
    memo(ones, 5, 0)
    relieved: list[int] = []
    relieve = MemoryKeeper.relieve
    monkeypatch.setattr(
        MemoryKeeper, "relieve", lambda keeper: relieved.append(relieve(keeper)) or relieved[-1]
    )
    start(1000 * MB, memo, None)
    until(lambda: bool(relieved), "the relief")
    assert memo.num_bytes == 0
    time.sleep(0.3)
    assert len(relieved) == 1  # not again and again, as long as no more is held


@pytest.mark.slow
def test_a_helper_that_hoards_is_replaced_and_the_memo_is_spared() -> None:
    helper, memo = Helper(), Memo()
    keeper = MemoryKeeper(10**12, memo, helper)
    keeper.close()  # measured and relieved by hand, so that nothing is left to chance
    try:
        memo(ones, 20, 0)
        first = answer_of(helper, hoard, 1)
        keeper.budget = round(1.2 * keeper.measure())
        assert keeper.relieve() <= keeper.budget
        assert helper.process_id == first  # it may hold that much
        # More than its share, however large the process of the tests is, and beyond the budget,
        # however much that process has just given back.
        too_much = max(HELPER_SHARE * keeper.budget, keeper.budget - keeper.measure())
        answer_of(helper, hoard, round(too_much / MB) + 100)
        assert keeper.measure() > keeper.budget
        assert keeper.relieve() <= keeper.budget
        assert answer_of(helper, hoard, 1) not in (first, os.getpid())
        assert memo.holds(ones, 20, 0)
    finally:
        helper.close()


@pytest.mark.slow
def test_what_cannot_be_kept_is_told_once(
    start: Callable[..., MemoryKeeper], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(memory, "FULL_AFTER", 0.0)
    monkeypatch.setattr(memory, "LONGEST_PAUSE", 0.05)
    told: list[str] = []
    memo = Memo()
    memo(ones, 5, 0)
    start(1 * MB, memo, None, told.append)
    until(lambda: bool(told), "the message")
    time.sleep(0.3)
    assert len(told) == 1
    assert "can give nothing back: this dataset needs more than --memory 1 MB" in told[0]
    assert memo.num_bytes == 0


@pytest.mark.slow
def test_beyond_the_budget_what_is_added_is_not_left_until_the_next_attempt(
    start: Callable[..., MemoryKeeper], monkeypatch: pytest.MonkeyPatch
) -> None:
    relieved, relieve = list[int](), MemoryKeeper.relieve
    monkeypatch.setattr(
        MemoryKeeper, "relieve", lambda keeper: relieved.append(relieve(keeper)) or relieved[-1]
    )
    memo = Memo()
    start(20 * MB, memo, None)  # less than this process holds
    until(lambda: len(relieved) >= 7, "some attempts")  # and the next is 3 s or more away
    memo(ones, 40, 1)
    until(lambda: memo.num_bytes == 0, "what was added to go", patience=1.5)


def test_what_pages_send_is_named_as_the_cause() -> None:
    told: list[str] = []
    keeper = MemoryKeeper(10**12, Memo(), None, told.append, lambda: 700 * MB)
    keeper.close()
    keeper.budget = 800 * MB
    assert keeper._cause(1400 * MB).startswith("with 700 MB that pages have begun to send")
    assert keeper._cause(1600 * MB) == "this dataset needs more than"


def test_a_process_that_has_ended_holds_nothing() -> None:
    assert resident(2**22 + 5) == 0
    assert resident(os.getpid()) > 10 * MB
