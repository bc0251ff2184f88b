"""A phone, upright and on its side: all of it fits, and a finger reaches it."""

import itertools
from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
WIDTH, HEIGHT = 390, 844
SLIDERS = """() => [...document.querySelectorAll('[role=slider]')].filter(
    thumb => thumb.checkVisibility({opacityProperty: true})).map(thumb => {
        const {top, width, height} = thumb.getBoundingClientRect();
        const root = thumb.closest('.mantine-Slider-root');
        const typed = root.nextElementSibling.querySelector('input:not([type=hidden])');
        const end = thumb.parentElement.getBoundingClientRect().right;
        return {top, width, height, end, box: typed.getBoundingClientRect().left,
            cut: typed.scrollWidth > typed.clientWidth};
    })"""


def test_it_fits_a_phone_and_a_finger(open_viewer: Callable[..., Any]) -> None:
    page = open_viewer(size=(WIDTH, HEIGHT))
    page.wait(lambda: len(page.page.evaluate(SLIDERS)) > 4, "sliders")
    page.rest()
    sliders = page.page.evaluate(SLIDERS)
    for one, next_one in itertools.pairwise(sliders):
        assert next_one["top"] - one["top"] >= 32  # of which 24 are the thumb
    for slider in sliders:
        assert min(slider["width"], slider["height"]) >= 24
        assert slider["end"] + 12 <= slider["box"]  # where it stands at its end
        assert not slider["cut"]
    reach_the_strip(page)
    page.open()
    page.page.get_by_role("button", name="Expand panel View").click()
    tab = page.page.get_by_role("tab", name="View")
    page.wait(lambda: (at := tab.bounding_box()) is not None and at["y"] < 600, "tabs in view")
    page.press("Explore")
    time = page.page.get_by_test_id("time")
    time.wait_for()
    box = time.bounding_box()
    assert box["height"] >= 24
    assert box["width"] >= 100
    rail = page.page.get_by_test_id("mode").bounding_box()
    assert (rail["x"], rail["width"]) == (0, WIDTH)


def reach_the_strip(page: Any) -> None:
    """Choose a pair from the strip over the canvas."""
    strip = page.page.get_by_test_id("pair-strip")
    page.wait(
        lambda: (box := strip.bounding_box()) is not None and box["x"] + box["width"] <= 390,
        "a strip that fits",
    )
    page.wait(lambda: page.opacities() == {"1"}, "arrows, though no mouse is near")
    for part in strip.locator("button, [data-step]").all():
        box = part.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 24
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
        assert box["y"] > HEIGHT / 3  # within reach of a thumb
    strip.locator("[data-step='next database']").click()
    page.wait(lambda: page.pair() == ("007", "002"), "the next database")
    page.choose_submap("query", "005")
    page.wait(lambda: page.pair() == ("005", "002"), "the query of the list")
    before = page.viewer.sessions[0].state
    strip.locator("button[data-role=query]").click()
    page.page.get_by_role("combobox", name="Choose the query").fill("nowhere")
    page.wait(lambda: "No submap" in page.say("pair-more"), "that there is none")
    page.page.mouse.click(20, 200)  # beside it
    page.page.get_by_test_id("pair-list").wait_for(state="hidden")
    assert page.viewer.sessions[0].state is before


def test_half_of_a_phone_on_its_side_is_picture(open_viewer: Callable[..., Any]) -> None:
    page = open_viewer(size=(HEIGHT, WIDTH))
    canvas = page.page.get_by_test_id("over-canvas")

    def width() -> float:
        return float(canvas.bounding_box()["width"])

    page.wait(lambda: width() > HEIGHT / 2, "the left panel to be put away")
    page.page.get_by_text("All pairs", exact=True).click()
    page.wait(lambda: width() < HEIGHT / 2, "the panel")
    page.tab("Save")
    page.page.get_by_role("button", name="Copy link").wait_for()
    assert width() < HEIGHT / 2  # whoever wanted it keeps it
