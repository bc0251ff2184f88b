import numpy as np
import pytest

from app.viewer.pose_graph.decisions import Decisions, decide, with_motion, with_verdict
from gpgrad_core.se2 import SE2
from gpgrad_core.types import LoopClosure, Registration

FOUND = Registration(SE2(1.0, 0.0, 0.1), np.ones(5, bool), 0.5, 10.0, 0.9, 4.0)
NOTHING = Registration(None, np.zeros(0, bool), np.inf, 0.0, 0.0, 0.0)
MOVED = Registration(SE2(2.0, 0.0, 0.2), np.ones(9, bool), 0.5, 10.0, 0.9, 7.0)
CLOSURES = (
    LoopClosure("2", "0", FOUND, True, "score 4 >= 3"),
    LoopClosure("3", "0", FOUND, False, "score 4 < 5"),
    LoopClosure("3", "1", NOTHING, False, "no motion found"),
)


def accepted(decisions: Decisions) -> list[bool]:
    return [one.accepted for one in decide(CLOSURES, decisions)]


def test_without_decisions_the_thresholds_stand() -> None:
    assert accepted(Decisions()) == [True, False, False]
    assert [one.reason for one in decide(CLOSURES, Decisions())] == [one.reason for one in CLOSURES]


def test_a_verdict_by_hand_outweighs_and_can_be_taken_back() -> None:
    before = Decisions()
    both = with_verdict(with_verdict(before, ("2", "0"), False), ("3", "0"), True)
    assert accepted(both) == [False, True, False]
    assert both.trusted == (("3", "0"),)
    assert decide(CLOSURES, both)[1].reason == "accepted by hand"
    assert accepted(with_verdict(both, ("2", "0"), None)) == [True, True, False]
    assert accepted(before) == [True, False, False]  # a snapshot does not change


def test_nothing_cannot_be_accepted() -> None:
    assert not accepted(with_verdict(Decisions(), ("3", "1"), True))[2]


def test_a_motion_by_hand_takes_the_place_of_the_found_one() -> None:
    decisions = with_motion(Decisions(), ("3", "1"), MOVED)
    closure = decide(CLOSURES, decisions)[2]
    assert closure.accepted
    assert closure.registration is MOVED
    refused = decide(CLOSURES, with_verdict(decisions, ("3", "1"), False))[2]
    assert not refused.accepted
    assert refused.registration is MOVED


@pytest.mark.parametrize("closures", [(), CLOSURES[:1]])
def test_a_pair_that_was_never_searched_is_added(closures: tuple[LoopClosure, ...]) -> None:
    decided = decide(closures, with_motion(Decisions(), ("9", "4"), MOVED))
    assert len(decided) == len(closures) + 1
    assert (decided[-1].query_id, decided[-1].database_id) == ("9", "4")
    assert decided[-1].accepted
