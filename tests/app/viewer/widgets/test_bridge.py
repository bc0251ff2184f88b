"""What the bridge takes from a page."""

import json

import pytest

from app.viewer.widgets.bridge import Said, read_said


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
