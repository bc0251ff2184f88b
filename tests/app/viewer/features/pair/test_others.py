"""The card of a pair, once all pairs were compared: the others speak there as they do elsewhere."""

from dataclasses import replace
from html import escape

import numpy as np
import pytest

from app.viewer.features.pairs import all_pairs as all_pairs_module
from app.viewer.features.pairs.model import RULES, JudgedPairs, PairsRun
from app.viewer.features.pairs.model import judge as judge_all
from app.viewer.features.session import Session
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState, open_dataset
from gpgrad_core.detection import PairResult, Pairs
from gpgrad_core.detection.verdict import ClosureParams, classify
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Agreement, Registration
from tests.support.desk import changes, uses
from tests.support.synthetic import NUMBERS, FakePipeline, make_dataset, make_result
from tests.support.widgets import said

DATASET = make_dataset(num_points=400)
ALONE = "Judged alone: All pairs asks the others."


def registration(query: str, database: str) -> Registration:
    """Make neighbours with high scores, a weak closure, and one that leads a spacing too far."""
    poses = [DATASET.submap(name).pose_odometry for name in (database, query)]
    assert poses[0] is not None
    assert poses[1] is not None
    motion, score = poses[0].planar.inverse() @ poses[1].planar, 6.0
    if {query, database} == {"003", "000"}:
        score = 2.2
    if {query, database} == {"002", "000"}:
        motion, score = SE2(8.0, 0.0, 0.0) @ motion, 4.0
    if {query, database} == {"003", "001"}:
        score = 0.5
    return Registration(
        motion, np.zeros(17, bool), 0.5, 50.0, 0.93, score,
        covariance=np.diag([0.02**2, 0.02**2, 0.003**2]),
        scale=0.3, agreement=Agreement(0.008, 0.01, 0.15),
    )  # fmt: skip


def judged_alone(state: ViewState) -> PairResult:
    """Stand in for the pipeline."""
    own = registration(state.query_id, state.database_id)
    verdict = classify(
        own, state.params.closure, query_id=state.query_id, database_id=state.database_id
    )
    return replace(make_result(state), registration=own, closure=verdict)


def compared() -> PairsRun:
    ids = [submap.id for submap in DATASET.submaps]
    found = {
        (query, database): registration(query, database)
        for k, query in enumerate(ids)
        for database in ids[:k]
    }
    pairs = Pairs.of(DATASET.submaps, found, NUMBERS)
    pairs.seconds = {"total": 1.0}
    return PairsRun(open_dataset(DATASET, NUMBERS), "all", found, None, pairs, has_ended=True)


def verdicts(thresholds: ClosureParams) -> JudgedPairs:
    """Judge all pairs as the tab All pairs and a file of closures do."""
    return judge_all(compared(), thresholds, next(iter(RULES.values())))


OPENED = Opened(DATASET, NUMBERS, "", None, NUMBERS)


@pytest.fixture(autouse=True)
def stand_ins(pipeline: FakePipeline, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in for the pipeline, of one pair and of all."""
    pipeline.make = judged_alone
    made = compared()

    def compare(run: PairsRun, *_: object) -> None:
        run.table, run.has_ended = made.table, True

    monkeypatch.setattr(all_pairs_module, "compare_pairs", compare)


def card(session: Session, query: str, database: str) -> str:
    changes(session, pair=(query, database))
    return texts(session)


def texts(session: Session) -> str:
    """Read the card and the figures below it."""
    return "".join(said(session.desk.host, part) for part in ("card", "figures"))


def run_all_pairs(session: Session) -> None:
    uses(session, "Run all pairs")


def test_until_all_pairs_were_compared_a_pair_is_judged_alone(session: Session) -> None:
    weak = card(session, "003", "000")
    assert "No loop closure" in weak
    assert ALONE in weak
    wrong = card(session, "002", "000")
    assert "No loop closure" not in wrong
    assert "other pairs" not in wrong


def test_then_the_others_raise_and_lower_scores(session: Session) -> None:
    card(session, "003", "000")
    run_all_pairs(session)
    supported = texts(session)
    assert "No loop closure" not in supported  # the pair that was shown is judged once more
    assert "Other closures lead to the same motion (score 2.2 alone, 3.3 with them)." in supported
    assert "raise the score 2.2 to 3.3" in supported
    assert "Judged alone" not in supported
    repeated = card(session, "002", "000")
    assert "No loop closure" in repeated
    assert "This ground repeats: 2 places fit" in repeated
    assert "lower the score 4.0 to" in repeated


def test_the_card_says_of_each_pair_what_all_pairs_says(session: Session) -> None:
    run_all_pairs(session)
    pairs = verdicts(session.state.params.closure).closures
    assert {closure.accepted for closure in pairs} == {True, False}
    for closure in pairs:
        html = card(session, closure.query_id, closure.database_id)
        assert ("No loop closure" not in html) == closure.accepted
        assert f"Score {closure.registration.score:.1f}" in html
        assert f'title="{escape(closure.reason)}"' in html


def test_thresholds_are_followed_and_other_parameters_are_judged_alone(session: Session) -> None:
    run_all_pairs(session)
    assert "No loop closure" not in card(session, "003", "000")

    def closure_of(**limits: object) -> str:
        thresholds = replace(NUMBERS.closure, **limits)  # type: ignore[arg-type]
        changes(session, params=replace(NUMBERS, closure=thresholds))
        return texts(session)

    assert "No loop closure" in closure_of(min_score=3.9)
    off = closure_of(others="off")
    assert "Score 2.2" in off
    assert "Judged alone" not in off  # there is nobody to be asked
    changes(session, params=replace(NUMBERS, map=replace(NUMBERS.map, noise_std=0.03)))
    assert ALONE in texts(session)


def test_the_other_way_round_the_pair_is_judged_alone(session: Session) -> None:
    run_all_pairs(session)
    assert "Judged alone: swap the two to ask others." in card(session, "000", "003")
