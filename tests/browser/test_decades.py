"""Sliders over decades in a browser: equal ways are equal factors, by mouse, keys and touch."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from tests.browser.conftest import QUICK

pytestmark = [pytest.mark.browser, pytest.mark.slow]

Open = Callable[..., Any]
NAME = "Length-scale"
LOW, HIGH = 0.05, 2.0


def place_of(page: Any, part: str = "[role=slider]") -> float:
    """Give where the thumb, or another part, stands on the track, from 0 to 1."""
    slider = page.widget(NAME)
    track = slider.locator(".mantine-Slider-trackContainer").bounding_box()
    box = slider.locator(part).first.bounding_box()
    return float((box["x"] + box["width"] / 2 - track["x"]) / track["width"])


def share_of(value: float) -> float:
    return math.log(value / LOW) / math.log(HIGH / LOW)


def stands_right(page: Any) -> bool:
    return abs(place_of(page) - share_of(page.value(NAME))) < 0.02


def test_thumb_and_mark_stand_on_a_scale_of_factors(open_viewer: Open) -> None:
    numbers = replace(QUICK.map, length_scale=0.4, noise_std=0.04)
    page = open_viewer(replace(QUICK, map=numbers))
    page.settle()
    assert stands_right(page)
    default = share_of(page.value(NAME))
    assert place_of(page, ".mantine-Slider-mark") == pytest.approx(default, abs=0.03)
    for value in ("0.06", "0.5", "1.9"):
        page.type_value(NAME, value)
        page.wait(lambda: stands_right(page), "the thumb in its place")
    page.press("Reset parameters")
    page.wait(lambda: stands_right(page), "the thumb back in its place")
    assert page.value(NAME) > 0.1


def test_a_drag_multiplies(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    track = page.widget(NAME).locator(".mantine-Slider-trackContainer").bounding_box()
    page.type_value(NAME, "0.1")
    page.wait(lambda: stands_right(page), "the thumb in its place")
    ratios: list[float] = []
    for _ in range(3):
        before = page.value(NAME)
        page.drag(NAME, round(track["width"] / 5), steps=6)
        ratios.append(page.value(NAME) / before)
    assert ratios == pytest.approx([(HIGH / LOW) ** 0.2] * 3, rel=0.15)
    assert stands_right(page)
    page.settle()
    state = page.viewer.sessions[0].state
    assert state.params.map.length_scale == page.value(NAME)
    page.drag(NAME, 400)
    assert page.value(NAME) == HIGH
    assert not page.page.locator(".mantine-Tooltip-tooltip:visible").count()
    page.page.mouse.move(5, 5)
    assert page.page.evaluate("document.documentElement.dataset.sliderHeld") is None


def test_keys_multiply_and_whole_numbers_move(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
    page.thumb(NAME).focus()
    before = page.value(NAME)
    page.page.keyboard.press("ArrowRight", delay=80)
    page.wait(lambda: page.value(NAME) != before, "another length-scale")
    assert page.value(NAME) / before == pytest.approx(1.05, rel=0.01)
    page.page.keyboard.press("Home")
    page.wait(lambda: page.value(NAME) == LOW, "the low end")
    page.page.get_by_text("More", exact=True).click()
    page.wait(lambda: page.thumb("hypotheses").is_visible(), "a slider of whole numbers")
    low = int(page.thumb("hypotheses").get_attribute("aria-valuemin"))
    page.thumb("hypotheses").focus()
    page.page.keyboard.press("Home")
    page.wait(lambda: page.value("hypotheses") == low, "the low end")
    page.page.keyboard.press("ArrowRight")
    page.wait(lambda: page.value("hypotheses") == low + 1, "the next whole number")


def test_a_finger_moves_it(open_viewer: Open) -> None:
    page = open_viewer()
    page.settle()
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
