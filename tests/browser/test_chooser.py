"""The strip over the canvas that names the pair: by keys, by mouse and with a finger."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = [pytest.mark.browser, pytest.mark.slow]
Open = Callable[..., "ViewerPage"]


def test_the_pair_is_chosen_by_keys_alone(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    keys = page.page.keyboard
    listed = page.page.get_by_test_id("pair-list")
    camera = page.viewer.sessions[0].desk  # type: ignore[attr-defined]
    query = page.page.locator("button[data-role=query]")
    assert page.pair() == ("007", "001")
    query.focus()
    keys.press("ArrowRight")
    page.wait(lambda: page.pair() == ("008", "001"), "the next query")
    keys.press("ArrowLeft")
    page.wait(lambda: page.pair() == ("007", "001"), "the query before")
    (client,) = camera.host.get_clients().values()
    assert not camera.canvases.is_by_hand(client)  # the arrows did not fly the camera
    keys.press("Enter")
    listed.wait_for()
    page.page.get_by_role("option", name="007").wait_for()
    keys.press("Escape")
    listed.wait_for(state="hidden")
    assert query.evaluate("node => node === document.activeElement")
    keys.press("Tab")  # to the button that swaps
    keys.press("Tab")
    keys.press("Enter")
    listed.wait_for()
    page.page.keyboard.type("00", delay=80)
    page.wait(lambda: page.page.get_by_role("option").count() == 10, "all of them")
    keys.press("ArrowDown")
    keys.press("ArrowDown")  # from the one that is chosen on
    keys.press("Enter")
    page.wait(lambda: page.pair() == ("007", "003"), "another database")
    page.page.get_by_role("button", name="Swap query and database").click()
    page.wait(lambda: page.pair() == ("003", "007"), "the two swapped")
    page.wait(lambda: page.page.title().startswith("003 → 007"), "the title")
    page.key("j")  # as before
    page.wait(lambda: page.pair() == ("004", "007"), "the next query, by its key")


def test_a_list_that_comes_late_keeps_what_the_arrows_point_at(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    page.page.locator("button[data-role=database]").click()
    page.wait(lambda: page.page.get_by_role("option").count() == 10, "all of them")
    page.page.evaluate(
        """() => {
          const choices = gpgrad.acts.choices;
          gpgrad.acts.choices = data => { window.late = () => choices(data); };
        }"""
    )
    page.page.keyboard.type("00")
    page.page.keyboard.press("ArrowDown")
    page.page.wait_for_function("window.late !== undefined")
    page.page.evaluate("window.late()")
    page.page.keyboard.press("ArrowDown")
    page.page.keyboard.press("Enter")
    page.wait(lambda: page.pair() == ("007", "003"), "two below 001")


def opacities(page: "ViewerPage") -> set[str]:
    """Give how solid the arrows of the strip are."""
    script = "all => all.map(arrow => getComputedStyle(arrow).opacity)"
    return set(page.page.locator("[data-step]").evaluate_all(script))


def test_arrows_come_with_the_mouse_or_the_focus(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    query = page.page.locator("button[data-role=query]")
    page.page.mouse.move(720, 450)
    page.wait(lambda: opacities(page) == {"0"}, "a strip at rest")
    query.hover()
    page.wait(lambda: opacities(page) == {"1"}, "arrows under the mouse")
    page.page.mouse.move(720, 450)
    page.wait(lambda: opacities(page) == {"0"}, "a strip at rest again")
    query.focus()
    page.wait(lambda: opacities(page) == {"1"}, "arrows where the keys go")


def test_it_fits_a_phone_and_a_finger(open_viewer: Open) -> None:
    page = open_viewer()
    page.page.mouse.move(480, 400)
    page.page.set_viewport_size({"width": 390, "height": 844})
    strip = page.page.get_by_test_id("pair-strip")
    page.wait(
        lambda: (box := strip.bounding_box()) is not None and box["x"] + box["width"] <= 390,
        "a strip that fits",
    )
    page.wait(lambda: opacities(page) == {"1"}, "arrows, though no mouse is near")
    for part in strip.locator("button, [data-step]").all():
        box = part.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 24
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
    strip.locator("[data-step='next database']").click()
    page.wait(lambda: page.pair() == ("007", "002"), "the next database")
    page.choose_submap("query", "005")
    page.wait(lambda: page.pair() == ("005", "002"), "the query of the list")
    before = page.viewer.sessions[0].state  # type: ignore[attr-defined]
    strip.locator("button[data-role=query]").click()
    page.page.get_by_role("combobox", name="Choose the query").fill("nowhere")
    page.wait(lambda: "No submap" in page.say("pair-more"), "that there is none")
    page.page.mouse.click(20, 200)  # beside it
    page.page.get_by_test_id("pair-list").wait_for(state="hidden")
    assert page.viewer.sessions[0].state is before  # type: ignore[attr-defined]
