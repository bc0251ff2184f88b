"""A real browser: our page and one with the token are served, others hear nothing.

Chromium is told that ``evil.test`` and ``rebound.test`` are this machine, as a name server that
rebinds would tell it. The hostile page is served from another port.
"""

import http.server
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import viser

from app.viewer.server.admission import Admission
from app.viewer.server.guard import open_server
from tests.support.waiting import PATIENCE

pytestmark = [pytest.mark.browser, pytest.mark.slow]

# Tries a websocket as viser's client does; tells what came of it.
SOCKET = """(url) => new Promise((tell) => {
    const socket = new WebSocket(url, ["viser-vVERSION"]);
    let bytes = 0;
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => { bytes += event.data.byteLength; };
    socket.onopen = () => setTimeout(() => tell({opened: true, bytes}), 300);
    socket.onerror = () => tell({opened: false, bytes});
})""".replace("VERSION", viser.__version__)
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
def chromium(start_browser: Callable[..., Any]) -> Iterator[Any]:
    """A browser that believes the hostile names to be here."""
    with start_browser(("--host-resolver-rules=MAP *.test 127.0.0.1",)) as browser:
        yield browser


def serve(admission: Admission) -> Iterator[viser.ViserServer]:
    """Serve a panel with a word, which opens faster than a whole viewer."""
    server, _ = open_server("127.0.0.1", 0, admission)
    server.gui.add_html('<div data-testid="verdict">only pages may read this</div>')
    yield server
    server.stop()


def at(server: viser.ViserServer, kind: str = "http", name: str = "127.0.0.1") -> str:
    return f"{kind}://{name}:{server.get_port()}"


@pytest.fixture(scope="module")
def viewer() -> Iterator[viser.ViserServer]:
    yield from serve(Admission())


SMALL: Any = {"width": 800, "height": 300}
"""What is drawn costs most of the time, and nobody looks."""


@pytest.fixture
def tab(chromium: Any) -> Iterator[Any]:
    context = chromium.new_context(viewport=SMALL)
    context.set_default_timeout(1000 * PATIENCE)
    yield context.new_page()
    context.close()


def is_served(tab: Any, link: str) -> None:
    """Open a link and wait for the verdict; nothing that the page does may be forbidden it."""
    said: list[str] = []
    tab.on("console", lambda message: said.append(message.text))
    tab.goto(link)
    tab.get_by_test_id("verdict").wait_for()
    assert not [text for text in said if "Content Security Policy" in text]


UNHEARD = {"opened": False, "bytes": 0}
ADD_FRAME = """(of) => { const frame = document.createElement("iframe"); Object.assign(frame, of);
    document.body.append(frame);
    return new Promise((done) => { frame.onload = done; }).then(() => null); }"""


@pytest.mark.parametrize("name", ["evil.test", "localhost", "127.0.0.1"])
def test_a_page_of_another_origin_hears_nothing(
    tab: Any, viewer: viser.ViserServer, evil: int, name: str
) -> None:
    pages = len(viewer.get_clients())
    tab.goto(f"http://{name}:{evil}/")
    for ours in ("127.0.0.1", "localhost"):
        assert tab.evaluate(SOCKET, at(viewer, "ws", ours)) == UNHEARD
        assert tab.evaluate(FETCHES, at(viewer, name=ours)) == ""
    assert len(viewer.get_clients()) == pages


def test_a_page_of_an_allowed_origin_is_served(tab: Any, evil: int) -> None:
    """So what refuses the others is access control, and nothing else."""
    for server in serve(Admission(origins=(f"http://evil.test:{evil}",))):
        tab.goto(f"http://evil.test:{evil}/")
        tried = tab.evaluate(SOCKET, at(server, "ws"))
        assert tried["opened"]
        assert tried["bytes"] > 500


def test_a_page_without_an_origin_hears_nothing(
    tab: Any, viewer: viser.ViserServer, evil: int
) -> None:
    tab.goto(f"http://evil.test:{evil}/")
    tab.evaluate(ADD_FRAME, {"sandbox": "allow-scripts", "srcdoc": "null"})
    frame = tab.frames[1]
    assert frame.evaluate("self.origin") == "null"
    assert frame.evaluate(SOCKET, at(viewer, "ws")) == UNHEARD


def test_a_rebound_name_is_not_served(tab: Any, viewer: viser.ViserServer) -> None:
    assert tab.goto(at(viewer, name="rebound.test")).status == 421
    assert "verdict" not in tab.content()
    assert tab.evaluate(SOCKET, at(viewer, "ws", "rebound.test")) == UNHEARD


def test_another_page_does_not_frame_it(tab: Any, viewer: viser.ViserServer, evil: int) -> None:
    tab.goto(f"http://evil.test:{evil}/")
    tab.evaluate(ADD_FRAME, {"src": at(viewer)})
    assert "verdict" not in tab.frames[1].content()
    assert tab.frames[1].url.startswith("chrome-error:")


def test_the_own_page_is_served_and_talks_to_nobody_else(
    tab: Any, viewer: viser.ViserServer, evil: int
) -> None:
    """viser's client takes its socket from the address; what comes from there can run scripts."""
    assert tab.goto(f"{at(viewer)}/?websocket=ws://evil.test:{evil}").status == 403
    is_served(tab, f"{at(viewer, name='localhost')}/?fixedDpr=1")
    assert tab.evaluate(SOCKET, f"ws://evil.test:{evil}") == UNHEARD
    assert tab.evaluate(FETCHES, f"http://evil.test:{evil}/") == ""


def test_with_the_token_two_pages_are_served_and_without_it_none(
    tab: Any, chromium: Any, evil: int
) -> None:
    holder, first = tab.context, tab
    stranger = chromium.new_context()
    second, lured, other = holder.new_page(), holder.new_page(), stranger.new_page()
    for server in serve(Admission(token="a-token-to-share")):
        is_served(first, f"{at(server)}/?token=a-token-to-share")
        is_served(second, at(server))  # the browser has the token as a cookie now
        assert "a-token" not in first.evaluate("document.cookie")
        assert other.goto(at(server)).status == 403
        assert "token" in other.content()
        assert other.goto(f"{at(server)}/?token=a-token-to-guess").status == 403
        # A page of another port of this machine is of the same site: its socket has the cookie.
        lured.goto(f"http://127.0.0.1:{evil}/")
        assert lured.evaluate(SOCKET, at(server, "ws")) == UNHEARD
    stranger.close()
