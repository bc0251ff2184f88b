"""The strip over the canvas that names the pair: by keys and by mouse."""

from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def test_the_pair_is_chosen_by_keys_alone(page: Any) -> None:
    keys = page.page.keyboard
    listed = page.page.get_by_test_id("pair-list")
    camera = page.viewer.sessions[0].desk
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


def test_a_list_that_comes_late_keeps_what_the_arrows_point_at(page: Any) -> None:
    page.page.locator("button[data-role=database]").click()
    page.wait(lambda: page.page.get_by_role("option").count() == 10, "all of them")
    page.page.evaluate(
        """() => {
          const choices = gpgrad.acts.choices;
          gpgrad.acts.choices = data => {
            gpgrad.acts.choices = choices;
            window.late = () => choices(data);
          };
        }"""
    )
    page.page.keyboard.type("00")
    page.page.keyboard.press("ArrowDown")
    page.page.wait_for_function("window.late !== undefined")
    page.page.evaluate("window.late()")
    page.page.keyboard.press("ArrowDown")
    page.page.keyboard.press("Enter")
    page.wait(lambda: page.pair() == ("007", "003"), "two below 001")


def test_arrows_come_with_the_mouse_or_the_focus(page: Any) -> None:
    query = page.page.locator("button[data-role=query]")
    page.page.mouse.move(480, 400)
    page.wait(lambda: page.opacities() == {"0"}, "a strip at rest")
    query.hover()
    page.wait(lambda: page.opacities() == {"1"}, "arrows under the mouse")
    page.page.mouse.move(480, 400)
    page.wait(lambda: page.opacities() == {"0"}, "a strip at rest again")
    query.focus()
    page.wait(lambda: page.opacities() == {"1"}, "arrows where the keys go")
