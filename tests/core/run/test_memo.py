"""The memo's promises: computed once, known by its key, bounded, the same object, any thread."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.run import Cancelled, Progress, silent
from gpgrad_core.run.memo import Memo, array_bytes


@dataclass(frozen=True)
class Params:
    height: float = 1.0
    count: int = 4


@dataclass(frozen=True, eq=False)
class Root:
    fingerprint: str


@dataclass(frozen=True, eq=False)
class Made:
    values: Array
    note: str = ""


class Counter:
    def __init__(self) -> None:
        self.calls: list[str] = []

    def first(self, root: Root, params: Params, progress: Progress = silent) -> Made:
        self.calls.append("first")
        progress(0.5)
        return Made(np.full(params.count, params.height), root.fingerprint)

    def second(self, made: Made, factor: float) -> Made:
        self.calls.append("second")
        return Made(made.values * factor, made.note)

    def pair(self, a: Made, b: Made) -> tuple[Array, float]:
        self.calls.append("pair")
        return (np.concatenate([a.values, b.values]), 3.0)

    def nothing(self, number: int) -> None:
        self.calls.append("nothing")
        assert number > 0


@pytest.fixture
def counter() -> Counter:
    return Counter()


@pytest.fixture
def memo() -> Memo:
    return Memo()


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=30))
def test_each_key_is_computed_once_however_often_it_is_asked(asked: list[tuple[int, int]]) -> None:
    counter, memo = Counter(), Memo()
    results: dict[tuple[int, int], Made] = {}
    for height, factor in asked:
        made = memo(counter.first, Root("a"), Params(float(height)))
        result = memo(counter.second, made, float(factor))
        # Going back gives the very object of before, so that a view can skip by identity.
        assert results.setdefault((height, factor), result) is result
        np.testing.assert_array_equal(result.values, np.full(4, float(height * factor)))
    assert counter.calls.count("first") == len({height for height, _ in asked})
    assert counter.calls.count("second") == len(set(asked))


def test_what_changes_the_result_is_its_key_and_nothing_else(counter: Counter, memo: Memo) -> None:
    heard: list[float] = []
    base = memo(counter.first, Root("a"), Params(), progress=heard.append)
    assert heard == [0.5]
    assert memo(counter.first, Root("a"), replace(Params(2.0), height=1.0)) is base
    assert memo(counter.first, Root("a"), Params(2.0)) is not base
    assert memo(counter.first, Root("b"), Params()) is not base
    assert len(counter.calls) == 3


def test_the_order_of_inputs_is_part_of_the_key(counter: Counter, memo: Memo) -> None:
    a, b = (memo(counter.first, Root(name), Params(float(ord(name)))) for name in "ab")
    forth, back = memo(counter.pair, a, b)[0], memo(counter.pair, b, a)[0]
    np.testing.assert_array_equal(forth, back[::-1])
    assert counter.calls.count("pair") == 2


def test_data_made_elsewhere_is_known_by_identity(counter: Counter, memo: Memo) -> None:
    twin = Made(np.ones(3))
    first = memo(counter.second, twin, 2.0)
    assert memo(counter.second, twin, 2.0) is first
    counter.calls.clear()
    for k in range(50):  # each may be put where the one before it lay
        made = Made(np.full(3, float(k)))
        np.testing.assert_array_equal(memo(counter.second, made, 2.0).values, 2 * made.values)
        del made
    assert counter.calls.count("second") == 50


@pytest.mark.parametrize("error", [Cancelled, ValueError, KeyboardInterrupt])
def test_a_stage_that_fails_or_is_cancelled_stores_nothing(
    counter: Counter, memo: Memo, error: type[BaseException]
) -> None:
    def stop(fraction: float) -> None:
        raise error(fraction)

    with pytest.raises(error):
        memo(counter.first, Root("a"), Params(), progress=stop)
    assert memo.num_bytes == 0
    memo(counter.first, Root("a"), Params())
    assert counter.calls == ["first", "first"]


def test_a_result_of_nothing_is_a_result_too(counter: Counter, memo: Memo) -> None:
    for held in (False, True):
        assert memo.holds(counter.nothing, 1) == held
        memo(counter.nothing, 1)
    assert counter.calls == ["nothing"]


@given(st.lists(st.integers(0, 9), max_size=40), st.integers(1, 5))
def test_its_bytes_are_bounded(asked: list[int], room: int) -> None:
    counter = Counter()
    memo = Memo(max_bytes=room * 80)  # room for so many results of ten numbers
    for height in asked:
        memo(counter.first, Root("a"), Params(float(height), count=10))
        assert memo.num_bytes <= room * 80
    assert memo.num_bytes == 80 * min(room, len(set(asked)))


def test_a_result_too_big_for_it_is_kept_until_the_next() -> None:
    counter, memo = Counter(), Memo(max_bytes=8)
    big = memo(counter.first, Root("a"), Params(count=1000))
    assert memo(counter.first, Root("a"), Params(count=1000)) is big
    memo(counter.first, Root("b"), Params(count=1000))
    assert memo.num_bytes == 8000


def test_told_to_it_drops_the_least_recently_used(counter: Counter, memo: Memo) -> None:
    stages = [(counter.first, Root("a"), Params(float(k), count=10)) for k in range(5)]
    for stage in (*stages, stages[0]):
        memo(*stage)
    memo.drop_to(2 * 80 + 79)
    assert memo.num_bytes == 2 * 80
    assert [memo.holds(*stage) for stage in stages] == [True, False, False, False, True]
    memo.drop_to(0)
    assert memo.num_bytes == 0
    assert not memo.holds(*stages[0])


def test_what_comes_of_a_forgotten_result_is_still_known(counter: Counter) -> None:
    memo = Memo(max_bytes=3 * 80)
    early = memo(counter.first, Root("a"), Params(count=10))
    late = memo(counter.second, early, 2.0)
    memo(counter.first, Root("b"), Params(count=10))
    memo(counter.second, early, 2.0)
    memo(counter.first, Root("c"), Params(count=10))  # throws out `early`
    again = memo(counter.first, Root("a"), Params(count=10))
    assert again is not early
    # Made anew from the same inputs, so it has the same key, and so has what comes of it.
    counter.calls.clear()
    assert memo(counter.second, again, 2.0) is late
    assert counter.calls == []


def test_threads_that_ask_at_once_get_one_object(counter: Counter) -> None:
    memo, start = Memo(), threading.Barrier(8)

    def met(root: Root) -> Made:
        start.wait()  # until all are about to make it
        return Made(np.zeros(4), root.fingerprint)

    def ask(_: int) -> Made:
        return memo(counter.second, memo(met, Root("a")), 2.0)

    with ThreadPoolExecutor(8) as executor:
        results = list(executor.map(ask, range(8)))
    assert len({id(result) for result in results}) == 1
    assert memo.num_bytes == 2 * 32


def test_threads_with_little_room_do_not_lose_count(counter: Counter) -> None:
    memo = Memo(max_bytes=5 * 80)

    def ask(k: int) -> float:
        return float(memo(counter.first, Root("a"), Params(float(k % 17), count=10)).values[0])

    with ThreadPoolExecutor(8) as executor:
        assert list(executor.map(ask, range(2000))) == [float(k % 17) for k in range(2000)]
    assert memo.num_bytes == 5 * 80


def test_bytes_are_those_of_all_arrays_within() -> None:
    eight = np.zeros(8)
    assert array_bytes(eight) == 64
    assert array_bytes(Made(eight, "name")) == 64
    assert array_bytes([eight, (eight, {"a": eight, "b": 3.0}), None, "text"]) == 192
    assert array_bytes(np.zeros((2, 3), np.uint8)) == 6
