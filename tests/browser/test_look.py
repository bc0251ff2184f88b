"""What a stranger sees from the first paint on: the theme, and nothing of viser's own."""

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
WATCH = """
const seen = window.seen = {grounds: new Set(), words: new Set(), names: new Set(), handles: 0};
const VISER = /Connect(ed|ing)|Inactive|Save Canvas|Dev Settings|Software WebGL|diagnostics/g;
const look = () => {
    requestAnimationFrame(look);
    if (!document.body) return;
    seen.grounds.add(getComputedStyle(document.body).backgroundColor);
    for (const [word] of document.body.innerText.matchAll(VISER)) seen.words.add(word);
    const opening = document.querySelector('#gpgrad-opening b');
    if (opening?.checkVisibility()) seen.names.add(opening.textContent);
    const handles = '[data-dock-griphandle], [data-dock-region-handle], .tabler-icon-adjustments';
    for (const handle of document.querySelectorAll(handles))
        seen.handles += handle.checkVisibility({visibilityProperty: true});
};
requestAnimationFrame(look);
"""
WIDTHS = """() => ['left', 'right'].map(side => Math.round(
    document.querySelector(`[data-dock-region=${side}]`).getBoundingClientRect().width))"""
FOOTS = """() => [...document.querySelectorAll('[data-dock-leaf]')].map(
    leaf => Math.round(leaf.getBoundingClientRect().bottom))"""


def test_nothing_of_viser_and_nothing_white_is_ever_seen(open_viewer: Callable[..., Any]) -> None:
    page = open_viewer(size=(1440, 900), script=WATCH)
    seen = page.page.evaluate(
        "() => ({...seen, grounds: [...seen.grounds], words: [...seen.words], "
        "names: [...seen.names]})"
    )
    assert seen == {"grounds": ["rgb(12, 15, 19)"], "words": [], "names": ["demo"], "handles": 0}
    # A panel is as wide in each mode, so that the picture does not move, and hugs its content.
    widths = []
    for mode in ("Explore", "Demo", "Tune"):
        page.press(mode)
        page.rest()
        widths.append(page.page.evaluate(WIDTHS))
        assert max(page.page.evaluate(FOOTS)) < 892, mode
    assert len({tuple(pair) for pair in widths}) == 1, widths
    # A window that was as narrow as a phone has its panels as before.
    page.resize(390, 844)
    page.wait(lambda: page.page.locator("[data-dock-region=right]").count() == 0, "a phone's page")
    page.resize(1440, 900)
    page.wait(lambda: page.page.evaluate(WIDTHS) == widths[0], "panels as wide as before")
    # In a low window the map keeps its room beside the matrix.
    page.press("Explore")
    page.key("Shift+P")
    page.page.get_by_test_id("matrix-board").wait_for()
    page.resize(960, 490)
    canvas = page.page.get_by_test_id("over-canvas")
    page.wait(lambda: canvas.bounding_box()["width"] == 300, "room for the map")
    page.key("Shift+P")
    page.resize(1440, 900)
    page.press("Tune")
    # The notice of a page without a graphics card is one line, which stays away.
    notice = page.page.get_by_test_id("no-graphics-card")
    notice.get_by_role("button").evaluate("button => button.click()")
    page.open()
    assert notice.count() == 0


def test_the_theme_is_chosen_and_remembered(page: Any) -> None:
    scheme = "document.documentElement.dataset.mantineColorScheme"
    page.resize(1280, 900)
    page.page.emulate_media(color_scheme="light")
    for theme, shown in (("Light", "light"), ("System", "light"), ("Dark", "dark")):
        page.page.get_by_role("button", name="Theme").click()
        page.page.get_by_role("menuitemradio", name=theme).click()
        assert page.page.evaluate(scheme) == shown
        assert page.page.evaluate("localStorage['gpgrad-theme']") == theme.lower()
        assert page.page.get_by_role("menu").count() == 0
    assert "dark" not in page.page.evaluate("location.href")
