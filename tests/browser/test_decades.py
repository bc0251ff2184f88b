"""Sliders over decades in a browser: equal ways are equal factors, by mouse, keys and touch."""

import math
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]

NAME = "Length-scale"
MARKED = "Variance mask"
"""Which has a default, and so a mark."""
LOW, HIGH = 0.05, 2.0


def place_of(page: Any, name: str, part: str = "[role=slider]") -> float:
    """Give where the thumb of a slider, or another part, stands on the track, from 0 to 1."""
    slider = page.widget(name)
    track = slider.locator(".mantine-Slider-trackContainer").bounding_box()
    box = slider.locator(part).first.bounding_box()
    return float((box["x"] + box["width"] / 2 - track["x"]) / track["width"])


def share_of(page: Any, name: str) -> float:
    """Give where a slider's value belongs."""
    low, high = (
        float(page.thumb(name).get_attribute(f"aria-value{end}")) for end in ("min", "max")
    )
    return math.log(page.value(name) / low) / math.log(high / low)


def stands_right(page: Any) -> bool:
    return abs(place_of(page, NAME) - share_of(page, NAME)) < 0.02


def test_thumb_and_mark_stand_on_a_scale_of_factors_and_a_drag_multiplies(page: Any) -> None:
    assert stands_right(page)
    default = share_of(page, MARKED)
    assert place_of(page, MARKED, ".mantine-Slider-mark") == pytest.approx(default, abs=0.03)
    for value in ("1.9", "0.1"):
        page.type_value(NAME, value)
        page.wait(lambda value=value: page.value(NAME) == float(value), "what was typed")
        page.wait(lambda: stands_right(page), "the thumb in its place")
    track = page.widget(NAME).locator(".mantine-Slider-trackContainer").bounding_box()
    before = page.value(NAME)
    page.drag(NAME, round(track["width"] / 5), steps=6)
    ratio = pytest.approx((HIGH / LOW) ** 0.2, rel=0.15)
    page.wait(lambda: page.value(NAME) / before == ratio, "a factor")
    page.drag(NAME, 400)
    page.wait(lambda: page.value(NAME) == HIGH, "the end")
    assert not page.page.locator(".mantine-Tooltip-tooltip:visible").count()
    page.page.mouse.move(5, 5)
    assert page.page.evaluate("document.documentElement.dataset.sliderHeld") is None
    page.wait(
        lambda: page.viewer.sessions[0].state.params.map.length_scale == HIGH, "the parameter"
    )
    page.press("Reset parameters")
    page.wait(lambda: LOW < page.value(NAME) < HIGH and stands_right(page), "the thumb back")


def test_keys_multiply_whole_numbers_move_and_so_does_a_finger(page: Any) -> None:
    page.thumb(NAME).focus()
    before = page.value(NAME)
    page.page.keyboard.press("ArrowRight", delay=80)
    page.wait(lambda: page.value(NAME) != before, "another length-scale")
    assert page.value(NAME) / before == pytest.approx(1.05, rel=0.01)
    page.page.keyboard.press("Home")
    page.wait(lambda: page.value(NAME) == LOW, "the low end")
    page.page.get_by_text("More", exact=True).click()
    page.wait(lambda: page.thumb("RANSAC motions").is_visible(), "a slider of whole numbers")
    low = int(page.thumb("RANSAC motions").get_attribute("aria-valuemin"))
    page.thumb("RANSAC motions").focus()
    page.page.keyboard.press("Home")
    page.wait(lambda: page.value("RANSAC motions") == low, "the low end")
    page.page.keyboard.press("ArrowRight")
    page.wait(lambda: page.value("RANSAC motions") == low + 1, "the next whole number")
    page.widget(NAME).evaluate(
        """root => {
          const track = root.querySelector('.mantine-Slider-trackContainer');
          const box = track.getBoundingClientRect(), y = box.top + box.height / 2;
          const touch = share => new Touch({identifier: 1, target: track, clientY: y,
            clientX: box.left + share * box.width});
          const fire = (name, touches) => track.dispatchEvent(new TouchEvent(name,
            {touches, changedTouches: touches, bubbles: true, cancelable: true}));
          fire('touchstart', [touch(.2)]); fire('touchmove', [touch(.5)]); fire('touchend', []);
        }"""
    )
    middle = math.sqrt(LOW * HIGH)
    page.wait(lambda: page.value(NAME) == pytest.approx(middle, rel=0.03), "the middle")
