"""What pages say: anything that the viewer's own page could not send stops here."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
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
def gui() -> Iterator[viser.GuiApi]:
    with started_server() as server:
        yield server.gui


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
def test_whatever_comes_it_is_read_or_refused(
    kind: str, fields: dict[str, Any], noise: bytes
) -> None:
    read({**fields, "type": kind})
    for frame in (noise, msgspec.msgpack.encode({**fields, "type": kind})[:-1]):
        read_message(frame)


def test_numbers_must_be_numbers_within_bounds(gui: viser.GuiApi) -> None:
    slider = gui.add_slider("Length-scale", 0.1, 1.0, 0.1, 0.3)
    whole = gui.add_slider("Minimum inliers", 3, 50, 1, 8)
    number = gui.add_number("Association", 0, min=0, step=1)
    for widget, fine in ((slider, 1.0), (slider, 0.1 * 3), (slider, 1), (whole, 8.0), (number, 7)):
        assert why_not(widget, {"value": fine}) is None
    for widget in (slider, whole, number):
        for value in (NAN, INFINITY, -INFINITY, True, None, "5", [5], {"a": 5}, 2**64 - 1, 1e300):
            assert why_not(widget, {"value": value}) is not None
    assert why_not(slider, {"value": 1.01}) == "must be from 0.1 to 1, got 1.01"
    assert why_not(whole, {"value": 8.5}) == "must be a whole number, got 8.5"
    assert why_not(number, {"value": LARGEST_NUMBER + 1}) == (
        "must be at most 9.007199255e+15, got a number beyond all bounds"
    )


def test_a_slider_takes_its_end_for_what_lies_a_hair_beyond(gui: viser.GuiApi) -> None:
    slider = gui.add_slider("Point size [m]", 0.005, 0.2, 0.005, 0.03)
    for end, beyond in ((0.005, -1.0), (0.2, 1.0)):
        value = end + beyond * 1e-10 * 0.195
        assert checked_value(slider, {"value": value}) == end
        assert why_not(slider, {"value": end + beyond * 1e-8}) is not None
    assert checked_value(slider, {"value": 0.07}) == 0.07
    number = gui.add_number("Height [m]", 0.5, min=0.0)
    for value in (-1e-10, -5.0):  # it is typed, so not by steps
        assert why_not(number, {"value": value}) is not None


def test_a_choice_must_be_offered(gui: viser.GuiApi) -> None:
    """A dropdown's value outside of its options made Gradio read any file (CVE-2024-1728)."""
    choice = gui.add_dropdown("Layer", ("elevation", "gradient"))
    buttons = gui.add_button_group("Open", ("Load", "Load demo"))
    assert why_not(choice, {"value": "gradient"}) is None
    assert why_not(buttons, {"value": "Load demo"}) is None
    for value in ("/etc/passwd", "", "Elevation", 0, None, ["gradient"], {"path": "/etc/passwd"}):
        assert why_not(choice, {"value": value}) is not None
        assert why_not(buttons, {"value": value}) is not None
    said = why_not(choice, {"value": "x" * 10**6})
    assert said is not None
    assert len(said) < 100


def test_a_text_has_a_length_and_one_line(gui: viser.GuiApi) -> None:
    box = gui.add_text("Folder", "")
    assert why_not(box, {"value": "/data/Größe 1/π"}) is None
    for value in ("x" * (LONGEST_TEXT + 1), "a\0b", "a\nb", "\x1b[2J", 5, None, ["a"], b"a"):
        assert why_not(box, {"value": value}) is not None


def test_switches_are_on_or_off(gui: viser.GuiApi) -> None:
    for widget in (gui.add_checkbox("mutual", True), gui.add_button("Undo")):
        assert why_not(widget, {"value": True}) is None
        for value in (1, "true", None, []):
            assert why_not(widget, {"value": value}) is not None


def test_nothing_but_the_value_can_be_changed(gui: viser.GuiApi) -> None:
    """viser sets whatever attribute a message names, its own callbacks and flags included."""
    box = gui.add_checkbox("mutual", True)
    for updates in ({"removed": True}, {"update_cb": []}, {"value": True, "sync_cb": None}, {}):
        assert why_not(box, updates) == "only its value can be changed"
    bar, upload = gui.add_progress_bar(0.0), gui.add_upload_button("Upload")
    for widget in (bar, upload):  # no page changes these
        assert why_not(widget, {"value": 5}) == "cannot be changed"


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
    assert not is_small_enough(b"GIF89a" + bytes(40))
