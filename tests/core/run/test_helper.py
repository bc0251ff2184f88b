"""A second process beside this one: it answers, it stops, and it comes back when it dies."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams, register_pair
from gpgrad_core.detection.pipeline import infer_quick_maps
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Cancelled, Progress, silent
from gpgrad_core.run.helper import Answer, Helper, HelperGone, beside, start_process
from gpgrad_core.run.memo import Memo
from tests.support.synthetic import make_dataset
from tests.support.waiting import PATIENCE, until

R = TypeVar("R")
PARAMS = PipelineParams(map=MapParams(length_scale=0.3, noise_std=0.05, resolution=0.1))


def where(word: str, progress: Progress) -> tuple[str, int]:
    """Say in which process this is."""
    progress(0.5)
    return word, os.getpid()


def refuse(word: str, progress: Progress) -> None:  # noqa: ARG001
    raise InputError(f"{word}: not like that")


def cancel(fraction: float) -> None:  # noqa: ARG001
    raise Cancelled


def count_until_told(file: Path, progress: Progress) -> int:
    """Write how often it has reported, until it is told to stop."""
    for count in range(10_000):
        file.write_text(str(count))
        progress(count / 10_000)
        time.sleep(0.002)
    return 0


def die(word: str, progress: Progress) -> None:  # noqa: ARG001
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE)


def sleep(seconds: float, progress: Progress) -> float:  # noqa: ARG001
    time.sleep(seconds)
    return seconds


def is_there(process: int) -> bool:
    """Say whether there is a process of this number, be it a zombie."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def ask(helper: Helper, function: Callable[..., R], *arguments: object) -> Answer[R]:
    """Ask as soon as it has started, or has done with what was asked before."""
    answers: list[Answer[R] | None] = []

    def free() -> bool:
        answers.append(helper.ask(function, *arguments))
        return answers[-1] is not None

    until(free, "the other process to be free")
    assert answers[-1] is not None
    return answers[-1]


@contextmanager
def started() -> Iterator[tuple[Helper, int]]:
    """Start a helper; also give the number of its process."""
    with closing(Helper()) as helper:
        yield helper, ask(helper, where, "ready").wait()[1]


@pytest.fixture(scope="module")
def helper() -> Iterator[Helper]:
    with started() as (made, _):
        yield made


def test_one_call_is_made_here_and_one_there(helper: Helper) -> None:
    heard: list[float] = []
    (first, here), (second, there) = beside(helper, where, ("a",), ("b",), heard.append)
    assert (first, second) == ("a", "b")
    assert here == os.getpid() != there
    assert heard == sorted(heard)
    assert max(heard) <= 1.0


def test_without_a_helper_or_with_a_busy_one_both_run_here(helper: Helper, tmp_path: Path) -> None:
    assert beside(None, where, ("a",), ("b",))[1] == ("b", os.getpid())
    busy = ask(helper, count_until_told, tmp_path / "count")
    assert helper.ask(where, "c") is None
    assert beside(helper, where, ("a",), ("b",))[1] == ("b", os.getpid())
    busy.drop()
    with pytest.raises(Cancelled):
        busy.wait()


def test_what_is_raised_there_is_raised_here(helper: Helper) -> None:
    with pytest.raises(InputError, match="no: not like that"):
        ask(helper, refuse, "no").wait()
    assert ask(helper, where, "next").wait()[0] == "next"  # it goes on


def test_what_is_cancelled_here_stops_there(helper: Helper, tmp_path: Path) -> None:
    file = tmp_path / "count"

    def enough(fraction: float) -> None:  # noqa: ARG001
        if file.exists():
            raise Cancelled

    with pytest.raises(Cancelled):
        ask(helper, count_until_told, file).wait(enough)
    assert ask(helper, where, "free").wait()[0] == "free"


@pytest.mark.slow
def test_told_to_it_makes_room_for_a_fresh_process(helper: Helper, tmp_path: Path) -> None:
    first = helper.process_id
    assert helper.give_back()
    assert ask(helper, where, "goes on").wait()[1] == first
    busy = ask(helper, count_until_told, tmp_path / "count")
    assert not helper.restart()  # the answer is waited for
    busy.drop()
    with pytest.raises(Cancelled):
        busy.wait()
    assert helper.restart()
    assert ask(helper, where, "second").wait()[1] == helper.process_id != first


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize("at_work", [True, False])
def test_after_its_death_it_comes_back_as_another_process(at_work: bool) -> None:
    with started() as (helper, first):
        if at_work:
            with pytest.raises(HelperGone):
                ask(helper, die, "now").wait()
        else:
            os.kill(first, signal.SIGKILL)
        until(lambda: not is_there(first), "a zombie to be gone")
        second = ask(helper, where, "second").wait()[1]
        assert second not in (first, os.getpid())
        assert beside(helper, where, ("a",), ("b",))[1] == ("b", second)
    assert not is_there(second)
    assert helper.ask(where, "nobody") is None


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_stopped_its_work_is_done_here_and_it_is_replaced(monkeypatch: pytest.MonkeyPatch) -> None:
    size = 2_000_000  # does not fit into a pipe that nobody reads
    with started() as (helper, stopped):
        os.kill(stopped, signal.SIGSTOP)
        with monkeypatch.context() as short:
            short.setattr("gpgrad_core.run.helper.SILENCE", 1.0)
            result, process = beside(helper, where, ("a",), ("b" * size,))[1]
        assert (len(result), process) == (size, os.getpid())
        assert ask(helper, where, "next").wait()[1] not in (stopped, os.getpid())
        assert not is_there(stopped)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_long_silent_work_is_not_killed(helper: Helper, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gpgrad_core.run.helper.SILENCE", 1.0)
    assert ask(helper, sleep, 2.5).wait() == 2.5


def test_what_dies_before_it_is_ready_is_not_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    processes: list[subprocess.Popen[bytes]] = []

    def start() -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-c", "pass"]
        processes.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE))
        return processes[-1]

    monkeypatch.setattr("gpgrad_core.run.helper.start_process", start)
    with closing(Helper()) as helper:
        until(lambda: not is_there(processes[0].pid), "its end")
        assert helper.ask(where, "anyone") is None
    assert len(processes) == 1


@pytest.mark.skipif(os.name == "nt", reason="no signals there")
@pytest.mark.parametrize("dying", [pytest.param(2, marks=pytest.mark.slow), 99])
def test_what_is_killed_before_it_is_ready_comes_back_and_if_not_says_so(
    dying: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    begun = list[int]()

    def start() -> "subprocess.Popen[bytes]":
        process = start_process()
        begun.append(process.pid)
        if len(begun) <= dying:
            process.kill()
        return process

    monkeypatch.setattr("gpgrad_core.run.helper.start_process", start)
    with closing(Helper()) as helper:
        if dying == 2:
            assert ask(helper, where, "anyone").wait() == ("anyone", begun[2])
            assert not caplog.records
        else:
            until(lambda: "does not start" in caplog.text, "a word")


def test_a_pair_is_registered_the_same_with_and_without(helper: Helper) -> None:
    query, database = make_dataset(num_points=600).submaps[:2]
    memo = Memo()
    with pytest.raises(Cancelled):
        register_pair(query, database, PARAMS, Memo(), cancel, helper)
    assert ask(helper, where, "free").wait()[0] == "free"
    alone = register_pair(query, database, PARAMS, Memo())
    both = register_pair(query, database, PARAMS, memo, silent, helper)
    assert both.registration.score == alone.registration.score
    assert both.registration.T_database_query == alone.registration.T_database_query
    maps = [pair.query_map for pair in (both, alone)], [p.database_map for p in (both, alone)]
    quick = (infer_quick_maps(query, database, PARAMS.map, Memo(), h) for h in (helper, None))
    for helped, made in (*maps, *zip(*quick, strict=True)):
        np.testing.assert_array_equal(helped.elevation, made.elevation)
        np.testing.assert_array_equal(helped.variance, made.variance)
    # What came from the other process is in the memo like all else.
    again = register_pair(query, database, PARAMS, memo, silent, helper)
    assert again.database_map is both.database_map
    assert again.registration is both.registration


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system blocks no signals")
def test_the_other_process_is_deaf_to_ctrl_c_while_it_loads() -> None:
    process = start_process()
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 0
