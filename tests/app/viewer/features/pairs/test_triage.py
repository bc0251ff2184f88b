from dataclasses import replace

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.pairs.matrix import OPEN_PAIR
from app.viewer.features.pairs.triage import (
    PASSES,
    Filter,
    ListedPair,
    TriageTab,
    list_pairs,
    next_undecided,
)
from app.viewer.session.decisions import (
    MISSED,
    NO_OVERLAP,
    RIGHT,
    Decisions,
    decide,
    with_note,
    with_verdict,
)
from app.viewer.session.state import open_dataset
from app.viewer.widgets.bridge import send
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.types import LoopClosure
from tests.support.desk import go_to, judge, rests, uses
from tests.support.synthetic import closures_alone, make_compared
from tests.support.widgets import find, html_says, user_presses, user_sets

COMPARED = make_compared()
STATE = open_dataset(COMPARED.dataset, PipelineParams(closure=ClosureParams(0, 4.5)))
OUTCOMES = {
    ("003", "000"): RIGHT,
    ("001", "000"): MISSED,
    ("002", "001"): NO_OVERLAP,
}


def judged(min_score: float) -> tuple[LoopClosure, ...]:
    return tuple(
        replace(closure, accepted=closure.registration.score >= min_score)
        for closure in closures_alone(COMPARED)
    )


def listed(
    min_score: float, decisions: Decisions, outcomes: dict[tuple[str, str], str]
) -> tuple[ListedPair, ...]:
    closures = decide(judged(min_score), decisions)
    return list_pairs(closures, decisions, outcomes, min_score)


def names(entries: tuple[ListedPair, ...], kind: Filter) -> list[str]:
    return ["-".join(entry.pair) for entry in entries if PASSES[kind](entry)]


def test_pairs_are_listed_by_what_is_known_and_decided_of_them() -> None:
    entries = listed(3.0, Decisions(), OUTCOMES)
    assert names(entries, "all")[0] == "003-000"  # the highest score
    assert len(names(entries, "all")) == 6
    assert names(entries, "accepted") == ["003-000", "001-000", "002-001"]
    assert names(entries, "wrong") == ["002-001"]
    assert names(entries, "borderline") == ["002-001"]  # 3.0; 4.0 and 2.0 are further away
    assert names(entries, "missed") == []
    assert names(listed(4.5, Decisions(), OUTCOMES), "missed") == ["001-000"]
    decisions = with_verdict(Decisions(), ("002", "001"), False)
    decisions = with_note(with_verdict(decisions, ("002", "000"), True), ("003", "002"), "far")
    entries = listed(3.0, decisions, OUTCOMES)
    assert names(entries, "wrong") == []  # refused by hand
    assert names(entries, "decided") == ["002-001", "002-000", "003-002"]
    assert names(entries, "undecided") == ["003-000", "001-000"]
    assert [entry.verdict for entry in entries][2:4] == ["refused by hand", "accepted by hand"]


def test_the_next_undecided_pair_goes_round_the_end() -> None:
    entries = listed(3.0, Decisions(), {})
    assert next_undecided(entries, ("003", "000")) == ("001", "000")
    assert next_undecided(entries, ("002", "001")) == ("003", "000")
    decisions = with_verdict(Decisions(), ("001", "000"), True)
    entries = listed(4.5, decisions, {})
    assert next_undecided(entries, ("003", "000")) is None
    assert next_undecided((), ("003", "000")) is None


@pytest.fixture
def tab(desk: Desk) -> TriageTab:
    folder = desk.host.gui.add_folder("Triage")
    made = desk.join(TriageTab(desk, Commands(desk.host), folder))
    assert not folder.visible  # until there is a pair to decide
    judge(desk, judged(3.0), OUTCOMES)
    assert folder.visible
    return made


def test_the_list_has_a_row_and_a_picture_for_each_pair(tab: TriageTab) -> None:
    content = tab.list.content
    assert content.count('data-testid="triage-row"') == 3
    assert content.count("<img") == 3
    assert content.count('aria-pressed="true"') == 1  # the pair shown: 003 and 000
    assert "3 pairs wait for a decision" in tab.summary.content


def test_keys_decide_the_pair_shown_and_go_on(tab: TriageTab, desk: Desk) -> None:
    def press(key: object) -> None:
        html_says(desk.bridge, "triage-key", key=key)

    press("a")
    assert desk.now.decisions.verdicts == {("003", "000"): True}
    press("g")
    assert (desk.state.query_id, desk.state.database_id) == ("001", "000")
    press("x")
    assert desk.now.decisions.verdicts == {("003", "000"): True, ("001", "000"): False}
    assert rests(tab)
    assert "2 decided" in tab.summary.content
    for wrong in ("q", 1.0, None):
        press(wrong)
    assert len(desk.now.decisions.verdicts) == 2
    desk.take_back()
    assert desk.now.decisions.verdicts == {("003", "000"): True}
    desk.choose("000", "003")  # whichever way round it is shown
    press("x")
    assert desk.now.decisions.verdicts == {("003", "000"): False}


def test_a_note_follows_its_pair(tab: TriageTab, desk: Desk, server: viser.ViserServer) -> None:
    box = find(server, "Note")
    user_sets(box, "a dune ")
    assert desk.now.decisions.notes == {("003", "000"): "a dune"}
    assert box.value == "a dune "  # nobody writes over what is being typed
    assert len(desk.now.decided) == 1
    desk.choose("001", "000")
    assert box.value == ""
    desk.choose("003", "000")
    assert box.value == "a dune"
    assert rests(tab)
    assert "a dune" in tab.list.content


def test_what_cannot_be_accepted_is_told(tab: TriageTab, desk: Desk) -> None:
    closures = tuple(
        replace(
            closure,
            registration=replace(closure.registration, T_database_query=None),
            accepted=False,
        )
        for closure in judged(3.0)
    )
    judge(desk, closures)
    tab.decide(True)
    assert "no motion to accept" in tab.message.content
    assert desk.now.decisions.verdicts == {}
    tab.decide(False)
    assert desk.now.decisions.verdicts == {("003", "000"): False}
    judge(desk, closures[:1])
    tab.decide(False)
    assert "were not compared" in tab.message.content


def test_the_list_is_narrowed(tab: TriageTab, desk: Desk, server: viser.ViserServer) -> None:
    uses(tab, "List of", "wrong")
    assert tab.list.content.count('data-testid="triage-row"') == 1
    assert send(OPEN_PAIR, query="002", database="001") in tab.list.content
    desk.choose("002", "001")
    for first in (-1.0, 1e9, "0", None):
        html_says(desk.bridge, "triage-page", first=first)
    user_presses(find(server, "Next undecided"))
    assert (desk.state.query_id, desk.state.database_id) == ("003", "000")


def test_another_dataset_has_no_pairs_yet(tab: TriageTab, desk: Desk) -> None:
    go_to(desk, open_dataset(make_compared().dataset, PipelineParams()))
    assert not tab._folder.visible
    assert "triage-row" not in tab.list.content
