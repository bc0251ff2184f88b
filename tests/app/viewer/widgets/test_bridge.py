"""What the bridge takes from a page."""

import json

import pytest
import viser

from app.viewer.widgets.bridge import Bridge, Data, Said, read_said
from tests.support.page import FakePage


def test_a_message_is_read() -> None:
    data = {"query": "003", "row": 3, "shift": True, "none": None}
    text = json.dumps({"number": 1, "times": 2, "name": "cell", "data": data})
    assert read_said(text) == Said(1, 2, "cell", data)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[" * 4000,
        '{"number":1,"times":1,"name":"cell"}',
        '{"number":1,"times":1,"name":"cell","data":{"a":{}}}',
        '{"number":1,"times":1,"name":"cell","data":{"a":[1]}}',
        '{"number":1,"times":1,"name":"cell","data":{},"more":1}',
        '{"number":1,"times":1,"name":7,"data":{}}',
        '{"number":1,"times":1,"name":"\ud800","data":{}}',
    ],
)
def test_what_no_script_of_ours_writes_is_nothing(text: str) -> None:
    assert read_said(text) is None


def test_what_is_said_again_is_heard_once(server: viser.ViserServer) -> None:
    bridge, page = Bridge(server), FakePage()
    heard: list[Data] = []
    bridge.hear("cell", lambda _, data: heard.append(data))
    for number, times in ((1, 1), (2, 2), (2, 3), (1, 4), (2, 5)):
        said = {"number": number, "times": times, "name": "cell", "data": {"row": number}}
        bridge.take(page, json.dumps(said))  # type: ignore[arg-type]
    assert heard == [{"row": 1}, {"row": 2}]


def test_each_page_counts_what_it_says_for_itself(server: viser.ViserServer) -> None:
    bridge, pages = Bridge(server), [FakePage(), FakePage()]
    pages[1].client_id = 2
    heard: list[object] = []
    bridge.hear("cell", lambda page, _: heard.append(page))
    for page in pages:
        said = {"number": 1, "times": 1, "name": "cell", "data": {}}
        bridge.take(page, json.dumps(said))  # type: ignore[arg-type]
    assert heard == pages
