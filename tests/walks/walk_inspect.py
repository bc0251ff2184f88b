"""A walk through Inspect, with real events: ``pytest tests/walks/walk_inspect.py -n 0 -s``.

Each step takes a picture of the whole window, whose place is printed, and fails where a picture
is blank, a value is missing, the page logs an error or asks for anything outside.
"""

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from gpgrad_core.arrays import NDArray
from tests.browser.conftest import QUICK, browser, open_viewer  # noqa: F401 - fixtures

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

SIZE = (1400, 860)
NUMBER = r"[-+]?\d+(?:\.\d+)?"
READ_PLACES = ((0.25, 0.45), (0.38, 0.5), (0.62, 0.5), (0.74, 0.56))
"""Where surfaces are clicked on, as shares of the picture."""

Open = Callable[..., "ViewerPage"]


@dataclass
class Tour:
    """A page, and the pictures taken on the way."""

    page: "ViewerPage"
    folder: Path
    count: int = 0

    def picture(self, name: str) -> None:
        """Wait until all is shown, and take the window; its scene must not be blank."""
        self.page.settle()
        self.count += 1
        path = self.folder / f"{self.count:02d}_{name}.png"
        self.page.page.screenshot(path=str(path))
        assert not self.page.is_blank(), path

    def pane(self) -> NDArray[np.uint8]:
        """Take the flat picture."""
        self.page.wait(lambda: self._image().count() == 1, "the flat picture")
        png = self._image().screenshot()
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    def _image(self):  # type: ignore[no-untyped-def] # noqa: ANN202 - Playwright's
        return self.page.page.locator('img[src^="blob:"]:visible')

    def act(self, act: Callable[[], None], name: str) -> None:
        """Act, wait until the scene is another, and take its picture."""
        from tests.browser.chromium import changed  # noqa: PLC0415

        self.page.settle()
        before = self.page.picture()
        act()
        self.page.wait(lambda: changed(before, self.page.picture()) > 5e-5, f"{name}: a change")
        self.picture(name)

    def at(self, share_x: float, share_y: float) -> tuple[float, float]:
        """Give a place of the picture in the window."""
        left, right = self.page.panel_edges()
        return left + share_x * (right - left), share_y * SIZE[1]


def number_after(words: str, text: str) -> float:
    """Read the number that follows some words."""
    found = re.search(re.escape(words) + r"\s*(" + NUMBER + ")", text)
    assert found is not None, f"no number after {words!r} in {text!r}"
    return float(found.group(1))


@pytest.fixture
def tour(open_viewer: Open, tmp_path: Path) -> Tour:  # noqa: F811
    print(f"\npictures: {tmp_path}")  # noqa: T201
    return Tour(open_viewer(QUICK, size=SIZE), tmp_path)


def test_matches_are_looked_at_one_by_one(tour: Tour) -> None:
    page = tour.page
    tour.picture("open")
    page.tab("Inspect")
    flat = tour.pane()
    assert flat.std() > 20
    assert "inliers" in page.say("pane-key")
    tour.picture("inspect")

    tour.act(lambda: page.key("n"), "first_match")
    first = page.say("match")
    assert first.startswith("Association ")
    assert number_after("descriptor distance", first) > 0
    assert 0 <= number_after("residual", first) <= number_after("at most", first)  # it is an inlier
    assert np.abs(tour.pane().astype(int) - flat).max() > 100
    tour.act(lambda: page.key("n"), "next_match")
    assert page.say("match") != first
    tour.act(lambda: page.key("p"), "previous_match")
    assert page.say("match") == first

    box = page.widget("Association")
    box.click()
    box.press("Control+a")
    box.type("10", delay=100)
    page.wait(lambda: page.say("match").startswith("Association 10 of"), "match 10")
    tour.picture("match_10")
    tour.act(lambda: page.key("o"), "outliers_too")
    tour.act(lambda: page.key("l"), "match_registered")
    assert page.say("match").startswith("Association 10 of")
    tour.act(lambda: page.key("t"), "from_above")
    tour.act(lambda: page.key("u"), "nothing_pointed_at")
    assert page.say("match") == ""


def test_registered_maps_are_compared(tour: Tour) -> None:
    from tests.browser.chromium import changed  # noqa: PLC0415

    page = tour.page
    tour.act(lambda: page.key("v"), "swipe")
    tour.act(lambda: page.drag("Swipe", -40), "swipe_further_left")
    tour.act(lambda: page.key("x"), "height_difference")
    legend = page.legend()
    assert legend.startswith("Height difference, query minus database [m]")
    assert 0 < number_after("root mean square", legend) < 0.2
    tour.act(lambda: page.key("t"), "height_difference_from_above")
    page.tab("Inspect")
    assert tour.pane().std() > 20
    tour.picture("height_difference_flat")
    tour.act(lambda: page.key("z"), "both_flat")
    page.tab("View")
    page.wait(lambda: page.legend().startswith("Elevation"), "the elevation")

    page.key("b")
    last, blinks = page.picture(), 0
    for _ in range(40):
        page.page.wait_for_timeout(250)
        now = page.picture()
        if changed(last, now) > 0.005:
            blinks += 1
            tour.count += 1
            page.page.screenshot(path=str(tour.folder / f"{tour.count:02d}_blink.png"))
        last = now
        if blinks == 4:
            break
    assert blinks == 4
    page.key("z")
    tour.act(lambda: page.key("r"), "camera_back")
    tour.act(lambda: page.key("l"), "side_by_side")


def test_values_are_read_and_their_colours_are_the_legends(tour: Tour) -> None:
    page = tour.page
    for switch in ("k", "i"):  # nothing may lie on the surfaces
        tour.act(lambda switch=switch: page.key(switch), f"without_{switch}")
    command(page, "Hillshade")
    page.settle()
    for layout in ("side_by_side", "registered"):
        page.tab("View")
        low, high = legend_ends(page.legend())
        bar = legend_bar(page)
        page.tab("Inspect")
        # Surfaces overlie each other where they are registered: one alone has one colour.
        read = [
            reading
            for place in READ_PLACES
            if (reading := read_at(tour, tour.at(*place))) is not None
        ]
        assert len(read) >= (4 if layout == "side_by_side" else 1)
        for color, words in read:
            distances = np.abs(bar - color).max(axis=1)
            assert distances.min() <= 3, (color, words)  # a colour of the legend, exactly
            told = low + (high - low) * distances.argmin() / (len(bar) - 1)
            assert layout == "side_by_side" or words.startswith("database")
            height = number_after("elevation", words)
            assert abs(np.clip(height, low, high) - told) < 0.03 * (high - low), words
        tour.picture(f"{layout}_read")
        if layout == "side_by_side":
            page.key("u")
            page.tab("View")
            tour.act(lambda: page.choose("Layout", "registered"), "registered")
            tour.act(lambda: page.choose("Compare", "database only"), "database_only")
    # What is pinned follows the sliders.
    assert read_at(tour, tour.at(0.45, 0.5)) is not None
    before = page.say("reading")
    page.drag("Length-scale", 40)
    page.wait(lambda: page.say("reading") != before, "the values of another map")
    tour.picture("values_follow")
    page.shift_click(*tour.at(0.5, 0.02))
    page.wait(lambda: page.page.get_by_text("There is no surface").count() == 1, "a miss told")


def test_the_histogram_stands_on_the_legend_with_the_masks_threshold(tour: Tour) -> None:
    page = tour.page
    histogram = page.page.get_by_test_id("histogram")
    assert histogram.locator("rect").count() > 20
    threshold = page.page.get_by_test_id("mask-threshold")
    assert threshold.count() == 0  # heights have none
    tour.act(lambda: page.key("6"), "mask")
    page.wait(lambda: threshold.count() == 1, "the threshold")
    place = threshold.get_attribute("d")
    assert "the mask's threshold, 0.3 share" in page.legend()
    tour.act(lambda: page.drag("Variance mask", -20), "mask_moved")
    assert threshold.get_attribute("d") != place
    tour.act(lambda: page.key("2"), "standard_deviation")
    assert "the mask's threshold" in page.legend()
    assert number_after("cells;", page.legend()) > 0


def test_commands_are_found_and_listed(tour: Tour) -> None:
    page = tour.page
    page.key("h")
    page.wait(lambda: "View from above" in page.say("help"), "the help page")
    tour.picture("help")
    page.press("Close")
    page.wait(lambda: page.say("help") == "", "the end of the help page")
    page.page.keyboard.press("Control+k")
    page.page.wait_for_timeout(500)
    page.page.keyboard.type("next q", delay=40)
    page.page.wait_for_timeout(500)
    tour.picture("palette")
    card = page.verdict()
    page.page.keyboard.press("Enter")
    page.wait(lambda: page.verdict() != card, "the next query")
    tour.picture("next_query")
    page.key("j")
    page.wait(lambda: "query 009" in page.verdict(), "the one after it")
    page.settle()
    page.page.goto(page.page.url.partition("#")[0] + "&darkMode")
    page.page.get_by_test_id("verdict").wait_for(timeout=60_000)
    page.wait(lambda: not page.is_blank(), "a dark picture")
    page.settle()
    page.tab("Inspect")
    page.key("n")
    page.wait(lambda: page.say("match") != "", "a match")
    tour.picture("dark")


def command(page: "ViewerPage", words: str) -> None:
    """Run a command from the palette."""
    page.page.keyboard.press("Control+k")
    page.page.wait_for_timeout(500)
    page.page.keyboard.type(words, delay=40)
    page.page.wait_for_timeout(500)
    page.page.keyboard.press("Enter")
    page.page.wait_for_timeout(500)


def legend_ends(legend: str) -> tuple[float, float]:
    """Read the values at the ends of the colour bar."""
    low, _, high = re.findall(NUMBER, legend.partition("]")[2])[:3]
    return float(low), float(high)


def legend_bar(page: "ViewerPage") -> NDArray[np.int_]:
    """Take the colours of the bar as the page shows them, from the low end to the high one."""
    png = page.page.get_by_test_id("legend").locator("img").screenshot()
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    return pixels[len(pixels) // 2, 2:-2]


def read_at(tour: Tour, place: tuple[float, float]) -> tuple[NDArray[np.int_], str] | None:
    """Take the colour of a place and then read its values; None where no surface is."""
    page = tour.page
    page.key("u")
    page.wait(lambda: page.say("reading") == "", "an empty reading")
    page.settle()
    x, y = (int(value) for value in place)
    png = page.page.screenshot(clip={"x": x, "y": y, "width": 1, "height": 1})
    color = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)[0, 0]
    page.shift_click(x + 0.5, y + 0.5)
    missed = page.page.get_by_text("There is no surface")
    page.wait(lambda: page.say("reading") != "" or missed.count() > 0, "values")
    words = page.say("reading")
    if not words:
        return None
    for name in ("x, y", "elevation", "slope", "aspect"):
        assert name in words
    return color, words
