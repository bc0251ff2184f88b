import gc
import socket
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
from websockets.exceptions import InvalidStatus

from app.viewer.features.pair import tab as pair_module
from app.viewer.session.session_file import Opened
from app.viewer.viewer import Sharing, Stage, Viewer
from gpgrad_core.errors import InputError
from gpgrad_core.run.memo import Memo
from tests.support.page import ProtocolPage
from tests.support.synthetic import FakePipeline, make_dataset, needing

Serve = Callable[[Sharing], Viewer]
DATASET = make_dataset(num_points=300)


@pytest.fixture
def serve(monkeypatch: pytest.MonkeyPatch) -> Iterator[Serve]:
    monkeypatch.setattr(pair_module, "register_pair", FakePipeline())
    viewers: list[Viewer] = []

    def start(sessions: Sharing) -> Viewer:
        viewers.append(Viewer(DATASET, needing(8), port=0, sessions=sessions))
        return viewers[-1]

    yield start
    for viewer in viewers:
        viewer.close()


@pytest.fixture
def visit() -> Iterator[Callable[[Viewer], ProtocolPage]]:
    pages: list[ProtocolPage] = []

    def enter(viewer: Viewer) -> ProtocolPage:
        pages.append(ProtocolPage(viewer.url))
        pages[-1].wait(lambda: "Up to date" in pages[-1].html(), "a picture")
        return pages[-1]

    yield enter
    for page in pages:
        with suppress(OSError):
            page.close()


Visit = Callable[[Viewer], ProtocolPage]


def test_nothing_is_printed_and_the_address_is_told(
    serve: Serve, visit: Visit, capsys: pytest.CaptureFixture[str]
) -> None:
    viewer = serve("shared")
    assert viewer.url.startswith("http://127.0.0.1:")
    visit(viewer)
    viewer.close()
    viewer.close()
    viewer.run_forever()  # returns at once
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_a_busy_port_moves_on_to_the_next() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        viewer = Viewer(DATASET, port=port, sessions="separate")
        try:
            assert viewer.url != f"http://127.0.0.1:{port}"
        finally:
            viewer.close()


def test_in_a_shared_session_all_see_the_same(serve: Serve, visit: Visit) -> None:
    viewer = serve("shared")
    first, second = visit(viewer), visit(viewer)
    for page in (first, second):
        page.wait(lambda page=page: "2 pages share" in page.html(), "the number of pages")
    first.set("Minimum inliers", 20)
    for page in (first, second):
        page.wait(lambda page=page: "(threshold 20)" in page.html(), "the verdict")
        page.wait(lambda page=page: "Up to date" in page.html(), "the status")
    second.wait(lambda: second.find("Minimum inliers")["value"] == 20, "the other's slider")
    late = visit(viewer)
    late.wait(lambda: "(threshold 20)" in late.html(), "the present verdict")
    late.wait(lambda: late.find("Minimum inliers")["value"] == 20, "the present value")
    for page in (first, late):
        page.close()
    second.wait(lambda: "pages share this session" not in second.html(), "to be alone")
    second.set("Minimum inliers", 9)
    second.wait(lambda: "(threshold 9)" in second.html(), "the verdict")
    assert len(viewer.sessions) == 1


@pytest.mark.slow
def test_separate_sessions_are_each_for_itself(serve: Serve, visit: Visit) -> None:
    viewer = serve("separate")
    assert viewer.sessions == ()
    first, second = visit(viewer), visit(viewer)
    assert len(viewer.sessions) == 2
    first.set("Minimum inliers", 20)
    first.wait(lambda: "No loop closure" in first.html(), "its verdict")
    assert viewer.wait_idle()
    assert "No loop closure" not in second.html()
    assert second.find("Minimum inliers")["value"] == 8
    assert set(first.nodes) == set(second.nodes)
    assert "pages share this session" not in first.html()


@pytest.mark.slow
def test_a_separate_session_ends_with_its_page(serve: Serve, visit: Visit) -> None:
    viewer = serve("separate")
    first, second = visit(viewer), visit(viewer)
    (gone, _) = viewer.sessions
    known = weakref.ref(gone)
    first.set("Length-scale", 0.5)
    first.close()  # in the middle
    second.wait(lambda: len(viewer.sessions) == 1, "the other session's end")
    second.set("Minimum inliers", 20)
    second.wait(lambda: "No loop closure" in second.html(), "the verdict")
    del gone
    second.wait(lambda: gc.collect() >= 0 and known() is None, "nothing of it to stay")


@pytest.mark.slow
def test_on_a_network_the_link_has_a_token_and_values_are_checked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(pair_module, "register_pair", FakePipeline())
    viewer = Viewer(DATASET, needing(8), "0.0.0.0", 0)
    try:
        address, _, token = viewer.link.partition("/?token=")
        assert address == viewer.url
        assert len(token) >= 32
        with pytest.raises(InvalidStatus):
            ProtocolPage(viewer.url)
        page = ProtocolPage(viewer.url, f"gpgrad-token-{viewer.url.rpartition(':')[2]}={token}")
        page.wait(lambda: "Up to date" in page.html(), "a picture")
        page.set("seed", 99999999999999)
        page.wait(lambda: "seed: must be from 0 to 4294967295" in page.html(), "the refusal")
        assert "Not taken" in page.html()
        page.wait(lambda: page.find("seed")["value"] == 0, "the box to go back")
        page.set("seed", 2**32 - 1)
        (session,) = viewer.sessions
        page.wait(lambda: session.state.params.registration.seed == 2**32 - 1, "the seed")
        page.wait(lambda: "Up to date" in page.html(), "the status")
        page.close()
    finally:
        viewer.close()


class Opener:
    """Opens a dataset when it is let go."""

    def __init__(self, error: Exception | None = None) -> None:
        self.go, self.begun, self.error = threading.Event(), threading.Event(), error

    def __call__(self, memo: Memo, stage: Stage) -> Opened:
        del memo
        progress = stage("Fitting the hills")
        self.begun.set()
        while not self.go.wait(0.005):
            progress(0.5)
        if self.error is not None:
            raise self.error
        return Opened(DATASET, needing(8), "", None, needing(8))


@pytest.mark.slow
@pytest.mark.parametrize("sessions", ["shared", "separate"])
def test_pages_are_served_before_the_dataset_is_there(
    monkeypatch: pytest.MonkeyPatch, sessions: Sharing
) -> None:
    monkeypatch.setattr(pair_module, "register_pair", FakePipeline())
    opener = Opener()
    viewer = Viewer(opener, port=0, source="/data/the hills", sessions=sessions)
    try:
        page = ProtocolPage(viewer.url)
        page.wait(lambda: "Opening the hills" in page.html(), "what is opened")
        page.wait(lambda: "Fitting the hills" in page.html(), "what goes on")
        assert viewer.sessions == ()
        assert not viewer.wait_idle(0.0)
        opener.go.set()
        page.wait(lambda: "Up to date" in page.html(), "the picture")
        assert "Opening" not in page.html()
        assert viewer.wait_idle(20)
        assert len(viewer.sessions) == 1
        late = ProtocolPage(viewer.url)
        late.wait(lambda: "Up to date" in late.html(), "the picture")
        page.close()
        late.close()
    finally:
        viewer.close()


def test_what_cannot_be_opened_ends_the_viewer() -> None:
    opener = Opener(InputError("hills/000.ply: is empty"))
    viewer = Viewer(opener, port=0, source="hills")
    try:
        opener.go.set()
        with pytest.raises(InputError, match="is empty"):
            viewer.run_forever()
    finally:
        viewer.close()


def test_a_viewer_that_is_still_opening_can_be_closed() -> None:
    opener = Opener()
    viewer = Viewer(opener, port=0, source="hills")
    assert opener.begun.wait(20)
    viewer.close()
    assert viewer.sessions == ()
    assert "opening" not in [thread.name for thread in threading.enumerate()]
