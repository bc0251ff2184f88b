"""How much stands on the first screen of each mode: controls at rest, scroll bars, cut labels."""

from collections.abc import Callable
from typing import Any

import pytest

pytestmark = [pytest.mark.browser, pytest.mark.slow]
MOST = 15
AT_REST = """() => {
    // Tabs, heads of folders and the three modes are places to go. The number box of a slider is
    // a part of it. A note that goes away with its x is there once.
    const all = 'button, input:not([type=hidden]), textarea, [role=slider], [role=button], ' +
        '[data-step]';
    const seen = [...document.querySelectorAll(all)].filter(node => {
        const {width, height, left, right} = node.getBoundingClientRect();
        return node.checkVisibility({opacityProperty: true, visibilityProperty: true}) &&
            !node.matches('[role=button][aria-expanded]') &&
            !node.closest('[data-testid=no-graphics-card]') &&
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
SIZE = (1440, 900)


def test_each_mode_is_quiet_at_rest(open_viewer: Callable[..., Any]) -> None:
    page = open_viewer()  # of its own: what others did could be undone, by one button more
    page.resize(*SIZE)
    for mode in ("Tune", "Explore", "Demo", "pair"):  # the last in Demo, which showed the map
        page.press(mode)
        page.page.mouse.move(720, 450)
        assert page.viewer.wait_idle(120.0)
        page.rest()
        controls = page.page.evaluate(AT_REST)
        assert len(controls) > 5
        assert len(controls) <= MOST, f"{mode}: {len(controls)} controls: {controls}"
        assert page.page.evaluate(SCROLLS) == [], mode
        assert page.page.evaluate(CUT) == [], mode
        sizes = page.page.evaluate(SIZES)
        assert len(sizes) > 1
        assert len(sizes) <= MOST_SIZES, f"{mode}: {sizes}"


def test_drawers_are_as_they_were_left_and_escape_folds_them(page: Any) -> None:
    inside = page.page.get_by_role("button", name="Download parameters", exact=True)
    outer, inner, title = (
        page.page.get_by_text(name, exact=True) for name in ("More", "Save as preset", "Figures")
    )
    figures = page.page.get_by_test_id("figures")
    assert not figures.is_visible()
    outer.click()
    inner.click()
    inside.click(trial=True)
    outer.click()  # folded, with one in it that is open
    title.click()
    figures.wait_for(state="visible")
    page.open()
    figures.wait_for(state="visible")
    assert not inside.is_visible()
    outer.click()
    inside.click(trial=True)
    page.key("Escape")
    figures.wait_for(state="hidden")
    inside.wait_for(state="hidden")


def test_verdict_and_pair_are_told_once(page: Any) -> None:
    page.resize(*SIZE)
    caption, strip, headline = (
        page.page.get_by_test_id(name) for name in ("caption", "pair-strip", "verdict")
    )
    strip.wait_for()
    caption.wait_for(state="hidden")
    assert headline.is_visible()
    rails = page.page.locator("[data-dock-group]").all_inner_texts()
    assert not any(name in rail for name in page.pair() for rail in rails)
    page.key("f")  # the panels are put away, and the card and the strip with them
    strip.wait_for(state="hidden")
    headline.wait_for(state="hidden")
    page.wait(lambda: "score" in page.say("caption"), "the verdict over the picture")
    page.wait(lambda: "Query 007 → database 001" in page.say("caption"), "the pair in words")
    page.key("Escape")
    strip.wait_for()


def test_the_verdict_stays_in_sight_while_the_panel_scrolls(page: Any) -> None:
    page.resize(1024, 600)
    page.page.get_by_text("More", exact=True).click()
    headline, evidence = (page.page.get_by_test_id(name) for name in ("verdict", "evidence"))
    before = headline.bounding_box()["y"]
    page.page.get_by_role("button", name="Reset parameters").hover()
    page.page.mouse.wheel(0, 900)
    page.wait(lambda: evidence.bounding_box()["y"] < 0, "the evidence to scroll away")
    assert 0 < headline.bounding_box()["y"] <= before
    ground = headline.locator("..").bounding_box()
    assert ground["height"] < 600 / 3
    page.page.mouse.wheel(0, -2000)
    page.key("Escape")
