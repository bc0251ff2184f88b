"""Numbers that are typed with real keys, and how many steps of undo a press is."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]

NAME, OTHER = "Length-scale", "Noise"


def length_scale(page: Any) -> float:
    return float(page.viewer.sessions[0].state.params.map.length_scale)


def type_and(page: Any, text: str, end: str, label: str = NAME) -> None:
    """Replace the text of a box by real keys; what ends it is a key, or a click elsewhere."""
    box = page.number_box(label)
    box.click()
    box.press("Control+a")
    box.press("Delete")
    box.press_sequentially(text)
    if end == "click":
        page.page.get_by_test_id("verdict").click()
    else:
        page.page.keyboard.press(end)


def test_what_a_person_types_is_taken_or_refused_in_words(page: Any) -> None:
    box = page.number_box(NAME)
    for text, end, value in (
        ("0,8", "Enter", 0.8),
        (".5", "click", 0.5),
        ("0.6", "ArrowUp", 0.6),
        ("5", "Enter", 5.0),  # allowed, though the slider ends before
    ):
        type_and(page, text, end)
        page.wait(lambda value=value: length_scale(page) == value, f"{text} taken")
        page.wait(lambda value=value: page.value(NAME) == value, "the thumb")
        page.wait(lambda value=value: box.input_value() == f"{value:g}", "the box")
        assert not page.say("not-taken")
    page.wait(
        lambda: "Up to date" in page.status(), "the picture, whose status is the next to come"
    )
    for text, end, said in (
        ("abc", "Tab", "must be a number such as 0.8, got 'abc'"),
        ("-3", "click", "from 0.01 to 100 m, got -3"),
        ("", "Enter", "got nothing"),
    ):
        type_and(page, text, end)
        page.wait(lambda said=said: said in page.say("not-taken"), f"why {text!r} is not taken")
        page.wait(lambda said=said: said in page.status(), "the same in the status")
        assert (length_scale(page), box.input_value()) == (5.0, "5")
    box.click()
    assert not page.say("not-taken")
    page.page.keyboard.press("Control+a")
    page.page.keyboard.insert_text("0,7")  # pasted
    page.page.keyboard.press("Enter")
    page.wait(lambda: page.value(NAME) == length_scale(page) == 0.7, "what was pasted")
    page.page.keyboard.press("ArrowUp")
    page.wait(lambda: box.input_value() == "0.735", "one key further")
    page.wait(lambda: length_scale(page) == 0.735, "the parameter")
    box.press_sequentially("9")
    page.page.keyboard.press("Escape")
    assert box.input_value() == "0.735"
    type_and(page, "0,05", "Enter", OTHER)
    page.wait(lambda: page.value(OTHER) == 0.05, "the other box")


def come(page: Any, noise_std: float) -> None:
    """Have a noise come from elsewhere, as a fit or another page brings it."""
    desk = page.viewer.sessions[0].desk
    asked = desk.state.asked
    desk.change(params=replace(asked, map=replace(asked.map, noise_std=noise_std)))
    box = page.number_box(OTHER)
    page.wait(lambda: box.input_value() == f"{noise_std:g}", "the value that comes")


def test_a_value_that_comes_while_a_person_types_changes_nothing_of_it(page: Any) -> None:
    state, keys = (lambda: page.viewer.sessions[0].state), page.page.keyboard
    box = page.number_box(OTHER)
    box.click()
    box.press("Control+a")
    keys.type("0,")
    come(page, 0.033)
    keys.type("07")
    assert box.input_value() == "0,07"
    keys.press("Enter")
    page.wait(lambda: state().params.map.noise_std == 0.07, "what was typed")
    page.wait(lambda: box.input_value() == "0.07", "the box")
    # All that is selected is replaced, by keys that take away and by keys that write.
    keys.press("Control+a")
    come(page, 0.034)
    keys.press("Delete")
    keys.type("0,0")
    keys.press("Control+a")
    come(page, 0.035)
    keys.type("0,08")
    assert box.input_value() == "0,08"
    keys.press("Enter")
    page.wait(lambda: state().params.map.noise_std == 0.08, "what was typed in its place")
    page.wait(lambda: box.input_value() == "0.08", "the box")
    # What is selected no more is not.
    keys.press("Control+a")
    keys.press("ArrowRight")
    come(page, 0.036)
    keys.type("5")
    assert box.input_value() == "0.0365"
    keys.press("Escape")


@pytest.fixture
def throttled(page: Any, request: pytest.FixtureRequest) -> Iterator[Any]:
    """The page on a slower processor."""
    session = page.page.context.new_cdp_session(page.page)
    session.send("Emulation.setCPUThrottlingRate", {"rate": request.param})
    yield page
    session.send("Emulation.setCPUThrottlingRate", {"rate": 1})


@pytest.mark.parametrize(
    "throttled", [1, pytest.param(6, marks=pytest.mark.nightly)], indirect=True
)
def test_a_press_is_one_step_of_undo(throttled: Any) -> None:
    page, session = throttled, throttled.viewer.sessions[0]
    start = session.state.asked
    page.drag(NAME, 30, steps=20, pause_ms=60)  # longer than any pause that could end it
    page.drag(NAME, -20, steps=5)
    page.drag("Variance mask", 15, steps=5)
    page.thumb("Minimum score").focus()
    for _ in range(3):
        page.page.keyboard.press("ArrowRight")
    type_and(page, "0,07", "Enter", OTHER)
    page.wait(lambda: session.state.params.map.noise_std == 0.07, "the typed number")
    for left in range(6, -1, -1):
        before = session.state.asked
        assert before != start
        page.press("Undo")
        page.wait(lambda before=before: session.state.asked != before, f"an undo, {left} left")
    assert session.state.asked == start


def test_a_chip_says_where_a_value_comes_from_and_leads_back(page: Any) -> None:
    chip = page.widget(NAME).locator("xpath=following-sibling::*[1]").locator("[data-chip]")
    page.wait(lambda: chip.inner_text() == "auto", "an automatic length-scale")
    automatic = page.number_box(NAME).input_value()
    type_and(page, "0.8", "Enter")
    page.wait(lambda: chip.inner_text().startswith("set"), "a length-scale that is set")
    chip.click()
    page.wait(lambda: chip.inner_text() == "auto", "the way back")
    page.wait(lambda: page.number_box(NAME).input_value() == automatic, "the number of before")
    assert page.viewer.sessions[0].state.asked.map.length_scale is None
