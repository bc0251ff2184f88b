"""The viewer's server over real sockets: who gets in, what gets through, and what ends."""

import gzip
import http.client
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, field, replace
from itertools import count, islice, pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from app.viewer.server.guard import SCRIPTS, AccessControl, open_server
from app.viewer.server.internals import connections_of
from app.viewer.server.limits import Limits
from app.viewer.web import fill_page_file
from app.viewer.widgets.actions import on_upload
from app.viewer.widgets.html import uuid_of
from tests.support.page import CAMERA, ProtocolPage
from tests.support.waiting import until
from tests.support.widgets import find

LIMITS = Limits(pages=6, waiting=20, uploads=2, upload_bytes=1_000_000, typing_seconds=0.15)
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
SECRET = "what only pages may read"
PAGE_SCRIPTS = [fill_page_file(name).encode() for name in SCRIPTS]


@dataclass
class Served:
    """A server with a widget of each kind, and what was told."""

    server: viser.ViserServer
    access: AccessControl
    values: list[object] = field(default_factory=list)
    told: list[str] = field(default_factory=list)
    files: list[tuple[str, int]] = field(default_factory=list)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.get_port()}"

    def widget(self, label: str) -> Any:
        return find(self.server, label)

    def goes_on(self, page: ProtocolPage) -> None:
        """Wait until what a page says next is taken, and nothing was before it."""
        value = 3 + (self.widget("Slider").value - 2) % 47
        page.set("Slider", value)
        until(lambda: self.values == [value], "the next message")


@pytest.fixture(scope="module")
def open_to_own() -> Iterator[Served]:
    server, access = open_server("127.0.0.1", 0, limits=LIMITS)
    served = Served(server, access)
    gui = server.gui
    gui.add_html(SECRET)
    widgets: list[Any] = [
        gui.add_slider("Slider", 3, 50, 1, 8),
        gui.add_slider("Size", 0.005, 0.2, 0.005, 0.03),
        gui.add_number("Seed", 0, min=0, max=2**32 - 1),
        gui.add_dropdown("Layer", ("elevation", "gradient")),
        gui.add_text("Folder", "here"),
        gui.add_checkbox("mutual", initial_value=True),
    ]
    for widget in widgets:
        widget.on_update(lambda event: served.values.append(event.target.value))
    upload = gui.add_upload_button("Upload")
    on_upload(upload, lambda name, content: served.files.append((name, len(content))))
    gui.add_upload_button("Hidden upload", visible=False)
    access.on_refused = access.uploads.on_refused = lambda _, text: served.told.append(text)
    yield served
    server.stop()


@pytest.fixture
def served(open_to_own: Served) -> Iterator[Served]:
    for said in (open_to_own.values, open_to_own.told, open_to_own.files):
        said.clear()  # type: ignore[attr-defined]
    yield open_to_own
    open_to_own.server._websock_server.disconnect_all_clients()
    until(lambda: not open_to_own.server.get_clients(), "all pages to be gone")


def visit(served: Served) -> ProtocolPage:
    visitor = ProtocolPage(served.url)
    visitor.wait(lambda: SECRET in visitor.html(), "the panel")
    until(served.server.get_clients, "viser to know it")
    return visitor


@pytest.fixture
def page(served: Served) -> Iterator[ProtocolPage]:
    visitor = visit(served)
    yield visitor
    with suppress(OSError):
        visitor.close()


@pytest.fixture
def other(served: Served) -> Iterator[ProtocolPage]:
    visitor = visit(served)
    yield visitor
    visitor.close()


def line_to(served: Served) -> socket.socket:
    return socket.create_connection(("127.0.0.1", served.server.get_port()), timeout=60)


def knock(served: Served, origin: str | None = "own") -> ClientConnection:
    """Open a websocket without a page."""
    stated = served.url if origin == "own" else origin
    return connect(
        served.url.replace("http", "ws"),
        origin=None if stated is None else Origin(stated),
        subprotocols=[PROTOCOL],
    )


def status_of_socket(served: Served, origin: str | None = "own") -> int:
    """Give the status of the refusal of a websocket, which tells nothing."""
    with pytest.raises(InvalidStatus) as refused:
        knock(served, origin)
    assert SECRET.encode() not in refused.value.response.body
    return refused.value.response.status_code


def fetch(
    served: Served, path: str = "/", method: str = "GET", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    port = served.server.get_port()
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as line:
        line.request(method, path, headers={k.replace("_", "-"): v for k, v in headers.items()})
        answer = line.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


# Who gets in.


@pytest.mark.parametrize("coding", ["gzip, deflate", "identity"])
def test_the_own_page_begins_with_scripts(served: Served, page: ProtocolPage, coding: str) -> None:
    for _ in range(2):
        status, headers, body = fetch(served, Accept_Encoding=coding)
        text = gzip.decompress(body) if headers["Content-Encoding"] == "gzip" else body
        assert (status, int(headers["Content-Length"])) == (200, len(body))
        assert (headers["Content-Encoding"] == "gzip") == ("gzip" in coding)
        assert text.count(b"".join(b"<script>%b</script>" % script for script in PAGE_SCRIPTS)) == 1
        assert text.index(b"<script>" + PAGE_SCRIPTS[0]) == text.index(b"<script")
        assert headers["Content-Security-Policy"].startswith("default-src 'self'")
        assert headers["X-Content-Type-Options"] == "nosniff"
    end, beyond = (0.2, 0.2 + 1e-11) if coding == "identity" else (0.005, 0.005 - 1e-12)
    page.set("Size", beyond)  # by a hair, by rounding
    until(lambda: served.values == [end], "the end")


@pytest.mark.parametrize("origin", [None, "null", "http://evil.com", "http://127.0.0.1.evil.com"])
def test_a_foreign_page_gets_no_socket_and_hears_nothing(
    served: Served, origin: str | None
) -> None:
    assert status_of_socket(served, origin) == 403
    stated = {} if origin is None else {"Origin": origin}
    for upgrade in ("websocket", "WebSocket", "h2c", "websocket, h2c"):
        assert fetch(served, Upgrade=upgrade, Connection="Upgrade", **stated)[0] == 403
        assert fetch(served, Upgrade=upgrade, **stated)[0] == 403  # it only looks like a socket
    if stated:
        status, headers, body = fetch(served, **stated)
        assert status == 403
        assert "Access-Control-Allow-Origin" not in headers
        assert b"<html" not in body.lower()


def test_nothing_can_be_sent_but_through_the_socket(served: Served) -> None:
    """A page uploaded to Gradio on localhost by a plain request (CVE-2024-1727)."""
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "HEAD"):
        with suppress(http.client.HTTPException, OSError):  # it ends without an answer
            assert fetch(served, "/upload", method)[0] >= 400
        assert fetch(served)[0] == 200


OUTSIDE = (
    "/../pyproject.toml",
    "/..%2f..%2fetc/passwd",
    "/%2e%2e/%2e%2e/etc/passwd",
    "/..\\..\\etc\\passwd",
    "/..%5c..%5cetc%5cpasswd",
    "//etc/passwd",
    "/./../../etc/passwd",
    "/assets/../../index.html",
    "/%252e%252e/etc/passwd",
    "/index.html/..",
    "/\0",
    "/etc/passwd%00.html",
    "/~root/.ssh/id_rsa",
)


def test_no_path_leads_outside(served: Served) -> None:
    for path in OUTSIDE:
        with closing(line_to(served)) as line:
            host = served.url.removeprefix("http://")
            line.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
            answer = line.recv(1000)
        assert b" 200 " not in answer, path
        assert b"root:" not in answer, path
    for path in ("/not_there", "/" + "a" * 5000, "/" + "a/" * 2000, "/%00"):  # no file can have it
        assert fetch(served, path)[0] == 404


# What gets through.


@pytest.mark.parametrize(
    ("label", "value", "words"),
    [
        ("Seed", 2**64 - 1, "Seed: must be from 0 to 4294967295, got a number beyond all bounds"),
        ("Slider", -1, "Slider: must be from 3 to 50, got -1"),
        ("Layer", "/etc/passwd", "Layer: offers no such choice as '/etc/passwd'"),
        ("Folder", "a\0b", "Folder: must be a text of one line"),
        ("mutual", "<script>", "mutual: must be on or off"),
    ],
)
def test_a_value_that_cannot_be_goes_back_and_is_told(
    served: Served, page: ProtocolPage, other: ProtocolPage, label: str, value: object, words: str
) -> None:
    before = served.widget(label).value
    page.set(label, value)
    until(lambda: bool(served.told), "a word")
    assert served.told[0].startswith(words)
    page.wait(lambda: page.find(label)["value"] == before, "the box to go back")
    assert other.find(label)["value"] == served.widget(label).value == before
    served.goes_on(page)
    other.wait(lambda: [other.find("Slider")["value"]] == served.values, "the slider")


def test_a_value_that_cannot_be_takes_no_place(served: Served, page: ProtocolPage) -> None:
    page.wait(lambda: page.find("Slider"), "the slider")
    slider = served.widget("Slider")
    (number,) = served.server.get_clients()
    keys = [
        served.access.key_of(
            number,
            {"type": "GuiUpdateMessage", "uuid": uuid_of(slider), "updates": {"value": value}},
        )
        for value in (slider.max, slider.min - 1)
    ]
    assert keys[0] == uuid_of(slider)
    assert keys[1] is None


def test_who_is_still_typing_is_not_interrupted(
    served: Served, page: ProtocolPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(served.access, "limits", replace(LIMITS, typing_seconds=600.0))
    page.set("Slider", 1)  # on the way to a number of two digits
    until(lambda: served.access.refusals_due, "the first digit")
    (refusal,) = served.access.refusals_due.values()
    served.goes_on(page)
    assert refusal.cancelled()
    assert served.told == []
    assert [page.find("Slider")["value"]] == served.values
    page.set("Slider", 1)
    until(lambda: served.access.refusals_due, "another")
    page.close()
    until(lambda: not served.access.refusals_due, "its end with the page")


def test_what_no_page_says_changes_nothing(
    served: Served, page: ProtocolPage, capfd: pytest.CaptureFixture[str]
) -> None:
    for frame in ("text", b"", b"\xc1\xc1", b"\x93\x01", b"\x91" * 9000, b"\xde\xff\xff", b"\x80"):
        page.socket.send(frame)
    uuid = uuid_of(served.widget("Folder"))
    state = served.widget("Folder")._impl
    before = dict(vars(state))
    for updates in ({"removed": True}, {"uuid": "x"}, {"sync_cb": None}, {"__class__": 1}, {}):
        page.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})
    page.send({"type": "GuiUpdateMessage", "uuid": "nobody's", "updates": {"value": 1}})
    page.send({"type": "ShareUrlRequest"})
    page.send({"type": "GuiFormDirtyMessage", "uuid": "x" * 100})
    page.send({"type": "SceneNodeClickMessage", "name": "../../etc/passwd"})
    picture = {"type": "GetRenderResponseMessage", "render_uuid": "x", "payload": b"GIF89a"}
    assert not served.access.on_message(0, picture)
    served.goes_on(page)
    assert vars(state) == before
    kept: Any = served.server._websock_server._broadcast_buffer.message_from_id
    assert not any(type(message).__name__ == "GuiFormDirtyMessage" for message in kept.values())
    assert served.server._share_tunnel is None
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("how", ["unseen", "disabled", "in a folder", "in a tab"])
def test_what_is_not_offered_is_not_acted_on(served: Served, page: ProtocolPage, how: str) -> None:
    """A forged press of a hidden button built a recording outside of the root."""
    gui, outer = served.server.gui, nullcontext()
    if how == "in a folder":
        with gui.add_folder("Hidden", visible=False):
            outer = gui.add_folder("Inner")
    elif how == "in a tab":
        outer = gui.add_tab_group(visible=False).add_tab("Tab")
    with outer:
        options = {"visible": how != "unseen", "disabled": how == "disabled"}
        button = gui.add_button("Press", **options)
        text = gui.add_text("Typed", "before", **options)
        slider = gui.add_slider("Moved", 0, 9, 1, 3, **options)
    button.on_click(lambda _: served.values.append("pressed"))
    for box in (text, slider):
        box.on_update(lambda _: served.values.append("set"))
    page.wait(lambda: page.find("Moved"), "the widgets")
    for label, value in (("Press", True), ("Typed", "after"), ("Moved", 5)):
        page.set(label, value)
    served.goes_on(page)
    page.wait(lambda: page.find("Typed")["value"] == "before", "the box to go back")
    page.wait(lambda: page.find("Moved")["value"] == 3, "the slider to go back")
    assert (text.value, slider.value, served.told) == ("before", 3, [])
    for handle in (button, text, slider):
        handle.remove()


def test_what_only_shows_a_value_takes_none(
    served: Served, page: ProtocolPage, caplog: pytest.LogCaptureFixture
) -> None:
    bar = served.server.gui.add_progress_bar(30.0)

    def bars() -> list[str]:
        kinds = {uuid: widget["type"] for uuid, widget in page.widgets.items()}
        return [uuid for uuid, kind in kinds.items() if kind == "GuiProgressBarMessage"]

    page.wait(bars, "the bar")
    page.send({"type": "GuiUpdateMessage", "uuid": bars()[0], "updates": {"value": 90.0}})
    served.goes_on(page)
    assert (bar.value, caplog.records) == (30.0, [])
    bar.remove()


def test_what_is_folded_or_in_another_tab_is_offered(served: Served, page: ProtocolPage) -> None:
    """viser folds drawers and opens tabs in the page alone, and a page may have another open."""
    gui = served.server.gui
    tabs = gui.add_tab_group()
    with tabs.add_tab("First"):
        gui.add_html("")
    with tabs.add_tab("Second"), gui.add_folder("Drawer", expand_by_default=False):
        slider = gui.add_slider("Moved", 0, 9, 1, 3)
    page.wait(lambda: page.find("Moved"), "the slider")
    page.set("Moved", 5)
    until(lambda: slider.value == 5, "its value")
    tabs.remove()


# How much.


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["value", "nothing"])
def test_a_page_that_floods_does_not_hold_up_another(
    served: Served, page: ProtocolPage, kind: str
) -> None:
    seed = uuid_of(served.widget("Seed"))
    message = {"type": "GuiUpdateMessage", "uuid": seed, "updates": {"value": -1}}
    frame = msgspec.msgpack.encode(message) if kind == "value" else b""
    enough = threading.Event()
    with knock(served) as hostile:

        def flood() -> None:
            with suppress(ConnectionClosed):
                while not enough.is_set():
                    hostile.send(frame)

        thread = threading.Thread(target=flood, daemon=True)
        thread.start()
        served.goes_on(page)
        assert thread.is_alive()  # the flood goes on
        enough.set()
    thread.join(10)


def test_a_page_has_so_many_turns_a_second_and_what_waits_is_in_order(
    served: Served, page: ProtocolPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    access, number = served.access, max(served.server.get_clients())
    turns, times, wait, on_message = (
        list[float](),
        list[float](),
        access.turns.wait,
        access.on_message,
    )

    async def counted() -> None:
        await wait()
        turns.append(time.monotonic())

    def timed(page: int, message: dict[str, Any]) -> bool:
        times.extend([time.monotonic()] * (page == number))
        return on_message(page, message)

    monkeypatch.setattr(access.turns, "wait", counted)
    monkeypatch.setattr(access, "on_message", timed)
    monkeypatch.setattr(served.access, "limits", replace(LIMITS, rate=4.0))
    button, slider, pressed = served.server.gui.add_button("Press"), served.widget("Slider"), []

    @button.on_click
    async def _(_: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        pressed.append(slider.value)

    page.wait(lambda: page.find("Press"), "the button")
    for count_of in (1, 2):  # after which the page has to wait, by the new limits
        page.send(CAMERA)
        until(lambda count_of=count_of: len(times) == count_of, "a turn")
    for label, value in (("Slider", 30), ("Slider", 31), ("Press", True), ("Press", True)):
        page.set(label, value)
    page.set("Slider", 32)
    until(lambda: slider.value == 32, "the last")
    assert pressed == [31, 31]
    assert min(later - sooner for sooner, later in pairwise(times[1:])) > 0.24
    assert len(turns) >= len(times) == 6
    button.remove()


def test_a_page_that_drags_what_takes_long_loses_no_last_value_and_holds_up_nobody(
    served: Served, page: ProtocolPage, other: ProtocolPage
) -> None:
    slow, acted = served.server.gui.add_slider("Slow", 0, 10**6, 1, 0), list[object]()
    before_other: list[int] = []

    @slow.on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        acted.append(event.target.value)
        time.sleep(0.01)  # all that follows from a value

    @served.widget("Seed").on_update
    async def _(event: viser.GuiEvent[Any]) -> None:
        del event
        before_other.append(len(acted))

    for visitor in (page, other):
        visitor.wait(lambda visitor=visitor: visitor.find("Slow") is not None, "the slider")
    values = count(1)
    for value in islice(values, 300):
        page.set("Slow", value)
    other.set("Seed", 7)

    def drag_on() -> bool:
        page.set("Slow", next(values))
        return bool(before_other)

    until(drag_on, "the other page")  # it is served while the first one is still busy
    page.set("Slow", last := next(values))
    until(lambda: acted[-1:] == [last], "the last value")
    assert acted == sorted(acted, key=int)
    assert len(acted) < last / 2
    assert before_other[0] < len(acted)
    slow.remove()


def test_only_so_many_pages_are_open_at_once(served: Served) -> None:
    pages = [knock(served) for _ in range(LIMITS.pages)]
    assert status_of_socket(served) == 503
    pages.pop().close()
    until(lambda: len(connections_of(served.server)) < LIMITS.pages, "room")
    for each in (*pages, knock(served)):
        each.close()


def test_half_open_connections_make_room(served: Served) -> None:
    lines = [line_to(served) for _ in range(60)]
    for line in lines:
        line.sendall(b"GET / HTTP/1.1\r\n")
    assert fetch(served)[0] == 200
    with suppress(ConnectionResetError):
        assert lines[0].recv(10) == b""  # the oldest was dropped
    knock(served).close()
    for line in lines:
        line.close()


def begin_message(line: socket.socket, size: int, *, fin: bool = False, opcode: int = 2) -> None:
    """Send a piece of a message, masked with zeros."""
    head = bytes([(0x80 if fin else 0) | opcode, 0xFF]) + size.to_bytes(8, "big") + bytes(4)
    line.sendall(head + bytes(size))


def test_unfinished_messages_make_room_the_oldest_first(
    served: Served, page: ProtocolPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    unfinished, told = served.access.unfinished, list[str]()
    monkeypatch.setattr(unfinished, "most_bytes", 10_000_000)
    monkeypatch.setattr(unfinished, "on_full", told.append)
    pages = [knock(served) for _ in range(4)]
    for number, hostile in enumerate(pages):
        for piece in range(3):
            begin_message(hostile.socket, 1_000_000, opcode=0 if piece else 2)
        until(lambda number=number: unfinished.num_bytes >= min(9, 3 * number + 3) * 10**6, "it")
        assert unfinished.num_bytes <= 10_000_000
    until(lambda: len(connections_of(served.server)) == 4, "one to be gone")
    with suppress(ConnectionClosed):
        for _ in pages[0]:  # what it was sent before it was cut off
            pass
    assert pages[0].close_code == 1006
    served.goes_on(page)
    assert len(told) == 1
    for hostile in pages[1:]:
        hostile.socket.close()
    until(lambda: unfinished.num_bytes == 0, "all to be let go")


def test_half_a_request_and_pieces_of_nothing_count_too(served: Served) -> None:
    unfinished = served.access.unfinished
    with closing(line_to(served)) as line:
        line.sendall(b"GET / HTTP/1.1\r\nHost: " + b"a" * 5000)
        until(lambda: unfinished.num_bytes >= 5000, "the request")
    until(lambda: unfinished.num_bytes == 0, "its end")
    with knock(served) as hostile:
        hostile.socket.sendall(bytes([2, 0x81, 0, 0, 0, 0, 0]) + 999 * bytes([0, 0x81, *bytes(5)]))
        until(lambda: unfinished.num_bytes >= 1000 * 170, "a thousand pieces of a byte")
        begin_message(hostile.socket, 1, fin=True, opcode=0)
        until(lambda: unfinished.num_bytes == 0, "its end")


def test_one_page_uploads_a_file(served: Served, page: ProtocolPage, other: ProtocolPage) -> None:
    page.upload("Upload", "large.ply", bytes(1_100_000))
    until(lambda: bool(served.told), "the refusal")
    assert "up to 1 MB can be uploaded" in served.told[0]
    page.upload("Upload", "big.ply", bytes(900_000))
    until(lambda: served.files == [("big.ply", 900_000)], "the file")
    until(lambda: served.access.unfinished.num_bytes == 0, "it to be let go")
    served.goes_on(other)
    page.wait(lambda: [page.find("Slider")["value"]] == served.values, "the next message")
    for each, num_acks in ((page, 3), (other, 0)):
        assert [kind for _, kind in each.received].count("FileTransferPartAck") == num_acks


def test_what_is_not_offered_takes_no_file_and_uploads_end_with_their_page(
    served: Served, page: ProtocolPage
) -> None:
    def start(transfer: str, label: str) -> None:
        ids = {"source_component_uuid": uuid_of(served.widget(label)), "transfer_uuid": transfer}
        about = {"filename": "big.ply", "mime_type": "", "part_count": 2, "size_bytes": 1000}
        page.send({"type": "FileTransferStartUpload", **ids, **about})

    for label in ("Hidden upload", "Slider"):
        start(label, label)
    served.goes_on(page)
    assert not served.access.uploads.under_way
    for number in range(20):
        start(str(number), "Upload")
    until(lambda: len(served.told) == 20 - LIMITS.uploads, "the refusals")
    assert len(served.access.uploads.under_way) == LIMITS.uploads
    page.close()
    until(lambda: not served.access.uploads.under_way, "their end")


def test_no_server_of_the_viewer_is_without_access_control() -> None:
    """One socket guarded and another not: CVE-2026-39987 of marimo, CVE-2024-28179 of Jupyter."""
    root = Path(__file__).resolve().parents[4] / "app"
    makers = [path.name for path in root.rglob("*.py") if "ViserServer(" in path.read_text("utf-8")]
    assert makers == ["guard.py"]
