"""How much stands on the first screen of each mode: controls at rest, scroll bars, cut labels."""

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.browser.chromium import ViewerPage

pytestmark = [pytest.mark.browser, pytest.mark.slow]
Open = Callable[..., "ViewerPage"]
MOST = 15
AT_REST = """() => {
    // Tabs and the three modes are places to go. The number box of a slider is a part of it.
    const all = 'button, input:not([type=hidden]), textarea, [role=slider], [role=button], ' +
        '[data-step]';
    const seen = [...document.querySelectorAll(all)].filter(node => {
        const {width, height, left, right} = node.getBoundingClientRect();
        return node.checkVisibility({opacityProperty: true, visibilityProperty: true}) &&
            width > 1 && height > 1 && right > 0 && left < innerWidth;
    });
    const name = node => node.innerText || node.getAttribute('aria-label') ||
        node.labels?.[0]?.innerText || node.tagName;
    return seen.map(name).filter(
        text => !text.endsWith(', typed') && !['Explore', 'Tune', 'Demo'].includes(text));
}"""
SCROLLS = """() => [...document.querySelectorAll('*')].filter(node =>
    /auto|scroll/.test(getComputedStyle(node).overflowY) && node.clientHeight > 40 &&
    node.scrollHeight > node.clientHeight + 1).map(node => node.innerText.slice(0, 60))"""
CUT = """() => [...document.querySelectorAll('label, button, [role=tab], [data-testid=card]')]
    .filter(node => node.checkVisibility() && node.clientWidth > 0 &&
        (node.scrollWidth > node.clientWidth + 1 || node.scrollHeight > node.clientHeight + 2) &&
        getComputedStyle(node).display !== 'inline').map(node => node.innerText)"""
SIZES = """() => {
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), sizes = {};
    while (texts.nextNode()) {
        const node = texts.currentNode.parentElement, text = texts.currentNode.data.trim();
        const {width, height} = node.getBoundingClientRect();
        if (!text || width < 1 || height < 1 || /STYLE|SCRIPT/.test(node.tagName) ||
            !node.checkVisibility({opacityProperty: true, visibilityProperty: true})) continue;
        const size = getComputedStyle(node).fontSize;
        if (size !== '0px') (sizes[size] ??= []).push(text.slice(0, 30));
    }
    return sizes;
}"""
MOST_SIZES = 4
SLIDERS = """() => [...document.querySelectorAll('[role=slider]')].filter(
    thumb => thumb.checkVisibility({opacityProperty: true})).map(thumb => {
        const {top, width, height} = thumb.getBoundingClientRect();
        const root = thumb.closest('.mantine-Slider-root');
        const typed = root.nextElementSibling.querySelector('input:not([type=hidden])');
        const end = thumb.parentElement.getBoundingClientRect().right;
        return {top, width, height, end, box: typed.getBoundingClientRect().left,
            cut: typed.scrollWidth > typed.clientWidth};
    })"""


def test_each_mode_is_quiet_at_rest(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    for mode in ("Tune", "Explore", "Demo", "pair"):  # the last in Demo, which showed the map
        page.press(mode)
        page.page.mouse.move(720, 450)
        page.page.wait_for_timeout(1500)
        controls = page.page.evaluate(AT_REST)
        assert len(controls) > 5
        assert len(controls) <= MOST, f"{mode}: {len(controls)} controls: {controls}"
        assert page.page.evaluate(SCROLLS) == [], mode
        assert page.page.evaluate(CUT) == [], mode
        sizes = page.page.evaluate(SIZES)
        assert len(sizes) > 1
        assert len(sizes) <= MOST_SIZES, f"{mode}: {sizes}"


def test_a_phone_has_room_for_fingers(open_viewer: Open) -> None:
    page = open_viewer()
    page.page.set_viewport_size({"width": 390, "height": 844})
    page.page.reload()
    page.page.get_by_test_id("verdict").wait_for()
    page.page.wait_for_timeout(2000)
    page.dismiss_notice()
    sliders = page.page.evaluate(SLIDERS)
    assert len(sliders) > 4
    for one, next_one in itertools.pairwise(sliders):
        assert next_one["top"] - one["top"] >= 32  # of which 24 are the thumb
    for slider in sliders:
        assert min(slider["width"], slider["height"]) >= 24
        assert slider["end"] + 12 <= slider["box"]  # where it stands at its end
        assert not slider["cut"]
    page.page.get_by_role("button", name="Expand panel View").click()
    tab = page.page.get_by_role("tab", name="View")
    page.wait(lambda: (at := tab.bounding_box()) is not None and at["y"] < 600, "tabs in view")
    page.press("Explore")
    time = page.page.get_by_test_id("time")
    time.wait_for()
    box = time.bounding_box()
    assert box is not None
    assert box["height"] >= 24
    assert box["width"] >= 100
    rail = page.page.get_by_test_id("mode").bounding_box()
    assert rail is not None
    assert (rail["x"], rail["width"]) == (0, 390)


def test_a_phone_on_its_side_leaves_half_of_itself_to_the_picture(open_viewer: Open) -> None:
    page = open_viewer(size=(844, 390))
    canvas = page.page.get_by_test_id("over-canvas")

    def width() -> float:
        box = canvas.bounding_box()
        assert box is not None
        return box["width"]

    page.wait(lambda: width() > 844 / 2, "the left panel to be put away")
    tab = page.page.get_by_text("All pairs", exact=True)
    tab.click()
    page.wait(lambda: width() < 844 / 2, "the panel")
    page.page.wait_for_timeout(1000)
    assert width() < 844 / 2  # whoever wanted it keeps it
    assert page.errors == []


def test_a_drawer_is_as_it_was_left(open_viewer: Open) -> None:
    page = open_viewer()
    title = page.page.get_by_text("Figures", exact=True)
    figures = page.page.get_by_test_id("score")
    assert not figures.is_visible()
    title.click()
    figures.wait_for(state="visible")
    page.page.reload()
    figures.wait_for(state="visible", timeout=60_000)
    title.click()
    figures.wait_for(state="hidden")
    page.page.reload()
    page.page.get_by_test_id("verdict").wait_for()
    page.page.wait_for_timeout(2000)
    assert not figures.is_visible()


def test_a_drawer_within_one_that_was_folded_is_whole(open_viewer: Open) -> None:
    page = open_viewer()
    sweep = page.page.get_by_role("button", name="Sweep", exact=True)
    outer, inner = (page.page.get_by_text(name, exact=True) for name in ("More", "Sensitivity"))
    outer.click()
    inner.click()
    sweep.click(trial=True)
    outer.click()
    page.page.reload()
    page.page.get_by_test_id("verdict").wait_for()
    page.page.wait_for_timeout(2000)
    page.dismiss_notice()
    outer.click()
    sweep.click(trial=True)


def test_escape_folds_the_drawers(open_viewer: Open) -> None:
    page = open_viewer()
    title = page.page.get_by_text("Figures", exact=True)
    figures = page.page.get_by_test_id("score")
    title.click()
    figures.wait_for(state="visible")
    page.key("Escape")
    figures.wait_for(state="hidden")


def test_the_verdict_is_told_once(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    caption = page.page.get_by_test_id("caption")
    headline = page.page.get_by_test_id("verdict")
    page.wait(lambda: not caption.is_visible(), "one verdict")
    assert headline.is_visible()
    page.key("f")  # the card is put away
    headline.wait_for(state="hidden")
    page.wait(lambda: "score" in caption.inner_text(), "the verdict over the picture")


def test_the_pair_is_told_once(open_viewer: Open) -> None:
    page = open_viewer(size=(1440, 900))
    caption, strip = page.page.get_by_test_id("caption"), page.page.get_by_test_id("pair-strip")
    page.wait(strip.is_visible, "the strip")
    assert not caption.is_visible()
    rails = page.page.locator("[data-dock-group]").all_inner_texts()
    assert not any(name in rail for name in page.pair() for rail in rails)
    page.key("f")  # the panels are put away, and the strip with them
    strip.wait_for(state="hidden")
    page.wait(lambda: "Query 007 → database 001" in page.say("caption"), "the pair in words")
    page.key("Escape")
    strip.wait_for()


def test_dark_follows_the_system_until_a_person_chooses(open_viewer: Open) -> None:
    page = open_viewer()

    def is_dark() -> bool:
        scheme = "document.documentElement.dataset.mantineColorScheme"
        return page.page.evaluate(scheme) == "dark"

    assert not is_dark()
    page.page.emulate_media(color_scheme="dark")
    page.wait(is_dark, "a dark page")
    page.tick("Dark")
    page.wait(lambda: not is_dark(), "a light page")
    page.page.emulate_media(color_scheme="light")
    page.page.emulate_media(color_scheme="dark")
    page.page.wait_for_timeout(1500)
    assert not is_dark()
