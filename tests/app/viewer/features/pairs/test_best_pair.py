"""Which pairs are likely, and what a session does when a dataset opens on no loop closure."""

import re
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.viewer.features.pairs import best_pair as search_module
from app.viewer.features.session import Session
from app.viewer.session.session_file import Opened, SavedSession
from app.viewer.session.state import ViewState
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult
from gpgrad_core.detection.choosing import overlapping_pairs, voted_pairs
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, Features, Submap
from tests.support.desk import judge
from tests.support.synthetic import (
    NUMBERS,
    FakePipeline,
    make_compared,
    make_dataset,
    make_result,
    make_submap,
)
from tests.support.widgets import find, html_says, said, user_presses, user_sets


def test_revisits_come_before_neighbours_and_the_largest_overlap_first() -> None:
    # Out along x and back, a little beside: 005 covers 000 nearly, and 004 covers 001 in part.
    places = ((0, 0), (2, 0), (4, 0), (16, 9), (3, 2), (0.3, 0.1))
    submaps = tuple(
        make_submap(f"{k:03d}", SE2(float(x), float(y), 0.5 * k)) for k, (x, y) in enumerate(places)
    )
    pairs = overlapping_pairs(Dataset("loop", submaps), 9)
    assert pairs[0] == ("005", "000")
    assert ("002", "000") in pairs  # on the way out
    assert pairs.index(("005", "001")) < pairs.index(("002", "000"))
    assert not any("003" in pair for pair in pairs)  # far away
    assert ("001", "000") not in pairs  # neighbours
    assert overlapping_pairs(Dataset("loop", submaps), 1) == pairs[:1]


def test_without_poses_nothing_overlaps() -> None:
    dataset = make_dataset()
    bare = tuple(replace(submap, pose_odometry=None) for submap in dataset.submaps)
    assert overlapping_pairs(Dataset("bare", bare), 5) == ()
    posed = (*bare[:3], dataset.submaps[3])
    assert overlapping_pairs(Dataset("one", posed), 5) == ()


def features(descriptors: Array, positions: Array) -> Features:
    ones = np.ones(len(positions))
    return Features(positions, ones, ones, 0 * ones, descriptors.astype(np.float32))


def test_without_poses_the_keypoints_vote() -> None:
    rng = np.random.default_rng(1)
    seen = {
        name: features(rng.normal(size=(60, 32)), rng.uniform(-3, 3, (60, 2)))
        for name in ("000", "001", "002", "003", "004")
    }
    turned = SE2(1.0, 2.0, 0.7).apply(seen["001"].positions)
    seen["004"] = replace(seen["001"], positions=turned)
    submaps = tuple(Submap.from_points(rng.normal(size=(9, 3)), name) for name in seen)
    told: list[float] = []
    pairs = voted_pairs(Dataset("plain", submaps), 2, lambda submap: seen[submap.id], told.append)
    assert pairs[0] == ("004", "001")
    assert len(pairs) == 2
    assert told[-1] == 1.0


PLACES = ((0.0, 0.0), (2.0, 0.0), (12.0, 0.0), (12.0, 9.0), (0.8, 0.8), (0.1, 0.0), (12.0, 1.0))
DATASET = Dataset(
    "loop",
    tuple(make_submap(f"{k:03d}", SE2(x, y, 0.1 * k), 300) for k, (x, y) in enumerate(PLACES)),
)
FIRST = ("005", "000")
OPENED = Opened(make_dataset(num_points=300), NUMBERS, "", None, NUMBERS)
"""What is open before a test begins, at a closure."""
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
    monkeypatch: pytest.MonkeyPatch, pipeline: FakePipeline, session: Session
) -> Callable[..., tuple[Session, Held]]:
    def start(
        scores: dict[tuple[str, str], float],
        dataset: Dataset = DATASET,
        saved: SavedSession | None = None,
    ) -> tuple[Session, Held]:
        pipeline.make = scored(scores)
        held = Held(pipeline)
        monkeypatch.setattr(search_module, "register_pair", held)
        session.desk.open(Opened(replace(dataset), NUMBERS, "", saved, NUMBERS))
        return session, held

    return start


def note(session: Session) -> str:
    return said(session.desk.host, "best-pair")


def pair(session: Session) -> tuple[str, str]:
    return session.state.query_id, session.state.database_id


def page_says(session: Session, name: str, **data: object) -> None:
    html_says(session.desk.bridge, name, **data)


CLOSURES = {("004", "000"): 5.0, ("005", "001"): 7.0, ("006", "002"): 9.0}


def test_it_switches_to_the_best_and_says_so(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin(CLOSURES)
    assert held.begun.wait(120)
    assert pair(session) == FIRST
    assert "This pair is no loop closure" in note(session)
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == ("006", "002")
    assert "Switched to 006 → 002, the best loop closure so far" in note(session)
    assert "005 → 000 is none." in note(session)
    assert "006 \\u2192 002 \\u00b7 loop" in said(session.desk.host)  # the page's title
    page_says(session, "show-pair", query="005", database="000")
    assert session.wait_idle(120)
    assert pair(session) == FIRST  # and it stays there
    assert note(session) == ""


def test_it_does_nothing_where_the_first_closes(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin({FIRST: 4.0, **CLOSURES})
    assert session.wait_idle(120)
    assert not held.begun.is_set()
    assert pair(session) == FIRST
    assert note(session) == ""


def test_it_says_that_nothing_was_found(begin: Callable[..., tuple[Session, Held]]) -> None:
    session, held = begin({})
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == FIRST
    assert "No loop closure so far" in note(session)
    page_says(session, "close-note")
    assert note(session) == ""


@pytest.mark.parametrize("act", ["slider", "touch", "all pairs", "pair"])
def test_it_never_switches_after_acts(begin: Callable[..., tuple[Session, Held]], act: str) -> None:
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
        session.desk.update_pairs(lambda pairs: pairs._replace(fraction=0.0))
    else:
        session.desk.change(pair=("003", "001"))
    expected = ("003", "001") if act == "pair" else FIRST
    held.free.set()
    assert session.wait_idle(120)
    assert pair(session) == expected
    assert note(session) == ""


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


def test_the_best_of_all_is_shown_when_asked(begin: Callable[..., tuple[Session, Held]]) -> None:
    compared = make_compared()
    session, _ = begin({FIRST: 4.0, ("003", "000"): 4.0}, dataset=compared.dataset)
    assert session.wait_idle(120)
    button: Any = find(session.desk.host, "Show best")  # type: ignore[arg-type]
    assert button.disabled
    assert compared.table is not None
    accepted = tuple(compared.table.judge(ClosureParams(min_score=3.0, others="off")))
    session.desk.change(pair=("002", "001"))
    judge(session.desk, accepted)
    assert not button.disabled
    user_presses(button)
    assert session.wait_idle(120)
    assert pair(session) == ("003", "000")
