"""What pages say: anything that the viewer's own page could not send stops here."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.viewer.server.inputs import (
    LARGEST_NUMBER,
    LONGEST_TEXT,
    SPOKEN,
    RefusedValue,
    checked_value,
    is_small_enough,
    read_message,
    shown,
)
from tests.support.page import CAMERA
from tests.support.server import started_server

NAN, INFINITY = float("nan"), float("inf")


def read(message: object) -> dict[str, Any] | None:
    return read_message(msgspec.msgpack.encode(message))


def why_not(widget: Any, updates: dict[str, object]) -> str | None:
    try:
        checked_value(widget, updates)
    except RefusedValue as refused:
        return str(refused)
    return None


@pytest.fixture(scope="module")
def widgets() -> Iterator[dict[str, Any]]:
    with started_server() as server:
        gui = server.gui
        yield {
            "slider": gui.add_slider("Length-scale", 0.1, 1.0, 0.1, 0.3),
            "whole": gui.add_slider("Minimum inliers", 3, 50, 1, 8),
            "number": gui.add_number("Association", 0, min=0, step=1),
            "choice": gui.add_dropdown("Layer", ("elevation", "gradient")),
            "buttons": gui.add_button_group("Open", ("Load", "Load demo")),
            "text": gui.add_text("Folder", ""),
            "switch": gui.add_checkbox("mutual", True),
            "button": gui.add_button("Undo"),
            "bar": gui.add_progress_bar(0.0),
            "upload": gui.add_upload_button("Upload"),
        }


@pytest.mark.parametrize(
    "frame", ["text", b"", b"\xc1", b"\x81", b"\x93\x01", b"\x00", b"\x80", b"\x91" * 5000, None]
)
def test_a_frame_that_is_no_message_is_not_acted_on(frame: object) -> None:
    assert read_message(frame) is None


def test_what_the_page_sends_is_read() -> None:
    assert read(CAMERA) is not None
    assert read({"type": "GuiUpdateMessage", "uuid": "x", "updates": {"value": 1}}) is not None
    assert read(CLICK) is not None
    assert read(PART) is not None
    assert read({**CLICK, "instance_index": 3, "modifier": "shift", "owner": "7"}) is not None
    pointer = {"event_type": "click", "screen_pos": [[0.1, 0.2]], "modifier": None}
    ray = {"ray_origin": [1, 2, 3], "ray_direction": [0.0, 0.0, -1.0]}
    assert read({"type": "ScenePointerMessage", **pointer, **ray}) is not None
    for other in (
        {"ray_origin": None},
        {"ray_direction": None},
        {"screen_pos": []},
        {"screen_pos": [[0.1, 0.2], [0.3, 0.4]]},
        {"event_type": "rect-select"},
    ):
        assert read({"type": "ScenePointerMessage", **pointer, **ray, **other}) is None


CLICK = {
    "type": "SceneNodeClickMessage",
    "name": "/pair/query",
    "instance_index": None,
    "ray_origin": [1, 2.5, 3],
    "ray_direction": [0, 0, -1],
    "screen_pos": [0.5, 0.5],
    "modifier": None,
}


PART = {
    "type": "FileTransferPart",
    "source_component_uuid": "x",
    "transfer_uuid": "y",
    "part_index": 0,
    "content": b"x",
}


@pytest.mark.parametrize(
    "message",
    [
        {"type": "ShareUrlRequest"},  # would open the viewer to the internet
        {"type": "ShareUrlDisconnect"},
        {"type": "GuiFormDirtyMessage", "uuid": "x"},  # would be kept for all pages to come
        {"type": "GuiFormSubmitMessage", "uuid": "x"},
        {"type": "GuiHtmlMessage", "uuid": "x"},
        {"type": "Message"},
        {"type": "__class__"},
        {"type": "GuiUpdateMessage", "uuid": "x"},
        {"type": "GuiUpdateMessage", "uuid": 7, "updates": {}},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": []},
        {"type": "GuiUpdateMessage", "uuid": "x", "updates": {}, "excluded_self_client": 0},
        {"type": "GuiUpdateMessage", "uuid": "x" * 2000, "updates": {}},
        {**CAMERA, "position": (NAN, 0.0, 0.0)},
        {**CAMERA, "position": (0.0, 0.0)},
        {**CAMERA, "position": (1e300, INFINITY, 0.0)},
        {**CAMERA, "wxyz": "1000"},
        {**CAMERA, "fov": None},
        {**CAMERA, "image_height": 2**63},
        {**CAMERA, "surprise": 1},
        {**CLICK, "modifier": "evil"},
        {**CLICK, "name": ["/pair"]},
        {**CLICK, "instance_index": True},
        {"type": "CommandTriggerMessage", "uuid": {"$ne": None}},
        {**PART, "content": "eA=="},
        {**PART, "content": [1, 2]},
    ],
)
def test_what_no_page_says_is_not_acted_on(message: dict[str, Any]) -> None:
    assert read(message) is None


json_like = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(max_examples=40)
@given(
    st.sampled_from([kind.__name__ for kind in SPOKEN]),
    st.dictionaries(st.text(), json_like),
    st.binary(),
)
def test_whatever_comes_raises_nothing(kind: str, fields: dict[str, Any], noise: bytes) -> None:
    read({**fields, "type": kind})
    for frame in (noise, msgspec.msgpack.encode({**fields, "type": kind})[:-1]):
        read_message(frame)


NO_NUMBER = (NAN, INFINITY, -INFINITY, True, None, "5", [5], {"a": 5}, 2**64 - 1, 1e300)
NO_CHOICE = ("/etc/passwd", "", "Elevation", 0, None, ["gradient"], {"path": "/etc/passwd"})
NO_SWITCH = (1, "true", None, [])
NO_TEXT = ("x" * (LONGEST_TEXT + 1), "a\0b", "a\nb", "\x1b[2J", 5, None, ["a"], b"a")


@pytest.mark.parametrize(
    ("name", "fine", "wrong"),
    [
        ("slider", (1.0, 0.1 * 3, 1), (*NO_NUMBER, 1.01)),
        ("whole", (8.0, 8), (*NO_NUMBER, 8.5)),
        ("number", (7,), (*NO_NUMBER, -1e-10, -5.0)),  # it is typed: no hair is too much
        # A dropdown's value outside of its options made Gradio read any file (CVE-2024-1728).
        ("choice", ("gradient",), NO_CHOICE),
        ("buttons", ("Load demo",), NO_CHOICE),
        ("text", ("/data/Größe 1/π",), NO_TEXT),
        ("switch", (True,), NO_SWITCH),
        ("button", (True,), NO_SWITCH),
        ("bar", (), (5,)),
        ("upload", (), (5,)),
    ],
)
def test_a_widget_takes_what_a_person_can_give_it_and_nothing_else(
    widgets: dict[str, Any], name: str, fine: tuple[object, ...], wrong: tuple[object, ...]
) -> None:
    for value in fine:
        assert checked_value(widgets[name], {"value": value}) == value
    for value in wrong:
        assert why_not(widgets[name], {"value": value}) is not None
    # viser sets whatever attribute a message names, its own callbacks and flags included.
    for updates in ({"removed": True}, {"update_cb": []}, {"value": True, "sync_cb": None}, {}):
        assert why_not(widgets[name], updates) == "only its value can be changed"


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("slider", 1.01, "must be from 0.1 to 1, got 1.01"),
        ("whole", 8.5, "must be a whole number, got 8.5"),
        ("number", -1, "must be at least 0, got -1"),
        ("number", LARGEST_NUMBER + 1, "must be at most 9.007199255e+15, got a number beyond all "),
        ("choice", "x" * 10**6, "offers no such choice as 'xxxx"),
        ("text", "x" * 5000, "may have 4,096 characters, got 5,000"),
        ("bar", 5, "cannot be changed"),
    ],
)
def test_a_refusal_names_the_rule_and_the_value_in_few_words(
    widgets: dict[str, Any], name: str, value: object, words: str
) -> None:
    text = why_not(widgets[name], {"value": value})
    assert text is not None
    assert text.startswith(words)
    assert len(text) < 100


def test_a_slider_takes_its_end_for_what_lies_a_hair_beyond(widgets: dict[str, Any]) -> None:
    for end, beyond in ((0.1, -1.0), (1.0, 1.0)):
        value = end + beyond * 1e-10 * 0.9
        assert checked_value(widgets["slider"], {"value": value}) == end
        assert why_not(widgets["slider"], {"value": end + beyond * 1e-8}) is not None


def test_a_value_is_shown_in_few_words() -> None:
    assert shown(0.5) == "0.5"
    assert len(shown("x" * 10**6)) <= 40
    assert shown(10**5000) == "a number beyond all bounds"  # Python would refuse to write it


def test_a_picture_must_not_unpack_to_more_than_a_screen() -> None:
    def png(width: int, height: int) -> bytes:
        size = width.to_bytes(4, "big") + height.to_bytes(4, "big")
        return b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + size

    assert is_small_enough(png(3840, 2160))
    assert is_small_enough(b"")
    assert not is_small_enough(png(100_000, 100_000))
    assert not is_small_enough(png(0, 5))
    assert not is_small_enough(b"GIF89a" + png(3840, 2160)[6:])
