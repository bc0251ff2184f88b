"""The strip that names the pair, without a browser."""

import json
from collections.abc import Callable
from dataclasses import replace
from html import unescape

import pytest
import viser

from app.viewer.features.chooser import MOST_LISTED, Chooser, find_ids
from app.viewer.features.desk import Desk
from app.viewer.features.session import Session
from app.viewer.session.news import Subject
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState, open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.types import Dataset
from tests.support.desk import Recorder, make_desk, rests
from tests.support.page import FakePage
from tests.support.synthetic import make_dataset, needing
from tests.support.waiting import until
from tests.support.widgets import html_says, press_key

STATE = open_dataset(make_dataset(300), PipelineParams())


@pytest.fixture
def chooser(desk: Desk) -> Chooser:
    return desk.join(Chooser(desk))


def many(count: int) -> Dataset:
    first = STATE.dataset.submaps[0]
    submaps = tuple(replace(first, id=f"m{k:04d}", fingerprint=f"{k}") for k in range(count))
    return replace(STATE.dataset, submaps=submaps)


def sent(page: FakePage, act: str) -> list[dict[str, object]]:
    """Give what a page was told under a name."""
    told = [script.partition(f'gpgrad.hear("{act}",')[2] for script in page.scripts]
    beside = [text.partition(f'data-told="{act}">')[2] for text in page.scripts]
    return [
        *(json.loads(text.removesuffix(")")) for text in told if text),
        *(json.loads(unescape(text.removesuffix("</i>")))[1] for text in beside if text),
    ]


def pair_of(desk: Desk) -> tuple[str, str]:
    return desk.state.query_id, desk.state.database_id


def test_a_page_is_told_the_pair_and_gets_both_pictures(desk: Desk, chooser: Chooser) -> None:
    page = FakePage()
    html_says(desk.bridge, "pair", page, act="here")
    prints = desk.state.query.fingerprint, desk.state.database.fingerprint
    assert sent(page, "pair")[-1] == {
        "shown": True,
        "query": "003",
        "database": "000",
        "count": 4,
        "pictures": dict(zip(("query", "database"), prints, strict=True)),
    }
    assert rests(chooser)
    html_says(desk.bridge, "pair", page, act="here")
    pictures = sent(page, "portraits")[-1]
    assert set(pictures) == set(prints)
    assert all(str(uri).startswith("data:image/png") for uri in pictures.values())


def test_another_dataset_of_the_same_name_has_pictures_of_its_own(
    desk: Desk, chooser: Chooser, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = FakePage()
    for module in ("features.chooser", "widgets.canvas"):
        monkeypatch.setattr(f"app.viewer.{module}.pages", lambda _: {0: page})

    def shown() -> list[object]:
        """Give what the page shows of both submaps by what it was sent, as its script does."""
        assert rests(chooser)
        keys = sent(page, "pair")[-1]["pictures"]
        known = {key: uri for data in sent(page, "portraits") for key, uri in data.items()}
        return [known[key] for key in keys.values()]  # type: ignore[attr-defined]

    html_says(desk.bridge, "pair", page, act="here")
    before = shown()
    dataset = desk.state.dataset
    swapped = dict(zip(("000", "003"), ("003", "000"), strict=True))
    submaps = [
        replace(dataset.submap(swapped.get(each.id, each.id)), id=each.id)
        for each in dataset.submaps
    ]
    params = PipelineParams()
    desk.open(Opened(replace(dataset, submaps=tuple(submaps)), params, "", None, params))
    html_says(desk.bridge, "pair-search", page, role="query", text="00")
    assert pair_of(desk) == ("003", "000")
    assert shown() == before[::-1]
    (listed,) = sent(page, "choices")
    assert listed["pictures"] == [each.fingerprint for each in submaps]


@pytest.mark.usefixtures("chooser")
def test_arrows_step_swap_and_choose_change_the_pair(desk: Desk) -> None:
    def says(**data: object) -> tuple[str, str]:
        html_says(desk.bridge, "pair", None, **data)
        return pair_of(desk)

    assert says(act="previous", role="query") == ("002", "000")
    assert says(act="next", role="database") == ("002", "001")
    assert says(act="next", role="database") == ("002", "003")  # 002 is the query, and passed over
    assert says(act="swap") == ("003", "002")
    assert says(act="choose", role="database", name="000") == ("003", "000")
    # Whoever names the other one of the pair has the two change places.
    assert says(act="choose", role="query", name="000") == ("000", "003")
    assert says(act="choose", role="query", name="02") == ("002", "003")  # what was typed
    for data in (
        {"act": "choose", "role": "query", "name": "9"},
        {"act": "choose", "role": "query", "name": "0" * 300},
        {"act": "leap", "role": "query"},
        {"act": "next", "role": "both"},
    ):
        assert says(**data) == ("002", "003")


@pytest.mark.usefixtures("chooser")
def test_a_search_is_answered_to_the_page_that_asks_alone(desk: Desk) -> None:
    page, other = FakePage(), FakePage()
    html_says(desk.bridge, "pair-search", page, role="query", text="3")
    assert sent(page, "choices") == [
        {
            "role": "query",
            "text": "3",
            "found": ["003"],
            "pictures": [desk.state.dataset.submap("003").fingerprint],
            "at": 0,
            "more": 0,
        }
    ]
    html_says(desk.bridge, "pair-search", page, role="database", text="no such")
    assert sent(page, "choices")[-1]["found"] == []
    assert other.scripts == []


def test_of_many_submaps_those_around_the_chosen_one_are_listed(server: viser.ViserServer) -> None:
    state = ViewState(many(300), "m0200", "m0001")
    desk = make_desk(server, state, Recorder())
    desk.join(Chooser(desk))
    page = FakePage()
    html_says(desk.bridge, "pair-search", page, role="query", text="")
    (answer,) = sent(page, "choices")
    found: list[str] = answer["found"]  # type: ignore[assignment]
    assert len(found) == MOST_LISTED
    assert found[int(str(answer["at"]))] == "m0200"
    assert answer["more"] == 300 - MOST_LISTED
    assert find_ids(state, "29")[0] == "m0029"
    assert find_ids(state, "M0299") == ["m0299"]


@pytest.mark.parametrize(
    ("subject", "full_screen", "shown"),
    [("pair", False, True), ("world", False, False), ("pair", True, False)],
)
@pytest.mark.usefixtures("chooser")
def test_it_stands_where_a_pair_and_the_panels_are(
    desk: Desk,
    subject: Subject,
    full_screen: bool,
    shown: bool,
) -> None:
    desk.update(lambda now: replace(now, subject=subject, full_screen=full_screen))
    page = FakePage()
    html_says(desk.bridge, "pair", page, act="here")
    assert sent(page, "pair")[-1]["shown"] is shown


def test_a_lone_submap_has_no_strip(server: viser.ViserServer) -> None:
    alone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    desk = make_desk(server, open_dataset(alone, PipelineParams()), Recorder())
    desk.join(Chooser(desk))
    page = FakePage()
    html_says(desk.bridge, "pair", page, act="here")
    html_says(desk.bridge, "pair", page, act="next")
    assert sent(page, "pair")[-1]["shown"] is False
    assert pair_of(desk) == ("000", "000")


def test_keys_and_strip_change_the_same_pair(
    open_session: Callable[..., Session],
    server: viser.ViserServer,
) -> None:
    session = open_session(make_dataset(300), needing(8))
    press_key(server, "J")
    html_says(session.desk.bridge, "pair", None, act="previous", role="query")
    until(lambda: session.state.query_id == "003", "the query of before")
    assert session.wait_idle(120)
