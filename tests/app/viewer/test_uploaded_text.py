"""Files of text from a page are read apart from what pages say: none can make the others wait."""

import threading
from collections.abc import Iterator
from typing import Any

import pytest
import viser

from app.viewer.features.params.presets import PresetsTool
from app.viewer.features.save.tab import SaveTab
from app.viewer.server.guard import open_server
from app.viewer.server.limits import Limits
from app.viewer.session.session_file import LARGEST
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.desk import make_desk
from tests.support.page import ProtocolPage
from tests.support.synthetic import make_dataset
from tests.support.widgets import find

STATE = open_dataset(make_dataset(num_points=200), PipelineParams())
DEEP = "x = " + "[" * 5000
DOTS = "a" + ".a" * 49_000
SLOWEST = "".join(f"k{number}{'.a' * 19} = 1\n" for number in range(2000))
"""Of a hundred kinds of 100 kB, this takes the parser longest: a tenth of a second."""


@pytest.fixture
def pages() -> Iterator[tuple[viser.ViserServer, ProtocolPage, ProtocolPage]]:
    server, _ = open_server("127.0.0.1", 0, limits=Limits(upload_bytes=1_000_000))
    desk = make_desk(server, STATE)
    desk.join(SaveTab(desk, lambda saved: None))  # noqa: ARG005
    desk.join(PresetsTool(desk, PipelineParams()))
    server.gui.add_slider("Slider", 0, 1000, 1, 0)
    sender, other = (ProtocolPage(f"http://127.0.0.1:{server.get_port()}") for _ in range(2))
    for page in (sender, other):
        page.wait(lambda page=page: page.find("Slider") is not None, "the widgets")
    yield server, sender, other
    for page in (sender, other):
        page.close()
    server.stop()


@pytest.mark.parametrize(
    ("button", "parser"),
    [
        ("Restore session", "app.viewer.features.save.tab.parse_session"),
        ("Upload parameters", "app.viewer.features.params.presets.parse_toml"),
    ],
)
def test_while_a_file_is_parsed_other_pages_are_served(
    pages: tuple[viser.ViserServer, ProtocolPage, ProtocolPage],
    button: str,
    parser: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server, sender, other = pages
    begun, done = threading.Event(), threading.Event()

    def parse(*args: Any) -> Any:  # noqa: ARG001
        begun.set()
        assert done.wait(120)
        return {}

    monkeypatch.setattr(parser, parse)
    sender.upload(button, "slow.toml", b"x = 1")
    assert begun.wait(120)
    try:
        for page, value in ((other, 3), (sender, 4)):
            page.set("Slider", value)
            page.wait(lambda value=value: find(server, "Slider").value == value, "the slider")
    finally:
        done.set()


def test_the_worst_files_are_answered_and_let_go(
    pages: tuple[viser.ViserServer, ProtocolPage, ProtocolPage],
) -> None:
    server, sender, other = pages
    told = {"Restore session": "saving-message", "Upload parameters": "preset-message"}
    for number, (text, words) in enumerate(
        ((DEEP, "nested more than"), (DOTS, "parts"), (SLOWEST, "unknown"))
    ):
        assert len(text) <= LARGEST
        for button, place in told.items():
            sender.upload(button, f"{number}.toml", text.encode())
            other.set("Slider", 10 * number + len(button))
            sender.wait(
                lambda place=place, words=words: any(
                    place in line and words in line and f"{number}.toml" in line  # noqa: B023
                    for line in (str(w["props"].get("content")) for w in [*sender.widgets.values()])
                ),
                words,
            )
            wanted = 10 * number + len(button)
            other.wait(lambda wanted=wanted: find(server, "Slider").value == wanted, "the slider")
            other.wait(lambda b=button: find(server, b).value.content == b"", "the file to be gone")
