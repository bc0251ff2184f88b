"""The paper's method in a session: its parameters, its card, and what other tools make of it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import viser

from app.viewer.features.pair.verdict import figures_of, in_words, verdict_html
from app.viewer.features.pairs.model import PairsRun
from app.viewer.features.save.tab import write_report
from app.viewer.features.session import Session
from app.viewer.session.jobs import Capacity
from app.viewer.session.methods import METHODS
from app.viewer.session.session_file import (
    Opened,
    address_of,
    detect_command,
    parse_session,
    read_address,
    session_text,
)
from app.viewer.session.state import ViewState, open_dataset, with_method, with_pair, with_params
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.records.closures import Decision
from gpgrad_core.methods.paper import PaperPair, paper_params, register_paper_pair
from gpgrad_core.params import with_path
from gpgrad_core.run import silent
from gpgrad_core.run.memo import Memo
from tests.support.desk import uses
from tests.support.synthetic import make_dataset
from tests.support.widgets import find, said, user_presses, user_sets

DATASET = make_dataset(num_points=250)
GIVEN = with_path(PipelineParams(), "map.resolution", 0.1)
STATE = open_dataset(DATASET, GIVEN, source="/data/hills")
PAPER = with_method(STATE, "paper")
MEMO = Memo()


def resolved(state: ViewState) -> ViewState:
    used = METHODS[state.method].resolve(DATASET.submaps, state.query, state.asked, MEMO, silent)
    return replace(state, params=used, resolved=True)


def register(state: ViewState) -> PaperPair:
    return register_paper_pair(*state.pair, state.given, MEMO)


@pytest.fixture
def session(server: viser.ViserServer) -> Iterator[Session]:
    made = Session(server, Opened(DATASET, GIVEN, "/data/hills"), MEMO, Capacity())
    yield made
    made.close()


def test_each_method_keeps_its_own_parameters() -> None:
    assert PAPER.asked == paper_params(GIVEN)
    set_by_hand = with_params(STATE, with_path(GIVEN, "closure.min_inliers", 9))
    paper = with_method(set_by_hand, "paper")
    assert paper.asked.closure.min_inliers == 5
    changed = with_params(paper, with_path(paper.asked, "map.length_scale", 0.7))
    back = with_method(changed, "gradient")
    assert (back.asked, back.params) == (set_by_hand.asked, set_by_hand.params)
    assert with_method(back, "paper").asked.map.length_scale == 0.7


def test_the_fit_of_another_query_is_another_one() -> None:
    first = resolved(PAPER)
    other = with_pair(first, query_id=first.database_id)
    assert not other.resolved
    assert resolved(other).params.map.length_scale != first.params.map.length_scale
    assert resolved(other).given.map.length_scale is None  # each submap has its own


def test_links_files_and_commands_carry_the_method() -> None:
    state = with_params(PAPER, with_path(PAPER.asked, "matching.ratio", 0.8))
    link = read_address(address_of(state))
    saved = parse_session(session_text(state, None), "a file")
    for kept in (link, saved):
        assert (kept.method, kept.params) == ("paper", state.asked)
        again = kept.apply(STATE)
        assert (again.method, again.asked) == ("paper", state.asked)
    assert "matching.ratio=0.8" in address_of(state)
    assert "--method paper" in detect_command(state)
    assert "--matching.ratio 0.8" in detect_command(state)
    assert "--closure" not in detect_command(state)
    assert "method" not in address_of(STATE) + session_text(STATE, None) + detect_command(STATE)
    assert read_address("query=003&database=000").method == "gradient"
    with pytest.raises(InputError, match="'method' must be gradient or paper, got 'sift'"):
        read_address("method=sift")


def test_the_card_says_n_h_and_the_fit_of_each_submap() -> None:
    result, state = register(PAPER), resolved(PAPER)
    rows = {row.name: row for row in figures_of(state, result)}
    assert rows["inliers n"].text.startswith(f"{result.registration.num_inliers} (at least 5)")
    assert "no limit" in rows["h"].text
    assert "query" in rows["length-scale"].text
    assert "database" in rows["noise"].text
    assert "Inliers n" in verdict_html(state, result)
    assert "gradients differ by h" in verdict_html(state, result).lower()
    tight = with_params(state, with_path(state.asked, "closure.max_dissimilarity", 1.0))
    refused = register(tight)
    assert not refused.closure.accepted
    if refused.registration.num_inliers >= 5:
        assert "(h)" in in_words(tight, refused)
    assert "at most 1" in {row.name: row.text for row in figures_of(tight, refused)}["h"]
    given = with_params(state, with_path(state.asked, "map.length_scale", 0.5))
    own = {row.name: row.text for row in figures_of(given, register(given))}
    assert own["length-scale"] == "50 cm, as it is set"


@pytest.mark.slow
def test_the_panel_runs_the_chosen_method(session: Session, server: viser.ViserServer) -> None:
    assert session.wait_idle(120)
    by_gradient = session.state
    assert find(server, "Minimum score").visible
    uses(session, "Method", "paper")
    state = session.state
    assert state.method == "paper"
    assert state.resolved
    assert "Inliers n" in said(server, "card")
    assert not find(server, "Minimum score").visible
    assert not find(server, "Fit to these submaps").visible
    uses(session, "no limit on h", False)
    uses(session, "Maximum h", 1.0)
    assert "at most 1" in said(server, "figures")
    user_presses(find(server, "Undo"))
    user_presses(find(server, "Undo"))
    assert find(server, "Length-scale per submap").value
    assert find(server, "Length-scale [m]").value == pytest.approx(state.params.map.length_scale)
    user_sets(find(server, "Minimum inliers"), 12)
    user_presses(find(server, "Undo"))
    assert session.state.asked.closure.min_inliers == 5
    user_presses(find(server, "Undo"))
    assert (session.state.method, session.state.params) == ("gradient", by_gradient.params)
    user_presses(find(server, "Redo"))
    assert session.state.method == "paper"
    user_presses(find(server, "Reset parameters"))
    assert session.state.asked == paper_params(GIVEN)
    assert session.wait_idle(120)


def test_all_pairs_are_kept_for_each_method(session: Session, server: viser.ViserServer) -> None:
    uses(session, "Method", "paper")
    uses(session, "Run all pairs")
    assert "method paper" in said(server)
    user_sets(find(server, "Method"), "gradient")
    assert "method paper" not in said(server)
    uses(session, "Method", "paper")
    assert "method paper" in said(server)


def test_a_limit_on_h_needs_new_registrations_and_one_on_n_does_not() -> None:
    run = PairsRun(PAPER)
    assert run.is_of(PAPER)
    assert not run.is_of(STATE)
    for path, value, alike in (
        ("closure.min_inliers", 9, True),
        ("closure.max_dissimilarity", 1e9, False),
    ):
        changed = with_params(PAPER, with_path(PAPER.asked, path, value))
        assert run.is_of(changed) == alike


@pytest.mark.slow
def test_the_report_tells_the_method(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(resolved(PAPER), MEMO, "", Decision(), path, silent)
    page = path.read_text()
    assert "The method is paper" in page
    assert "inliers n" in page
    assert "--method paper" in page
