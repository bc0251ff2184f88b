import threading
from copy import copy
from dataclasses import replace
from typing import Any

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.modes import Modes
from app.viewer.features.pairs import all_pairs as all_pairs_module
from app.viewer.features.pairs.all_pairs import AllPairsTab
from app.viewer.features.pairs.matrix import OPEN_PAIR
from app.viewer.features.pairs.model import PairsRun
from app.viewer.features.world import WorldTab
from app.viewer.session.decisions import with_verdict
from app.viewer.session.state import ViewState, open_dataset, with_pair, with_params
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PipelineParams
from gpgrad_core.detection.shortlist import Candidate
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.run import Progress
from gpgrad_core.run.memo import Memo
from tests.support.desk import changes, go_to, rests, uses
from tests.support.synthetic import closures_alone, make_compared, make_dataset
from tests.support.waiting import until
from tests.support.widgets import find, html_says, said, user_presses, user_sets

COMPARED = make_compared()
STATE = open_dataset(COMPARED.dataset, PipelineParams(closure=ClosureParams(0, 4.5)))

SHORTLISTS = {
    submap.id: (Candidate("another <one>", 40, 0.5), Candidate(STATE.database_id, 12, 0.25))
    for submap in STATE.dataset.submaps
}


class Comparer:
    """Stands in for `compare_pairs`: an answer by hand, when it is let go."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()
        self.at_once = 0

    def __call__(
        self,
        run: PairsRun,
        memo: Memo,  # noqa: ARG002
        progress: Progress,
    ) -> None:
        self.run, self.candidates = run, run.candidates
        self.num_known = len(run.registered)
        run.truth = COMPARED.truth
        for closure in closures_alone(COMPARED)[: self.at_once]:
            run.registered[closure.pair] = closure.registration
        progress(0.25)
        while not self.go.wait(0.005):
            progress(0.5)
        assert COMPARED.table is not None
        run.table, run.has_ended = copy(COMPARED.table), True
        run.table.shortlists = {} if run.candidates in ("automatic", "all") else SHORTLISTS


@pytest.fixture
def comparer(monkeypatch: pytest.MonkeyPatch) -> Comparer:
    fake = Comparer()
    monkeypatch.setattr(all_pairs_module, "compare_pairs", fake)
    return fake


@pytest.fixture
def tab(
    desk: Desk,
    comparer: Comparer,  # noqa: ARG001
) -> AllPairsTab:
    modes = desk.join(Modes(desk))
    return desk.join(AllPairsTab(desk, WorldTab(desk, modes), modes, Commands(desk.host)))


def run(tab: AllPairsTab) -> None:
    uses(tab, "Run all pairs")


def shown(desk: Desk) -> tuple[str, str]:
    return desk.state.query_id, desk.state.database_id


def test_all_pairs_are_run_and_told(tab: AllPairsTab, server: viser.ViserServer) -> None:
    run(tab)
    assert "1 loop closure in 6 pairs: 1 with the right motion, 0 with a wrong motion, " in said(
        server
    )
    assert "precision is 1.000 and recall 1.000" in said(server)
    assert "affinity" in said(server)
    assert find(server, "Run all pairs").visible
    assert not find(server, "Cancel").visible


def test_an_export_compares_as_the_panel_says_and_what_is_missing(
    tab: AllPairsTab, comparer: Comparer, server: viser.ViserServer
) -> None:
    comparer.at_once = 2
    run(tab)
    detection: Any = tab.detection(STATE)
    assert detection.args[0].registered == comparer.run.registered
    assert len(comparer.run.registered) == 2
    user_sets(find(server, "Compare with"), "the 5 best")
    detection = tab.detection(STATE)
    assert detection.args[0].candidates == 5
    assert not detection.args[0].registered


def test_thresholds_are_followed(tab: AllPairsTab, desk: Desk, server: viser.ViserServer) -> None:
    run(tab)
    histogram = tab.html["scores"].content
    assert "data-scores" in histogram
    go_to(desk, with_params(STATE, PipelineParams(closure=ClosureParams(0, 0.5))))
    assert rests(tab)
    assert "5 loop closures in 6 pairs" in said(server)
    assert tab.html["scores"].content is histogram  # a drag does not draw it anew
    assert "run again" not in said(server)
    uses(tab, "True if", "surface overlap > 0.2")
    assert "10 cm cells" in said(server)
    smoother = replace(STATE.params, map=replace(STATE.params.map, length_scale=0.5))
    go_to(desk, with_params(STATE, smoother))
    assert rests(tab)
    assert "run again" in said(server)


def test_another_pair_tells_nobody(tab: AllPairsTab, desk: Desk, server: viser.ViserServer) -> None:
    run(tab)
    verdicts = desk.verdicts
    changes(tab, pair=("002", "001"))
    assert desk.verdicts is verdicts
    assert 'data-row="2" data-column="1"' in said(server)


def test_a_click_opens_its_pair(tab: AllPairsTab, desk: Desk) -> None:
    run(tab)

    def click(picture: str, **data: object) -> None:
        html_says(desk.bridge, picture, **data)

    click("matrix", name="all", row=2.0, column=1.0)
    assert shown(desk) == ("002", "001")
    click("matrix", name="all", row=0.0, column=3.0)  # above the diagonal
    assert shown(desk) == ("003", "000")
    click(OPEN_PAIR, query="001", database="000")
    assert shown(desk) == ("001", "000")
    before = desk.state
    for wrong in (
        {"name": "block", "row": 0.0, "column": 0.0},
        {"name": "all", "row": 0.5, "column": 0.0},
        {"name": "all", "row": "2", "column": 1.0},
        {"name": "all", "row": True, "column": 0.0},
        {"name": "all", "row": 9e9, "column": 1.0},
        {},
    ):
        click("matrix", **wrong)
    for half in ({"query": "001"}, {"query": 1.0, "database": "000"}):
        click(OPEN_PAIR, **half)
    assert desk.state is before
    click(OPEN_PAIR, query="gone", database="000")  # of another dataset
    assert shown(desk) == ("001", "000")


def test_a_drawn_threshold_is_taken(
    tab: AllPairsTab, desk: Desk, server: viser.ViserServer
) -> None:
    run(tab)
    html_says(desk.bridge, "threshold", score=0.512)
    assert desk.state.params.closure.min_score == 0.5
    assert desk.state.params.map == STATE.params.map
    assert rests(tab)
    assert "5 loop closures in 6 pairs" in said(server)
    assert "(0.5)" in tab.html["threshold"].content
    before = desk.state
    for wrong in (-1.0, 1e12, "3", True, None):
        html_says(desk.bridge, "threshold", score=wrong)
    assert desk.state is before


def test_another_dataset_forgets_what_was_found_and_ends_what_runs(
    tab: AllPairsTab, desk: Desk, server: viser.ViserServer, comparer: Comparer
) -> None:
    run(tab)
    comparer.go.clear()
    user_presses(find(server, "Run all pairs"))
    other: ViewState = open_dataset(make_dataset(), PipelineParams())
    go_to(desk, other)
    assert rests(tab)
    assert " in 6 pairs" not in said(server)
    assert "affinity" not in said(server)


def test_why_a_pair_was_looked_at_is_shown(
    tab: AllPairsTab, desk: Desk, server: viser.ViserServer, comparer: Comparer
) -> None:
    run(tab)
    assert comparer.candidates == "automatic"
    assert tab.html["reasons"].content == ""  # all were compared
    user_sets(find(server, "Compare with"), "the 10 best")
    run(tab)
    assert comparer.candidates == 10
    shown = tab.html["reasons"].content
    assert "Why was this pair looked at?" in shown
    assert f"{STATE.database_id} is number 2 among the candidates" in shown
    assert "another &lt;one&gt;" in shown
    other = next(name for name in SHORTLISTS if name not in (STATE.query_id, STATE.database_id))
    go_to(desk, with_pair(STATE, query_id=STATE.query_id, database_id=other))
    assert rests(tab)
    assert (
        f"{other} is not among them, so this pair was not compared" in tab.html["reasons"].content
    )


def test_pairs_are_shown_as_they_are_decided_and_a_cancelled_run_stays_and_resumes(
    tab: AllPairsTab, desk: Desk, server: viser.ViserServer, comparer: Comparer
) -> None:
    comparer.at_once = 4
    comparer.go.clear()
    button = find(server, "Run all pairs")
    user_presses(button)
    # The curve is the last to be filled: a test that waits for the summary may look too soon.
    until(lambda: "recall" in tab.html["curve"].content, "the first four")
    assert "in 4 pairs: " in said(server)
    assert "2 are still to come" in said(server)
    assert "affinity" in tab.html["matrix"].content
    assert "Parameters of this run: method gradient, compared with automatic" in said(server)
    frozen = f"map.length_scale {STATE.given.map.length_scale:.4g}"
    assert frozen in said(server)
    smoother = replace(STATE.params, map=replace(STATE.params.map, length_scale=0.5))
    go_to(desk, with_params(STATE, smoother))
    uses(tab, "Cancel")
    assert frozen in said(server)  # what moved since is not part of the run
    assert "in 4 pairs: " in said(server)
    assert "starts anew (4 of 6 pairs" in said(server)
    assert button.label == "Run all pairs"
    go_to(desk, STATE)
    assert button.label == "Resume (4 of 6 pairs done)"
    assert "starts anew" not in said(server)
    comparer.go.set()
    user_presses(button)
    assert rests(tab)
    assert comparer.num_known == 4
    assert "in 6 pairs: " in said(server)
    assert button.label == "Run all pairs"


def test_with_other_parameters_a_run_starts_anew(
    tab: AllPairsTab, server: viser.ViserServer, comparer: Comparer
) -> None:
    comparer.at_once = 4
    comparer.go.clear()
    user_presses(find(server, "Run all pairs"))
    until(lambda: hasattr(comparer, "run"), "the run")
    uses(tab, "Cancel")
    user_sets(find(server, "Compare with"), "the 10 best")
    before, comparer.at_once = comparer.run, 0
    comparer.go.set()
    run(tab)
    assert comparer.run is not before
    assert comparer.num_known == 0


def test_the_matrix_beside_a_picture(tab: AllPairsTab, desk: Desk) -> None:
    board = tab.html["board"]
    html_says(desk.bridge, "board")  # without pairs, these are compared
    assert rests(tab)
    assert desk.now.board
    assert 'data-testid="affinity-board"' in board.content
    assert 'data-asks="1" ' in board.content
    assert "by hand" not in board.content
    desk.decide(lambda decisions: with_verdict(decisions, ("002", "001"), True))
    assert rests(tab)
    assert 'data-by-hand="1"' in board.content
    html_says(desk.bridge, "matrix", name="board", row=2, column=0)
    assert shown(desk) == ("002", "000")
    uses(tab, "Matrix beside the picture")
    assert "affinity" not in board.content
