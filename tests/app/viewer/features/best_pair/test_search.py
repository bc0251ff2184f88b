"""What a session does of itself when a dataset opens on no loop closure."""

import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import viser

from app.viewer.features.best_pair import search as search_module
from app.viewer.features.pair import tab as pair_module
from app.viewer.features.session import Session
from app.viewer.session.runner import Capacity
from app.viewer.session.session_file import Opened, SavedSession
from app.viewer.session.state import ViewState
from gpgrad_core.detection import PairResult
from gpgrad_core.errors import InputError
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.support.synthetic import NUMBERS, FakePipeline, make_compared, make_result, make_submap
from tests.support.widgets import find, html_says, said, user_presses, user_sets

PLACES = ((0.0, 0.0), (2.0, 0.0), (12.0, 0.0), (12.0, 9.0), (0.8, 0.8), (0.1, 0.0), (12.0, 1.0))
DATASET = Dataset(
    "loop",
    tuple(make_submap(f"{k:03d}", SE2(x, y, 0.1 * k)) for k, (x, y) in enumerate(PLACES)),
)
OPENED = ("005", "000")
Judge = Callable[[str, str], float | None]


def scored(scores: dict[tuple[str, str], float]) -> Callable[[ViewState], PairResult]:
    """Make results in which only some pairs are loop closures."""

    def make(state: ViewState) -> PairResult:
        result = make_result(state)
        score = scores.get((state.query_id, state.database_id), 0.0)
        registration = replace(result.registration, score=score)
        closure = replace(
            result.closure, registration=registration, accepted=score > 3, reason="as told"
        )
        return replace(result, registration=registration, closure=closure)

    return make


class Held:
    """Holds the scoring of pairs until a test lets it go."""

    def __init__(self, pipeline: FakePipeline) -> None:
        self.free, self.begun, self.pipeline = threading.Event(), threading.Event(), pipeline

    def __call__(self, *args: Any, **named: Any) -> PairResult:
        self.begun.set()
        while not self.free.wait(0.01):
            args[4](0.5)  # its progress, which may raise
        return self.pipeline(*args, **named)


@pytest.fixture
def begin(
    monkeypatch: pytest.MonkeyPatch, server: viser.ViserServer
) -> Iterator[Callable[..., tuple[Session, Held]]]:
    sessions: list[Session] = []

    def start(
        scores: dict[tuple[str, str], float],
        dataset: Dataset = DATASET,
        saved: SavedSession | None = None,
    ) -> tuple[Session, Held]:
        pipeline = FakePipeline(scored(scores))
        held = Held(pipeline)
        monkeypatch.setattr(pair_module, "register_pair", pipeline)
        monkeypatch.setattr(search_module, "register_pair", held)
        made = Session(server, Opened(dataset, NUMBERS, "", saved, NUMBERS), Memo(), Capacity())
        sessions.append(made)
        return made, held

    yield start
    for session in sessions:
        session.close()


def note(session: Session) -> str:
    return said(session.desk.host, "best-pair")


def pair(session: Session) -> tuple[str, str]:
    return session.state.query_id, session.state.database_id


def page_says(session: Session, name: str, **data: object) -> None:
    html_says(session.desk.bridge, name, **data)


CLOSURES = {("004", "000"): 5.0, ("005", "001"): 7.0, ("006", "002"): 9.0}


@pytest.mark.slow
def test_it_switches_to_the_best_closure_and_says_so(
    begin: Callable[..., tuple[Session, Held]],
) -> None:
    session, held = begin(CLOSURES)
    assert held.begun.wait(120)
    assert pair(session) == OPENED
    assert "This pair is no loop closure" in note(session)
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == ("006", "002")
    assert "Switched to 006 → 002, the best loop closure so far" in note(session)
    assert "005 → 000, with which the dataset opened, is none" in note(session)
    assert "006 \\u2192 002 \\u00b7 loop" in said(session.desk.host)  # the page's title
    page_says(session, "show-pair", query="005", database="000")
    assert session.wait_idle(120)
    assert pair(session) == OPENED  # and it stays there
    assert note(session) == ""


def test_it_does_nothing_where_the_first_pair_is_a_closure(
    begin: Callable[..., tuple[Session, Held]],
) -> None:
    session, held = begin({OPENED: 4.0, **CLOSURES})
    assert session.wait_idle(120)
    assert not held.begun.is_set()
    assert pair(session) == OPENED
    assert note(session) == ""


def test_it_says_that_nothing_was_found(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin({})
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == OPENED
    assert "No loop closure so far" in note(session)
    page_says(session, "close-note")
    assert note(session) == ""


@pytest.mark.slow
@pytest.mark.parametrize("act", ["slider", "touch", "all pairs", "pair"])
def test_it_never_switches_once_somebody_has_acted(
    begin: Callable[..., tuple[Session, Held]], act: str
) -> None:
    session, held = begin(CLOSURES)
    assert held.begun.wait(120)
    if act == "slider":
        user_sets(find(session.desk.host, "Minimum inliers"), 3)  # type: ignore[arg-type]
    elif act == "touch":
        (number,) = re.findall(r"\)\((\d+)\)\s*\"", note(session))
        page_says(session, "touched", number=int(number) - 1)  # of an older search
        assert "being scored" in note(session)
        page_says(session, "touched", number=int(number))
    elif act == "all pairs":
        session.desk.tell(lambda feature: feature.comparing(0.0, ""))
    else:
        session.desk.change(pair=("003", "001"))
    expected = ("003", "001") if act == "pair" else OPENED
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == expected
    assert note(session) == ""


@pytest.mark.slow
def test_a_saved_session_opens_as_it_was_saved(begin: Callable[..., tuple[Session, Held]]) -> None:
    saved = SavedSession(query_id="003", database_id="001")
    session, held = begin(CLOSURES, saved=saved)
    assert session.wait_idle(120)
    assert not held.begun.is_set()
    assert pair(session) == ("003", "001")


def test_another_dataset_is_searched_anew(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin(CLOSURES)
    assert held.begun.wait(120)
    held.begun.clear()
    session.desk.open(Opened(replace(DATASET, name="again"), NUMBERS, "", None, NUMBERS))
    held.free.set()
    assert session.wait_idle(120)
    assert held.begun.is_set()
    assert pair(session) == ("006", "002")


def test_what_goes_wrong_is_told(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin(CLOSURES)
    assert held.begun.wait(120)
    held.pipeline.error = InputError("003 spans 10 km")
    held.free.set()
    assert session.wait_idle(120)
    assert "could not be scored: 003 spans 10 km" in note(session)


def test_the_best_of_all_pairs_is_shown_when_asked(
    begin: Callable[..., tuple[Session, Held]],
) -> None:
    compared = make_compared()
    session, _ = begin({OPENED: 4.0, ("003", "000"): 4.0}, dataset=compared.dataset)
    assert session.wait_idle(120)
    button: Any = find(session.desk.host, "Show best")  # type: ignore[arg-type]
    assert button.disabled
    accepted = tuple(
        replace(closure, accepted=closure.registration.score >= 3)
        for closure in compared.result.closures
    )
    session.desk.change(pair=("002", "001"))
    session.desk.tell(lambda feature: feature.judged(compared.dataset, accepted))
    assert not button.disabled
    user_presses(button)
    assert session.wait_idle(120)
    assert pair(session) == ("003", "000")
