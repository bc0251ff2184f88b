"""Cameras follow what is shown, unless they were moved by hand; on pages that are no browsers."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.features import canvas as framing_module
from app.viewer.features import links as links_module
from app.viewer.features import modes as modes_module
from app.viewer.features.session import Session
from app.viewer.scene.cameras import view_of
from app.viewer.scene.placement import Canvas
from app.viewer.session.news import PairOutdated
from app.viewer.session.session_file import Opened
from app.viewer.session.state import Camera
from tests.support.desk import changes
from tests.support.page import FakePage
from tests.support.synthetic import make_dataset, needing
from tests.support.widgets import html_says, press_key, said

WIDE, TALL = Canvas(1280.0, 1000.0), Canvas(640.0, 900.0)
DATASET = make_dataset(300)


OPENED = Opened(DATASET, needing(8), "/data/set", None, needing(8))


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> dict[int, Any]:
    """The pages that the session believes to be open."""
    open_pages: dict[int, Any] = {}
    for module in (framing_module, links_module, modes_module):
        monkeypatch.setattr(module, "pages", lambda _: open_pages)
    return open_pages


@pytest.fixture
def arrive(session: Session, pages: dict[int, Any]) -> Callable[..., FakePage]:
    session.pair.scene.tall = False

    def come(canvas: Canvas = WIDE, link: str = "") -> FakePage:
        made = FakePage()
        pages[len(pages)] = made
        resize(session, made, canvas)
        html_says(session.desk.bridge, "arrived", made, text=link)
        assert session.wait_idle(120)
        return made

    return come


def move(page: FakePage) -> Camera:
    """Move its camera by hand."""
    page.camera.position = (7.0, -7.0, 30.0)
    return view_of(page)


def resize(session: Session, page: FakePage, canvas: Canvas) -> None:
    html_says(session.desk.bridge, "canvas", page, **vars(canvas))
    assert session.wait_idle(120)


def test_a_page_that_comes_sees_all(session: Session, arrive: Callable[..., FakePage]) -> None:
    page = arrive()
    assert view_of(page) == session.pair.scene.camera(session.state, WIDE)
    captions = [text for text in page.scripts if '"caption"' in text]
    assert f"Query {session.state.query_id}" in captions[-1]
    assert "Loop closure" in captions[-1]
    assert "score" in captions[-1]
    assert any('"camera"' in text and '"share"' in text for text in page.scripts)


def test_the_camera_follows_layout_pair_and_size_until_it_is_moved_by_hand(
    gui: viser.ViserServer, session: Session, arrive: Callable[..., FakePage]
) -> None:
    page = arrive()
    apart = view_of(page)
    changes(session, options=replace(session.state.options, layout="registered"))
    together = view_of(page)
    assert together != apart
    resize(session, page, replace(WIDE, width=1000.0))
    assert view_of(page) not in (apart, together)
    by_hand = move(page)
    changes(session, params=needing(9))
    resize(session, page, WIDE)
    assert view_of(page) == by_hand
    press_key(gui, "R", page=page)
    assert view_of(page) == together
    move(page)
    changes(session, pair=("002", "000"))
    assert view_of(page) == session.pair.scene.camera(session.state, WIDE)


def test_the_camera_follows_a_query_that_turns_until_it_is_moved_by_hand(
    session: Session, arrive: Callable[..., FakePage]
) -> None:
    page = arrive()
    turned = view_of(page)
    raw = replace(session.state.options, raw_frames=True)
    changes(session, options=raw)
    assert view_of(page) == session.pair.scene.camera(session.state, WIDE) != turned
    captions = [text for text in page.scripts if '"caption"' in text]
    assert "frame of the database" in captions[0]
    assert "frame of the database" not in captions[-1]
    assert "Gradient (steepness) [m/m]" in captions[-1]  # the colours' legend
    by_hand = move(page)
    changes(session, options=replace(raw, raw_frames=False))
    assert view_of(page) == by_hand


def test_full_screen_keeps_the_side(session: Session, arrive: Callable[..., FakePage]) -> None:
    page = arrive()
    before = move(page)
    session.desk.update(lambda now: replace(now, left_away=not now.left_away))
    resize(session, page, Canvas(1900.0, 1000.0))
    after = view_of(page)
    assert after != before
    directions = [np.subtract(view.look_at, view.position) for view in (before, after)]
    units = [direction / np.linalg.norm(direction) for direction in directions]
    np.testing.assert_allclose(units[0], units[1], atol=1e-6)


def test_no_perspective_from_above(gui: viser.ViserServer, arrive: Callable[..., FakePage]) -> None:
    page = arrive()
    before = view_of(page)
    press_key(gui, "T", page=page)
    above = view_of(page)
    assert above.parallel
    assert np.hypot(*above.sight[:2]) < 0.01 * -above.sight[2]
    assert above.distance > 10 * before.distance
    press_key(gui, "R", page=page)
    assert view_of(page) == before


def test_a_tall_canvas_has_them_behind(session: Session, arrive: Callable[..., FakePage]) -> None:
    first = arrive(TALL)
    assert session.pair.scene.tall
    assert view_of(first) == session.pair.scene.camera(session.state, TALL)
    arrive(WIDE)
    assert session.pair.scene.tall
    resize(session, first, WIDE)
    assert not session.pair.scene.tall


def test_the_camera_tells_a_shape(session: Session, arrive: Callable[..., FakePage]) -> None:
    page = arrive(TALL)
    page.camera.aspect = 2.0
    session.desk.canvases.measure(page)
    assert session.wait_idle(120)
    assert not session.pair.scene.tall
    assert session.desk.canvases.of(page).aspect == pytest.approx(2.0)


def test_a_caption_goes_out_of_date(session: Session, arrive: Callable[..., FakePage]) -> None:
    page = arrive()
    session.desk.notify(lambda feature: feature.on_pair_result(PairOutdated()))
    assert "Out of date" in [text for text in page.scripts if '"caption"' in text][-1]
    session.desk.tell_again()
    assert session.wait_idle(120)
    assert "Out of date" not in [text for text in page.scripts if '"caption"' in text][-1]


# Links: pages that come with an address.


def test_a_link_shows_the_same(session: Session, arrive: Callable[..., FakePage]) -> None:
    page = arrive(
        link="dataset=/data/set&query=002&database=000&view.layer=gradient"
        "&params.closure.min_inliers=5&camera=1,-9,12,0,0,0"
    )
    state = session.state
    assert (state.query_id, state.database_id) == ("002", "000")
    assert state.options.layer == "gradient"
    assert state.params.closure.min_inliers == 5
    assert view_of(page) == Camera((1.0, -9.0, 12.0), (0.0, 0.0, 0.0))
    resize(session, page, replace(WIDE, width=1100.0))
    assert view_of(page) == Camera((1.0, -9.0, 12.0), (0.0, 0.0, 0.0))
    addresses = [text for text in page.scripts if '"address"' in text]
    assert "query=002" in addresses[-1]
    assert "camera=1,-9,12,0,0,0" in addresses[-1]


def test_a_page_that_joins_is_told(session: Session, arrive: Callable[..., FakePage]) -> None:
    arrive()
    before = session.state
    same = f"dataset=/data/set&query={before.query_id}&database={before.database_id}"
    late = arrive(link=f"{same}&view.layer=gradient")
    assert session.state is before
    assert "joined" in late.notes[-1]


def test_a_page_joins_from_where_its_link_looks(arrive: Callable[..., FakePage]) -> None:
    first = arrive(link="dataset=/data/set&query=002&database=000")
    seen = view_of(first)
    late = arrive(link="dataset=/data/set&query=002&database=000&camera=1,-9,12,0,0,0")
    assert view_of(late) == Camera((1.0, -9.0, 12.0), (0.0, 0.0, 0.0))
    assert view_of(first) == seen


def test_a_page_goes_to_a_link_and_back(session: Session, arrive: Callable[..., FakePage]) -> None:
    links = "dataset=/data/set&query=002&database=000", "dataset=/data/set&query=003&database=001"
    page = arrive(link=links[0])
    seen = view_of(page)
    for link in (f"{links[1]}&scene=world", links[1], links[0]):
        move(page)
        html_says(session.desk.bridge, "asked", page, text=link)
        assert session.wait_idle(20)
        assert session.state.query_id == link.partition("query=")[2][:3]
        assert session.pair.scene.visible == ("world" not in link)
    assert view_of(page) == seen
    html_says(session.desk.bridge, "asked", page, text="dataset=/data/set&query=999")
    assert session.wait_idle(20)
    addresses = [text for text in page.scripts if '"address"' in text]
    assert "query=002&database=000" in addresses[-1]  # over the one that cannot be opened


@pytest.mark.parametrize("text", ["query=999", "nonsense", "params.map.length_scale=-3"])
def test_a_link_that_cannot_be_opened_says_why(
    session: Session, arrive: Callable[..., FakePage], text: str
) -> None:
    before = session.state
    page = arrive(link=text if "=" not in text else f"dataset=/data/set&{text}")
    assert session.state.params == before.params
    assert session.state.query_id == before.query_id
    assert "cannot be opened" in page.notes[-1]


def test_another_dataset_is_opened_as_a_saved_session_is(
    gui: viser.ViserServer, session: Session, arrive: Callable[..., FakePage]
) -> None:
    arrive(link="dataset=/nowhere/else&query=001")
    assert "/nowhere/else: no such file or folder" in said(gui, "dataset-error")
    assert session.state.source == "/data/set"
