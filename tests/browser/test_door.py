"""A real browser at the door: the own page and one with the token are served, others hear nothing.

Chromium is told that ``evil.test`` and ``rebound.test`` are this machine, as a name server that
rebinds would tell it. The hostile page is served from another port.
"""

import http.server
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from app.viewer.door.admission import Admission
from app.viewer.door.server import open_server
from app.viewer.server import Viewer
from tests.app.synthetic import FakePipeline, make_dataset, needing
from tests.browser.conftest import unavailable

pytestmark = pytest.mark.browser

# Tries a websocket as viser's client does; tells what came of it.
SOCKET = """(url) => new Promise((tell) => {
    const socket = new WebSocket(url, ["viser-v%s"]);
    let bytes = 0;
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => { bytes += event.data.byteLength; };
    socket.onopen = () => setTimeout(() => tell({opened: true, bytes}), 300);
    socket.onerror = () => tell({opened: false, bytes});
})"""
# Tries everything else by which a page could read or send.
FETCHES = """async (url) => {
    const came = [];
    for (const options of [{}, {mode: "no-cors"}, {method: "POST", mode: "no-cors", body: "x"}]) {
        try {
            const answer = await fetch(url, options);
            came.push(await answer.text());
        } catch (error) { came.push(""); }
    }
    const loads = (tag, name) => new Promise((tell) => {
        const node = document.createElement(tag);
        node.onload = () => tell(true);
        node.onerror = () => tell(false);
        node[name] = url;
        document.head.append(node);
    });
    came.push(await loads("script", "src") ? "script" : "");
    return came.join("");
}"""


class Hostile(http.server.BaseHTTPRequestHandler):
    """Serves one page, and a socket's worth of nothing."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<title>evil</title><body>evil")

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def evil() -> Iterator[int]:
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Hostile) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser that believes the hostile names to be here."""
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415, F401
    except ModuleNotFoundError as error:
        unavailable(f"{error.name} is not installed")
    from tests.browser.chromium import find_chromium, launch  # noqa: PLC0415

    executable = find_chromium()
    if executable is None:
        unavailable("no Chromium was found")
        return
    names = "MAP *.test 127.0.0.1"
    with launch(executable, (f"--host-resolver-rules={names}",)) as browser:
        yield browser


def serve(admission: Admission) -> Iterator[Viewer]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("app.viewer.pair.tab.register_pair", FakePipeline())
        viewer = Viewer(make_dataset(), needing(8), port=0, admission=admission)
        yield viewer
        viewer.close()


@pytest.fixture(scope="module")
def viewer() -> Iterator[Viewer]:
    yield from serve(Admission())


@pytest.fixture(scope="module")
def guarded() -> Iterator[Viewer]:
    yield from serve(Admission(token="a-token-to-share"))


SMALL: Any = {"width": 800, "height": 300}
"""What is drawn costs most of the time, and nobody looks."""


@pytest.fixture
def tab(chromium: Any) -> Iterator[Any]:
    context = chromium.new_context(viewport=SMALL)
    yield context.new_page()
    context.close()


@pytest.fixture(scope="module")
def own(chromium: Any, viewer: Viewer) -> Iterator[Any]:
    """The viewer's own page, for several tests: it takes seconds to open."""
    context = chromium.new_context(viewport=SMALL)
    page = context.new_page()
    is_served(page, f"{viewer.url.replace('127.0.0.1', 'localhost')}/?fixedDpr=1")
    yield page
    context.close()


def script() -> str:
    import viser  # noqa: PLC0415

    return SOCKET % viser.__version__


def is_served(tab: Any, link: str) -> None:
    """Open a link and wait for the verdict; nothing that the page does may be forbidden it."""
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.goto(link)
    tab.get_by_test_id("verdict").wait_for(timeout=60_000)
    assert not [text for text in said if "Content Security Policy" in text]


@pytest.mark.parametrize("name", ["evil.test", "localhost", "127.0.0.1"])
def test_a_page_of_another_origin_hears_nothing(
    tab: Any, viewer: Viewer, evil: int, name: str
) -> None:
    pages = len(viewer._server.get_clients())
    tab.goto(f"http://{name}:{evil}/")
    for url in (viewer.url, viewer.url.replace("127.0.0.1", "localhost")):
        assert tab.evaluate(script(), url.replace("http", "ws")) == {"opened": False, "bytes": 0}
        assert tab.evaluate(FETCHES, url) == ""
    assert len(viewer._server.get_clients()) == pages


def test_a_page_of_an_allowed_origin_is_served(tab: Any, evil: int) -> None:
    """So what refuses the others is the door, and nothing else."""
    server, _ = open_server("127.0.0.1", 0, Admission(origins=(f"http://evil.test:{evil}",)))
    tab.goto(f"http://evil.test:{evil}/")
    tried = tab.evaluate(script(), f"ws://127.0.0.1:{server.get_port()}")
    server.stop()
    assert tried["opened"]
    assert tried["bytes"] > 0


def test_a_page_without_an_origin_hears_nothing(tab: Any, viewer: Viewer, evil: int) -> None:
    tab.goto(f"http://evil.test:{evil}/")
    tab.evaluate(
        """() => { const frame = document.createElement("iframe");
        frame.sandbox = "allow-scripts"; frame.srcdoc = "null"; document.body.append(frame);
        return new Promise((done) => { frame.onload = done; }).then(() => null); }"""
    )
    frame = tab.frames[1]
    assert frame.evaluate("self.origin") == "null"
    tried = frame.evaluate(script(), viewer.url.replace("http", "ws"))
    assert tried == {"opened": False, "bytes": 0}


def test_a_rebound_name_is_not_served(tab: Any, viewer: Viewer) -> None:
    port = viewer.url.rpartition(":")[2]
    answer = tab.goto(f"http://rebound.test:{port}/")
    assert answer.status == 421
    assert "verdict" not in tab.content()
    tried = tab.evaluate(script(), f"ws://rebound.test:{port}")
    assert tried == {"opened": False, "bytes": 0}


def test_another_page_does_not_frame_it(tab: Any, viewer: Viewer, evil: int) -> None:
    tab.goto(f"http://evil.test:{evil}/")
    tab.evaluate(
        """(url) => { const frame = document.createElement("iframe"); frame.src = url;
        document.body.append(frame);
        return new Promise((done) => { frame.onload = done; }).then(() => null); }""",
        viewer.url,
    )
    assert "verdict" not in tab.frames[1].content()
    assert tab.frames[1].evaluate("document.scripts.length") == 0


def test_a_link_does_not_lead_the_page_to_another_server(
    tab: Any, viewer: Viewer, evil: int
) -> None:
    """viser's client takes its socket from the address; what comes from there can run scripts."""
    assert tab.goto(f"{viewer.url}/?websocket=ws://evil.test:{evil}").status == 403


def test_the_own_page_is_served_and_talks_to_nobody_else(own: Any, evil: int) -> None:
    tried = own.evaluate(script(), f"ws://evil.test:{evil}")
    assert tried == {"opened": False, "bytes": 0}
    assert own.evaluate(FETCHES, f"http://evil.test:{evil}/") == ""


def test_with_the_token_two_pages_are_served_and_without_it_none(
    chromium: Any, guarded: Viewer, evil: int
) -> None:
    holder, stranger = chromium.new_context(viewport=SMALL), chromium.new_context()
    first, second, other = holder.new_page(), holder.new_page(), stranger.new_page()
    assert guarded.link == f"{guarded.url}/?token=a-token-to-share"
    is_served(first, guarded.link)
    is_served(second, guarded.url)  # the browser has the token as a cookie now
    assert "a-token" not in first.evaluate("document.cookie")
    assert other.goto(guarded.url).status == 403
    assert "token" in other.content()
    assert other.goto(f"{guarded.url}/?token=a-token-to-guess").status == 403
    # A page of another port of this machine is of the same site, so its socket has the cookie.
    lured = holder.new_page()
    lured.goto(f"http://127.0.0.1:{evil}/")
    tried = lured.evaluate(script(), guarded.url.replace("http", "ws"))
    assert tried == {"opened": False, "bytes": 0}
    for context in (holder, stranger):
        context.close()


def test_a_value_that_cannot_be_goes_back_in_the_box(own: Any) -> None:
    label = own.locator("label").filter(has_text="Minimum inliers").first
    slider = own.locator(f'[id="{label.get_attribute("for")}"]')
    box = slider.locator("xpath=..//input[not(@type='hidden')]").last
    box.fill("99999999999999999999")
    status = own.get_by_test_id("status")
    status.filter(has_text="Minimum inliers: must be").wait_for(timeout=20_000)
    assert "Not taken" in status.inner_text()
    own.wait_for_function(
        "(id) => document.getElementById(id).parentElement.querySelector("
        "'input:not([type=hidden])').value === '8'",
        arg=label.get_attribute("for"),
        timeout=20_000,
    )
    box.fill("12")
    own.get_by_text("(threshold 12)").wait_for(timeout=20_000)
