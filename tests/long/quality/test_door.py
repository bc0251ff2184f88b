"""The viewer's server under crowds and bad company; takes seconds, so apart from the others."""

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from app.viewer.server.guard import open_server
from app.viewer.server.limits import Limits
from tests.long.soak.watch import Served
from tests.support.page import ProtocolPage

Slider: TypeAlias = viser.GuiSliderHandle[int]

BUDGET = 800
"""Of the viewer, as ``--memory`` says it [MB]."""


@pytest.fixture(scope="module")
def server() -> Iterator[viser.ViserServer]:
    made, _ = open_server("127.0.0.1", 0, limits=Limits(upload_bytes=1_000_000))
    yield made
    made.stop()


@pytest.fixture(scope="module")
def slider(server: viser.ViserServer) -> Slider:
    return server.gui.add_slider("Slider", 0, 10**6, 1, 0)


@pytest.fixture
def page(server: viser.ViserServer, slider: Slider) -> Iterator[ProtocolPage]:
    del slider  # it is there before the page
    visitor = ProtocolPage(f"http://127.0.0.1:{server.get_port()}")
    visitor.wait(lambda: visitor.find("Slider") is not None, "the slider")
    yield visitor
    visitor.close()


def is_well(slider: Slider, page: ProtocolPage) -> None:
    """A page's next value is taken within 2 s."""
    value = slider.value + 1
    page.set("Slider", value)
    page.wait(lambda: slider.value == value, "the value", timeout=2.0)


def line_to(server: viser.ViserServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.get_port()), timeout=10)


def knock(server: viser.ViserServer) -> Any:
    return knock_at(f"http://127.0.0.1:{server.get_port()}")


def knock_at(url: str) -> Any:
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    address = url.replace("http", "ws")
    return connect(address, origin=Origin(url), subprotocols=[protocol], max_size=None)


def test_1000_half_open_connections_are_shed(
    server: viser.ViserServer, slider: Slider, page: ProtocolPage
) -> None:
    lines = [line_to(server) for _ in range(1000)]
    for line in lines[::2]:
        with suppress(OSError):
            line.sendall(b"GET / HTTP/1.1\r\nHost:")
    is_well(slider, page)
    knock(server).close()
    for line in lines:
        line.close()


def test_300_pages_at_once_are_served_or_refused(
    server: viser.ViserServer, slider: Slider, page: ProtocolPage
) -> None:
    served: list[Any] = []
    refused = 0
    for _ in range(300):
        try:
            served.append(knock(server))
        except InvalidStatus:
            refused += 1
    assert (len(served), refused) == (99, 201)
    is_well(slider, page)
    for one in served:
        one.close()


def test_slow_and_vanishing_readers_hold_up_nobody(
    server: viser.ViserServer, slider: Slider, page: ProtocolPage
) -> None:
    slow = [knock(server) for _ in range(5)]  # these never read
    points = np.random.default_rng(0).normal(size=(100_000, 3)).astype(np.float32)
    for number in range(20):
        server.scene.add_point_cloud("/cloud", points + number, (0, 0, 0), precision="float32")
        if number % 4 == 0:
            slow[number // 4].socket.close()  # without a word
        is_well(slider, page)


def test_60_unfinished_messages_of_30_megabytes_keep_to_the_budget(tmp_path: Path) -> None:
    served = Served("door", f"{BUDGET}MB", tmp_path)
    try:
        lines = [knock_at(served.url) for _ in range(60)]  # these answer pings
        before = served.memory()
        most = before
        head = bytes([2, 0xFF]) + (31_000_000).to_bytes(8, "big") + bytes(4)
        for line in lines:
            with suppress(OSError):  # it has made room already
                line.socket.sendall(head)
                for _ in range(30):
                    line.socket.sendall(bytes(1_000_000))
            most = max(most, served.memory())
        visitor = ProtocolPage(served.url)
        visitor.wait(lambda: "Up to date" in visitor.html(), "the picture")
        visitor.close()
        print(f"\n{before:.0f} MB before, {most:.0f} MB at most, of {BUDGET} MB")
        assert most <= 1.1 * BUDGET
        served.end()
        assert "pages have begun to send more than 200 MB" in served.log.read_text()
    finally:
        served.process.kill()


@pytest.mark.parametrize("seed", [0, 4711, 4712, 4713])
def test_2000_hostile_messages_change_nothing(
    server: viser.ViserServer, slider: Slider, page: ProtocolPage, seed: int
) -> None:
    draw = np.random.default_rng(seed)
    before = slider.value
    names = ["value", "removed", "uuid", "props", "update_cb", "__dict__"]
    values = [float("nan"), 2**64 - 1, -1, "x" * 10_000, None, [], {}, b"\0", True, "../../etc"]

    uuid = page.find("Slider")["uuid"]

    def attack() -> None:
        with knock(server) as hostile:
            for _ in range(2000):
                updates = {str(draw.choice(names)): values[draw.integers(len(values))]}
                message = {"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates}
                hostile.send(msgspec.msgpack.encode(message))

    thread = threading.Thread(target=attack)
    thread.start()
    time.sleep(0.5)
    is_well(slider, page)
    thread.join(30)
    assert not thread.is_alive()
    assert slider.value == before + 1
    assert page.find("Slider")["value"] == before + 1
