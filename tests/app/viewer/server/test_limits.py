"""How pages share the server: messages that are merged, and turns."""

import asyncio
import time
from itertools import pairwise
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from app.viewer.server.limits import REST, CoalescingQueue, RoundRobin
from tests.support.widgets import run_apart

SAID = st.lists(st.tuples(st.sampled_from(["a", "b", None]), st.integers(0, 9)), max_size=40)


@given(SAID)
def test_what_is_left_has_order_and_the_last_values(said: list[tuple[str | None, int]]) -> None:
    inbox = CoalescingQueue()
    for number, (key, value) in enumerate(said):
        inbox.put(key, {"number": number, "key": key, "value": value}, value)
    sizes, left = inbox.num_bytes, list[dict[str, Any]]()
    while (message := inbox.take()) is not None:
        left.append(message)
    numbers = [message["number"] for message in left]
    assert numbers == sorted(numbers)
    assert sizes == sum(message["value"] for message in left)
    assert (inbox.num_bytes, len(inbox)) == (0, 0)
    # An act is never left out, and finds every value as it was set last.
    seen: dict[str | None, int] = {}
    states: list[dict[str | None, int]] = []
    for message in left:
        seen[message["key"]] = message["value"]
        states += [dict(seen)] if message["key"] is None else []
    expected: dict[str | None, int] = {}
    wanted: list[dict[str | None, int]] = []
    for key, value in said:
        expected[key] = value
        wanted += [dict(expected)] if key is None else []
    assert (states, seen) == (wanted, expected)
    # Between two acts there is one value of a widget at most.
    for before, after in pairwise(left):
        assert None in (before["key"], after["key"]) or before["key"] != after["key"]


def test_pages_take_turns_and_the_server_has_time_in_between() -> None:
    work, acts, breaths, rests = 0.004, list[str](), set[int](), list[float]()

    async def page(turns: RoundRobin, name: str) -> None:
        async def act() -> None:
            acts.append(name)
            time.sleep(work)  # what follows from a value

        for _ in range(6):
            await turns.wait()
            asyncio.create_task(act())  # noqa: RUF006 - as viser does

    async def breathe() -> None:
        while len(acts) < 17:
            await asyncio.sleep(0)
            breaths.add(len(acts))

    async def go() -> None:
        turns, loop = RoundRobin(), asyncio.get_running_loop()
        later: Any = loop.call_later
        loop.call_later = lambda rest, act: rests.append(rest) or later(rest, act)  # type: ignore[method-assign]
        pages = [page(turns, name) for name in "abc"]
        await asyncio.gather(*pages, breathe())

    run_apart(go())
    assert len(rests) >= 17
    assert min(rests) >= REST * work
    assert acts[1:16] == [*"abc"] * 5  # the first one asked again before the others came
    assert set(range(1, 17)) <= breaths  # others had their time between any two


def test_a_page_that_leaves_while_it_waits_does_not_take_the_turn_along() -> None:
    async def go() -> None:
        turns = RoundRobin()
        await turns.wait()
        gone = asyncio.create_task(turns.wait())
        await asyncio.sleep(0)
        gone.cancel()
        await asyncio.wait_for(turns.wait(), 10)

    run_apart(go())
