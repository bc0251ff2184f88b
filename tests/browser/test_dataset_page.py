"""The page of a dataset, opened from disk without any network, and used with the mouse."""

import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gpgrad_core.detection import detect_loop_closures
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.records.closures import report_closures
from gpgrad_core.pages import subject_of, write_page
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK
from tests.support.waiting import PATIENCE

pytestmark = [pytest.mark.browser, pytest.mark.slow]

COLOURED = """canvas => {
    const {data} = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let drawn = 0;
    for (let k = 3; k < data.length; k += 4) drawn += data[k] > 0;
    return drawn;
}"""
"""How many pixels of a canvas are drawn."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dataset, memo = load_dataset(demo_path()), Memo()
    found = detect_loop_closures(dataset, QUICK, memo=memo)
    path = tmp_path_factory.mktemp("page") / "page.html"
    params = found.params or QUICK
    report = report_closures(dataset, found, params)
    write_page(path, subject_of(dataset, report, params, commands=["gpgrad detect demo"]), memo)
    return path


def click(page: Any, canvas: str, across: float, down: float) -> None:
    """Click a place of a canvas, by its shares of the width and the height."""
    box = page.locator(canvas).bounding_box()
    position = {"x": across * box["width"], "y": down * box["height"]}
    page.locator(canvas).click(position=position)


def wait_until(page: Any, condition: str) -> None:
    """Wait until a condition holds in the page, which lets no text be made a script."""
    end = time.monotonic() + PATIENCE
    while not page.evaluate(condition):
        assert time.monotonic() < end, f"waited {PATIENCE} s for {condition}"
        page.wait_for_timeout(100)


@pytest.fixture
def open_page(browser: Any, written: Path) -> Iterator[Callable[..., Any]]:
    """Open the page in a window without a network; there must be no error and no request."""
    contexts: list[Any] = []
    errors: list[str] = []
    asked: list[str] = []

    def start(width: int = 1400, height: int = 1000, **options: Any) -> Any:
        context = browser.new_context(
            viewport={"width": width, "height": height}, offline=True, **options
        )
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1000 * PATIENCE)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(written.as_uri())
        page.wait_for_selector("body[data-ready]")
        return page

    yield start
    for context in contexts:
        context.close()
    assert not errors
    assert asked == [written.as_uri()] * len(contexts)


def test_every_control_of_the_page(open_page: Callable[..., Any]) -> None:
    page = open_page()
    rows = page.locator("#list tbody tr")

    until = partial(wait_until, page)

    # It opens with the best pair, in three dimensions, and all that was accepted.
    until("document.getElementById('pair').dataset.faces > 1000")
    until("document.getElementById('pair').dataset.keypoints > 6")
    accepted = rows.count()
    assert accepted > 5
    assert f"{accepted} loop closures" in page.locator("#threshold-count").inner_text()
    until(f"document.getElementById('map').dataset.closures == {accepted}")
    full = page.locator("#curve-legend").inner_text()

    # One threshold for the list, the map, the curve and the histogram.
    click(page, "#histogram", 0.96, 0.5)  # the highest scores are at its right end
    until("document.getElementById('threshold').value > 900")
    until(f"document.querySelectorAll('#list tbody tr').length < {accepted}")
    fewer = rows.count()
    until(f"document.getElementById('map').dataset.closures == {fewer}")
    assert page.locator("#curve-legend").inner_text() != full
    page.locator("#threshold").fill("1000")
    until("document.querySelectorAll('#list tbody tr').length === 0")
    assert "No pair" in page.locator("#list-more").inner_text()
    page.locator("#threshold-reset").click()
    until(f"document.querySelectorAll('#list tbody tr').length === {accepted}")
    click(page, "#curve", 0.15, 0.1)  # few pairs, and all of them right
    until(f"document.querySelectorAll('#list tbody tr').length < {accepted}")
    page.locator("#threshold-reset").click()

    # A pair by the list, by key and by mouse, and by the matrix.
    shown = page.locator("#pair")
    rows.nth(2).click()
    third = [rows.nth(2).locator("td").nth(k).inner_text() for k in (0, 1)]
    until(f"document.getElementById('pair').dataset.pair === '{third[0]} {third[1]}'")
    rows.nth(1).focus()
    page.keyboard.press("Enter")
    until(f"document.getElementById('pair').dataset.pair !== '{third[0]} {third[1]}'")
    before = shown.get_attribute("data-pair")
    for across in (0.85, 0.75, 0.65):  # submaps of the far end beside those of the first
        click(page, "#matrix", across, 0.85)
    until(f"document.getElementById('pair').dataset.pair !== '{before}'")
    rows.nth(0).click()

    # The pair in three dimensions.
    until("document.getElementById('pair').dataset.keypoints > 6")
    faces = int(shown.get_attribute("data-faces"))
    page.locator("#show-query").uncheck()
    until(f"document.getElementById('pair').dataset.faces < {faces}")
    page.locator("#show-query").check()
    page.locator("#show-lines").uncheck()
    until("document.getElementById('pair').dataset.keypoints === '0'")
    page.locator("#show-lines").check()
    page.locator("#lift").fill("0")
    until("document.getElementById('lift-value').textContent.includes('as found')")
    turn, far = shown.get_attribute("data-turn"), shown.get_attribute("data-far")
    shown.scroll_into_view_if_needed()
    box = shown.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 100, y + 20, steps=4)
    page.mouse.up()
    until(f"document.getElementById('pair').dataset.turn !== '{turn}'")
    page.mouse.wheel(0, 300)
    until(f"document.getElementById('pair').dataset.far !== '{far}'")

    # The map before and after, and along the time line.
    whole = page.locator("#map").evaluate(COLOURED)
    page.locator("#before").click()
    until("document.getElementById('map').dataset.shift === '0'")
    until("document.getElementById('before').getAttribute('aria-pressed') === 'true'")
    page.locator("#after").click()
    until("document.getElementById('map').dataset.shift === '1'")
    page.locator("#time").fill("2")
    until(f"document.getElementById('map').dataset.closures < {accepted}")
    assert page.locator("#time-value").inner_text() == "2 of 10 submaps"
    assert page.locator("#map").evaluate(COLOURED) < 0.8 * whole
    page.locator("#play").click()
    until("document.getElementById('time-value').textContent === '10 of 10 submaps'")
    until("document.getElementById('play').textContent === 'Play'")
    click(page, "#time-line", 0.02, 0.5)
    until("document.getElementById('time-value').textContent === '1 of 10 submaps'")

    # What reproduces it.
    assert page.locator("pre").inner_text() == "gpgrad detect demo"
    page.locator("summary").click()
    assert page.get_by_text("map.length_scale").is_visible()


def test_it_is_readable_on_a_phone_and_in_the_dark(open_page: Callable[..., Any]) -> None:
    page = open_page(390, 844, color_scheme="dark", has_touch=True, is_mobile=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    ground, text = page.evaluate(
        "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]"
        ".map(colour => colour.match(/[0-9]+/g).slice(0, 3).map(Number))"
    )
    assert max(ground) < 60
    assert min(text) > 180
    page.locator("#list tbody tr").nth(3).tap()
    wait_until(
        page,
        "(box => box.top < innerHeight / 2 && box.bottom > 100)"
        "(document.getElementById('pair').getBoundingClientRect())",
    )  # what was chosen is brought into sight
