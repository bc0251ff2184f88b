"""Submaps get their turn in the order of their numbers; gaps are waited for, but not for ever."""

from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.live.follower import PATIENCE, WINDOW, Order, Ready


def pushed(*names: str, now: float = 0.0) -> Order:
    order = Order()
    for name in names:
        order.push(name, now)
    return order


def turns(order: Order, now: float = 0.0, *, at_end: bool = False) -> list[str]:
    out: list[str] = []
    while (ready := order.next(now, at_end=at_end)) is not None:
        out.append(ready.id)
    return out


def test_what_comes_a_little_out_of_order_is_put_in_order() -> None:
    order = pushed("000", "002", "001")
    assert turns(order) == ["000", "001", "002"]
    assert (order.num_reordered, order.num_missing, order.num_late) == (1, 0, 0)


def test_a_gap_is_waited_for_until_others_have_come() -> None:
    order = pushed("0", "2")
    assert turns(order) == ["0"]
    order.push("3", 0.0)
    assert turns(order) == []
    order.push("4", 0.0)
    ready = order.next(0.0)
    assert ready == Ready("2", "submap 1 is missing: odometry bridges the gap")
    assert turns(order) == ["3", "4"]
    assert order.num_missing == 1
    order.push("1", 0.0)
    late = order.next(0.0)
    assert late == Ready("1", "submap 1 came after 4: it is taken out of its order")
    assert (order.num_late, order.num_missing) == (1, 0)


def test_a_gap_is_given_up_after_a_while_and_at_the_end() -> None:
    order = pushed("0", "2", now=10.0)
    assert turns(order, 10.0) == ["0"]
    assert order.deadline() == 10.0 + PATIENCE
    assert turns(order, 10.0 + PATIENCE) == ["2"]
    order.push("5", 20.0)
    assert turns(order, 20.0) == []
    assert turns(order, 20.0, at_end=True) == ["5"]
    assert order.num_missing == 3


def test_gaps_that_no_waiting_fills_are_not_waited_for() -> None:
    order = pushed("1311868164", "1311869999", "crater")  # times, and no number at all
    assert turns(order) == ["crater", "1311868164", "1311869999"]
    assert order.num_missing == 0
    order.push("1311870004", 0.0)
    note = "submaps 1311870000 to 1311870003 are missing: odometry bridges the gap"
    assert order.next(0.0) == Ready("1311870004", note)


@given(st.permutations(range(8)))
def test_every_submap_gets_one_turn(numbers: list[int]) -> None:
    order, out = Order(), list[str]()
    for number in numbers:
        order.push(f"{number}", 0.0)
        out += turns(order)
    out += turns(order, at_end=True)
    assert sorted(out) == [f"{number}" for number in range(8)]
    in_window = all(abs(place - number) < WINDOW for place, number in enumerate(numbers))
    if in_window and numbers[0] == 0:
        assert order.num_late == 0
        assert out == sorted(out)
