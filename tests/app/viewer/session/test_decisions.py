import numpy as np
import pytest
import tomli_w

from app.viewer.session.decisions import (
    Decisions,
    decide,
    tables_of,
    with_motion,
    with_note,
    with_verdict,
)
from app.viewer.session.session_file import parse_session
from app.viewer.session.state import ViewState
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2
from gpgrad_core.types import LoopClosure, Registration
from tests.support.synthetic import make_dataset

FOUND = Registration(SE2(1.0, 0.0, 0.1), np.ones(5, bool), 0.5, 10.0, 0.9, 4.0)
NOTHING = Registration(None, np.zeros(0, bool), np.inf, 0.0, 0.0, 0.0)
MOVED = Registration(SE2(2.0, 0.0, 0.2), np.ones(9, bool), 0.5, 10.0, 0.9, 7.0)
CLOSURES = (
    LoopClosure("2", "0", FOUND, True, "score 4 >= 3"),
    LoopClosure("3", "0", FOUND, False, "score 4 < 5"),
    LoopClosure("3", "1", NOTHING, False, "no motion found"),
)


def accepted(decisions: Decisions) -> list[bool]:
    return [closure.accepted for closure in decide(CLOSURES, decisions)]


def test_without_decisions_the_thresholds_stand() -> None:
    plain = decide(CLOSURES, Decisions())
    assert [(one.accepted, one.reason) for one in plain] == [
        (one.accepted, one.reason) for one in CLOSURES
    ]
    assert not accepted(with_verdict(Decisions(), ("3", "1"), True))[2]  # it has no motion


def test_a_verdict_by_hand_outweighs_and_can_be_taken_back() -> None:
    before = Decisions()
    both = with_verdict(with_verdict(before, ("2", "0"), False), ("3", "0"), True)
    assert accepted(both) == [False, True, False]
    assert both.trusted == (("3", "0"),)
    assert decide(CLOSURES, both)[1].reason == "accepted by hand"
    assert accepted(with_verdict(both, ("2", "0"), None)) == [True, True, False]
    assert accepted(before) == [True, False, False]  # a snapshot does not change


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


def test_a_note_is_one_line_of_bounded_length() -> None:
    noted = with_note(Decisions(), ("2", "0"), "  seen\ntwice\t here\x00 ")
    assert noted.notes == {("2", "0"): "seen twice here"}
    assert len(with_note(noted, ("2", "0"), 999 * "x").notes["2", "0"]) == 200
    assert with_note(noted, ("2", "0"), "  ").notes == {}
    assert accepted(noted) == accepted(Decisions())
    assert noted.of_closures()["2", "0"].accepted is None


def test_decisions_come_back_from_a_file_as_they_were() -> None:
    before = with_verdict(with_verdict(Decisions(), ("2", "0"), False), ("3", "0"), True)
    before = with_note(with_note(before, ("2", "0"), "a dune"), ("3", "1"), 'say "no"')
    before = with_motion(before, ("9", "4"), MOVED)
    text = tomli_w.dumps({"decisions": tables_of(before)})
    back = parse_session(text, "a file").decisions
    assert back.verdicts == before.verdicts
    assert back.notes == before.notes
    assert back.trusted == (("3", "0"), ("9", "4"))
    motion = back.motions["9", "4"]
    assert motion.T_database_query == MOVED.T_database_query
    assert motion.num_inliers == 9
    assert accepted(back) == [*accepted(before)]


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"query": "2"}, "'database' is missing"),
        ({"query": "2", "database": "0", "accepted": "yes"}, "'accepted' must be true or false"),
        ({"query": "2", "database": "0", "note": 3}, "'note' must be a text"),
        ({"query": "2", "database": "0", "motion": {}}, "'num_inliers' is missing"),
    ],
)
def test_a_decision_that_is_none_is_refused(table: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        parse_session(tomli_w.dumps({"decisions": [table]}), "a file")


def test_too_many_decisions_are_refused() -> None:
    with pytest.raises(InputError, match="2,000 is the most"):
        parse_session('[[decisions]]\nquery="2"\ndatabase="0"\n' * 2001, "a file")


def test_a_pair_is_named_as_it_is_compared() -> None:
    dataset = make_dataset(num_points=50)
    assert ViewState(dataset, "003", "001").compared_pair == ("003", "001")
    assert ViewState(dataset, "001", "003").compared_pair == ("003", "001")
