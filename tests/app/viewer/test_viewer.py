import gc
import socket
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.exceptions import InvalidStatus

from app.viewer import viewer as viewer_module
from app.viewer.features.pair import tab as pair_module
from app.viewer.server.host import ALONE, on_scene_click
from app.viewer.session.decisions import with_verdict
from app.viewer.session.session_file import Opened
from app.viewer.viewer import OpeningProgress, Sharing, Viewer
from gpgrad_core.errors import InputError
from gpgrad_core.run.memo import Memo
from tests.support.page import ProtocolPage
from tests.support.synthetic import FakePipeline, make_dataset, needing
from tests.support.waiting import until

Serve = Callable[..., Viewer]
DATASET = make_dataset(num_points=300)


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Serve]:
    monkeypatch.setattr(pair_module, "register_pair", FakePipeline())
    viewers: list[Viewer] = []

    def start(
        sessions: Sharing = "shared", what: Any = DATASET, helper: bool = False, **settings: Any
    ) -> Viewer:
        if not helper:  # as on a machine of one processor; it takes a second to start
            monkeypatch.setattr(viewer_module, "start_helper", lambda: None)
        params = None if callable(what) else needing(8)
        viewers.append(Viewer(what, params, sessions=sessions, **{"port": 0, **settings}))
        return viewers[-1]

    yield start
    for viewer in viewers:
        viewer.close()


@pytest.fixture
def visit() -> Iterator[Callable[[Viewer], ProtocolPage]]:
    pages: list[ProtocolPage] = []

    def enter(viewer: Viewer, path: str = "") -> ProtocolPage:
        pages.append(ProtocolPage(viewer.url, path=path))
        pages[-1].wait(lambda: "Up to date" in pages[-1].html(), "a picture")
        return pages[-1]

    yield enter
    for page in pages:
        with suppress(OSError):
            page.close()


Visit = Callable[..., ProtocolPage]


def test_nothing_is_printed_and_the_address_is_told(
    serve: Serve, visit: Visit, capsys: pytest.CaptureFixture[str]
) -> None:
    viewer = serve("shared", helper=True)
    assert viewer.url.startswith("http://127.0.0.1:")
    visit(viewer)
    viewer.close()
    viewer.close()
    viewer.run_forever()  # returns at once
    assert capsys.readouterr().out == ""


def test_a_busy_port_moves_on_to_the_next(serve: Serve) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert serve("separate", port=port).url != f"http://127.0.0.1:{port}"


def test_in_a_shared_session_all_see_the_same(serve: Serve, visit: Visit) -> None:
    viewer = serve("shared")
    first, second = visit(viewer), visit(viewer)
    for page in (first, second):
        page.wait(lambda page=page: "2 people here" in page.html(), "the number of pages")
    first.set("Minimum inliers", 20)
    for page in (first, second):
        page.wait(lambda page=page: "(at least 20)" in page.html(), "the verdict")
        page.wait(lambda page=page: "Up to date" in page.html(), "the status")
    second.wait(lambda: second.find("Minimum inliers")["value"] == 20, "the other's slider")
    late = visit(viewer)
    late.wait(lambda: "(at least 20)" in late.html(), "the present verdict")
    late.wait(lambda: late.find("Minimum inliers")["value"] == 20, "the present value")
    for page in (first, late):
        page.close()
    second.wait(lambda: "people here" not in second.html(), "to be alone")
    second.set("Minimum inliers", 9)
    second.wait(lambda: "(at least 9)" in second.html(), "the verdict")
    assert len(viewer.sessions) == 1


def test_who_works_alone_begins_where_the_others_are(serve: Serve, visit: Visit) -> None:
    viewer = serve("shared")
    first, second = visit(viewer), visit(viewer)
    (shared,) = viewer.sessions
    first.set("Minimum inliers", 20)
    first.wait(lambda: shared.state.params.closure.min_inliers == 20, "the slider")
    pair = shared.desk.state.compared_pair
    shared.desk.decide(lambda decisions: with_verdict(decisions, pair, False))
    alone = visit(viewer, ALONE)
    shared, own = viewer.sessions
    assert own.state.dataset is shared.state.dataset
    assert own.state.params == shared.state.params
    assert own.desk.now.decisions == shared.desk.now.decisions
    assert own.desk.state.compared_pair == pair
    alone.wait(lambda: "You work alone; 2 more are here." in alone.html(), "who is there")
    first.wait(lambda: "3 people here, 1 of them alone." in first.html(), "who is there")
    assert set(alone.nodes) == set(first.nodes)
    assert not set(alone.widgets) & set(first.widgets)  # it was sent nothing of theirs
    alone.set("Minimum inliers", 9)
    alone.wait(lambda: "(at least 9)" in alone.html(), "the verdict")
    second.set("Minimum inliers", 30)
    second.wait(lambda: "(at least 30)" in second.html(), "the verdict")
    counts = [session.state.params.closure.min_inliers for session in (shared, own)]
    assert counts == [30, 9]
    # A click into a scene is told to the server with those of all pages.
    heard: list[int] = []
    for session in (shared, own):
        on_scene_click(session.desk.host, lambda event: heard.append(event.client_id))
    for page in (first, alone):
        page.click_scene((0.0, 0.0, 9.0), (0.0, 0.0, -1.0))
    until(lambda: len(heard) >= 2, "both clicks")
    alone.close()
    first.wait(lambda: "2 people here: all" in first.html(), "who is there")
    assert len(heard) == len(set(heard)) == 2
    assert viewer.sessions == (shared,)


@pytest.mark.filterwarnings("ignore:Queued a")  # the page leaves while its picture is drawn
def test_a_separate_session_ends_with_its_page(serve: Serve, visit: Visit) -> None:
    viewer = serve("separate")
    assert viewer.sessions == ()
    first, second = visit(viewer), visit(viewer)
    (gone, _) = viewer.sessions
    first.set("Minimum inliers", 20)
    first.wait(lambda: "No loop closure" in first.html(), "its verdict")
    assert viewer.wait_idle()
    assert "No loop closure" not in second.html()
    assert second.find("Minimum inliers")["value"] == 8
    assert set(first.nodes) == set(second.nodes)
    assert "people here" not in first.html()
    reference = weakref.ref(gone)
    first.set("Length-scale", 0.5)
    first.close()  # in the middle
    second.wait(lambda: len(viewer.sessions) == 1, "the other session's end")
    second.set("Minimum inliers", 20)
    second.wait(lambda: "No loop closure" in second.html(), "the verdict")
    del gone
    second.wait(lambda: gc.collect() >= 0 and reference() is None, "nothing of it to stay")


def test_on_a_network_the_link_has_a_token_and_who_brings_it_comes_in(serve: Serve) -> None:
    viewer = serve(host="0.0.0.0")
    address, _, token = viewer.link.partition("/?token=")
    assert address == viewer.url
    assert len(token) >= 32
    with pytest.raises(InvalidStatus):
        ProtocolPage(viewer.url)
    page = ProtocolPage(viewer.url, f"gpgrad-token-{viewer.url.rpartition(':')[2]}={token}")
    page.wait(lambda: "Up to date" in page.html(), "a picture")
    page.set("Random seed", 99999999999999)
    page.wait(lambda: "Not taken" in page.html(), "the refusal, which the session shows")
    page.close()


class Opener:
    """Opens a dataset when it is let go."""

    def __init__(self, error: Exception | None = None) -> None:
        self.go, self.begun, self.error = threading.Event(), threading.Event(), error

    def __call__(self, memo: Memo, stage: OpeningProgress) -> Opened:
        del memo
        progress = stage("Fitting the hills")
        self.begun.set()
        while not self.go.wait(0.005):
            progress(0.5)
        if self.error is not None:
            raise self.error
        return Opened(DATASET, needing(8), "", None, needing(8))


@pytest.mark.parametrize("sessions", ["shared", "separate"])
def test_pages_come_before_the_dataset(serve: Serve, visit: Visit, sessions: Sharing) -> None:
    opener = Opener()
    viewer = serve(sessions, opener, source="/data/the hills")
    page = ProtocolPage(viewer.url)
    with urlopen(viewer.url) as answer:  # at once, before the page has heard anything
        assert b"<b>the hills</b>" in answer.read()
    page.wait(lambda: "Fitting the hills" in page.html(), "what goes on")
    assert viewer.sessions == ()
    assert not viewer.wait_idle(0.0)
    opener.go.set()
    page.wait(lambda: "Up to date" in page.html(), "the picture")
    assert "Fitting the hills" not in page.html()
    assert viewer.wait_idle(20)
    assert len(viewer.sessions) == 1
    visit(viewer)
    page.close()


def test_what_cannot_be_opened_ends_the_viewer(serve: Serve) -> None:
    opener = Opener(InputError("hills/000.ply: is empty"))
    viewer = serve("shared", opener, source="hills")
    opener.go.set()
    with pytest.raises(InputError, match="is empty"):
        viewer.run_forever()


def test_a_viewer_that_is_still_opening_can_be_closed(serve: Serve) -> None:
    opener = Opener()
    viewer = serve("shared", opener, source="hills")
    assert opener.begun.wait(20)
    viewer.close()
    assert viewer.sessions == ()
    assert "opening" not in [thread.name for thread in threading.enumerate()]
