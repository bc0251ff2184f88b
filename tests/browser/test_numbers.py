"""Numbers that are typed with real keys, and how many steps of undo a press is."""

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]

Open = Callable[..., Any]
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


def test_what_a_person_types_is_taken_or_refused_in_words(open_viewer: Open) -> None:
    page = open_viewer()
    box = page.number_box(NAME)
    for text, end, value in (
        ("0,8", "Enter", 0.8),
        ("0,1", "Tab", 0.1),
        (".5", "click", 0.5),
        ("1.", "Enter", 1.0),
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
        ("1e9", "Enter", "from 0.01 to 100 m, got 1e9"),
        ("abc", "Tab", "must be a number such as 0.8, got 'abc'"),
        ("-3", "click", "from 0.01 to 100 m, got -3"),
        ("1 000", "Enter", "got '1 000'"),
        ("", "Enter", "got nothing"),
    ):
        type_and(page, text, end)
        page.wait(lambda said=said: said in page.say("not-taken"), f"why {text!r} is not taken")
        assert said in page.status()
        assert (length_scale(page), box.input_value()) == (5.0, "5")
    box.click()
    assert not page.say("not-taken")
    page.page.keyboard.press("Control+a")
    page.page.keyboard.insert_text("0,7")  # pasted
    page.page.keyboard.press("Enter")
    page.wait(lambda: page.value(NAME) == length_scale(page) == 0.7, "what was pasted")
    page.page.keyboard.press("ArrowUp")
    page.wait(lambda: length_scale(page) == 0.735, "one key further")
    box.press_sequentially("9")
    page.page.keyboard.press("Escape")
    assert box.input_value() == "0.735"
    type_and(page, "0,05", "Enter", OTHER)
    page.wait(lambda: page.value(OTHER) == 0.05, "the other box")


def test_a_value_that_comes_while_a_person_types_changes_nothing_of_it(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    session = page.viewer.sessions[0]
    sliders = (handle for handle, _ in session.desk.numbers._boxes.values())
    slider = next(each for each in sliders if str(each.label).startswith(OTHER))
    box = page.number_box(OTHER)
    box.click()
    box.press("Control+a")
    box.press_sequentially("0,")
    slider.value = 0.033
    page.wait(lambda: box.input_value() == "0.033", "the value that comes")
    box.press_sequentially("07")
    assert box.input_value() == "0,07"
    box.press("Enter")
    page.wait(lambda: session.state.params.map.noise_std == 0.07, "what was typed")


def undone(page: Any) -> int:
    """Undo all of it, and count the steps."""
    session = page.viewer.sessions[0]
    steps = 0
    button = page.page.get_by_role("button", name="Undo", exact=True)
    while button.is_enabled():
        before = session.state.params
        button.click()
        page.wait(lambda before=before: session.state.params != before, "an undo")
        page.wait(lambda: session.wait_idle(0.1), "the picture")
        steps += 1
        page.page.wait_for_timeout(200)
    return steps


@pytest.mark.parametrize("slowdown", [1, 6])
def test_a_press_is_one_step_of_undo(open_viewer: Open, slowdown: int) -> None:
    page = open_viewer()
    page.settle()
    session = page.viewer.sessions[0]
    start = session.state.params
    page.page.context.new_cdp_session(page.page).send(
        "Emulation.setCPUThrottlingRate", {"rate": slowdown}
    )
    told: list[tuple[str, float | None]] = []
    numbers = session.desk.numbers
    rested = numbers.rested
    numbers.rested = lambda widget, value: (told.append((widget, value)), rested(widget, value))
    page.drag(NAME, 30, steps=20, pause_ms=60)  # longer than any pause that could end it
    page.drag(NAME, -20, steps=5)
    page.drag("Variance mask", 15, steps=5)
    page.thumb("Minimum score").focus()
    for _ in range(3):
        page.page.keyboard.press("ArrowRight")
    page.wait(lambda: len(told) >= 6, "the end of each press")
    type_and(page, "0,07", "Enter", OTHER)
    page.wait(lambda: session.state.params.map.noise_std == 0.07, "the typed number")
    assert len(told) == 6
    assert undone(page) == 7
    assert session.state.params == start


def test_a_chip_says_where_a_value_comes_from_and_leads_back(open_viewer: Open) -> None:
    page = open_viewer()
    chip = page.widget(NAME).locator("xpath=following-sibling::*[1]").locator("[data-chip]")
    page.wait(lambda: chip.inner_text() == "auto", "an automatic length-scale")
    automatic = page.number_box(NAME).input_value()
    type_and(page, "0.8", "Enter")
    page.wait(lambda: chip.inner_text().startswith("set"), "a length-scale that is set")
    chip.click()
    page.wait(lambda: chip.inner_text() == "auto", "the way back")
    page.wait(lambda: page.number_box(NAME).input_value() == automatic, "the number of before")
    assert page.viewer.sessions[0].state.asked.map.length_scale is None
