"""The panels in a real browser: they keep still, they fit, and a dataset opens on a closure."""

import re
from dataclasses import replace
from typing import Any

import pytest

from app.viewer.features.pairs.best_pair import BestPairNote
from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SIZE = (1280, 900)

# Looks at every frame where the rows are, and keeps the longest way that a row has moved.
WATCH = """
() => {
  const kinds = 'label[for], button, [role=tab], [role=slider], [data-testid]';
  const rows = () => {
    const places = {}, times = {};
    for (const node of document.querySelectorAll(kinds)) {
      const box = node.getBoundingClientRect();
      if (!node.closest('[data-dock-group]') || !box.height) continue;
      const slides = node.getAttribute('role') === 'slider';  // sideways, as it is dragged
      const name = slides ? 'slider' : node.dataset.testid || node.textContent;
      times[name] = (times[name] || 0) + 1;
      places[`${name} ${times[name]}`] = [slides ? 0 : box.x, box.y];
    }
    return places;
  };
  const first = rows();
  window.calm = {moved: 0, who: '', rows: Object.keys(first).length, on: true};
  const look = () => {
    for (const [name, place] of Object.entries(rows())) {
      const before = first[name];
      const way = before ? Math.hypot(place[0] - before[0], place[1] - before[1]) : 0;
      if (way > window.calm.moved) Object.assign(window.calm, {moved: way, who: name});
    }
    if (window.calm.on) requestAnimationFrame(look);
  };
  look();
}
"""
FITS = """
() => {
  const shown = kind => [...document.querySelectorAll(kind)].filter(
    node => node.closest('[data-dock-group]') && node.getBoundingClientRect().height);
  const buttons = shown('button').filter(node => node.textContent.trim());
  const tabs = shown('[role=tab]');
  return {
    low: buttons.filter(node => node.getBoundingClientRect().height < 31.9).map(
      node => node.textContent),
    rowsOfTabs: new Set(tabs.map(node => node.getBoundingClientRect().y)).size,
    cutTabs: tabs.filter(node =>
      [node, ...node.querySelectorAll('*')].some(part => part.scrollWidth > part.clientWidth + 1)
        || node.getBoundingClientRect().right
          > node.closest('[data-dock-group]').getBoundingClientRect().right).map(
      node => node.textContent),
    sideways: [...document.querySelectorAll('[data-dock-group] *')].filter(
      node => /auto|scroll/.test(getComputedStyle(node).overflowX)
        && node.scrollWidth > node.clientWidth + 1).map(node => node.className),
    card: (() => {
      const table = document.querySelector('[data-testid=verdict]').parentElement;
      return [table.scrollWidth - table.clientWidth, table.scrollHeight - table.clientHeight];
    })(),
  };
}
"""


def test_no_row_moves_while_a_slider_is_dragged(page: Any) -> None:
    page.resize(960, SIZE[1])  # no wider: every frame is drawn in software
    page.rest()
    for name in ("Length-scale", "Variance mask", "Minimum score"):  # a fit, a mask, a verdict
        page.page.evaluate(WATCH)
        page.drag(name, 60, steps=4, pause_ms=60)
        page.drag(name, -40, steps=3, pause_ms=60)
        page.page.evaluate("document.activeElement && document.activeElement.blur()")
        page.wait(lambda: "Up to date" in page.status(), "an up-to-date picture")
        calm: Any = page.page.evaluate("window.calm.on = false, window.calm")
        assert calm["rows"] > 25
        assert calm["moved"] < 0.5, (name, calm)


def test_what_is_drawn_fits_and_can_be_read(page: Any) -> None:
    page.resize(*SIZE)
    page.press("Explore")
    page.press("Tune")  # a panel that comes back is as wide as before
    page.tab("All pairs")
    page.tab("View")
    for dark in (False, True):
        scheme = "dark" if dark else "light"
        page.page.evaluate("scheme => gpgradTheme.choose(scheme)", scheme)
        page.page.locator(f"html[data-mantine-color-scheme={scheme}]").wait_for()
        page.rest()
        drawn: Any = page.page.evaluate(FITS)
        assert drawn["low"] == []
        assert drawn["rowsOfTabs"] == 1
        assert drawn["cutTabs"] == []
        assert drawn["sideways"] == []
        assert max(drawn["card"]) <= 0, drawn["card"]
    page.thumb("Noise").hover()
    tip = page.page.locator(".mantine-Tooltip-tooltip")
    tip.wait_for()
    page.rest()
    label = page.thumb("Noise").bounding_box()
    box = tip.bounding_box()
    assert box["x"] + box["width"] <= label["x"] - 60  # beside the panel


def test_it_switches_to_a_closure_says_so_and_leads_back(browser: Any) -> None:
    from tests.browser.chromium import ViewerPage  # noqa: PLC0415

    dataset = replace(
        load_dataset(demo_path()), preferred={"query": "004", "database": "000"}, name="demo <b>"
    )
    viewer = Viewer(dataset, QUICK, port=0, store=Store())
    try:
        page = ViewerPage(browser, viewer.url, pixel_ratio=0.5)
        note = page.page.get_by_test_id("best-pair")
        note.get_by_text("Switched to").wait_for()
        headline = page.page.get_by_test_id("verdict")
        headline.get_by_text("Loop closure", exact=True).wait_for()
        state = viewer.sessions[0].state
        title = f"{state.query_id} → {state.database_id} · demo <b> · gpgrad"
        page.wait(lambda: page.page.title() == title, "its title")
        note.get_by_role("button", name="Back to 004 → 000").click()
        page.wait(lambda: page.page.title().startswith("004 → 000"), "the way back")
        note.wait_for(state="detached")
        refused = re.compile("^(No loop closure|Undecided)$")  # by how much ground they share
        headline.get_by_text(refused).wait_for()
        heard: list[object] = []
        session = viewer.sessions[0]
        for name in ("touched", "last"):
            session.desk.bridge.hear(name, lambda _, data: heard.append(data))
        BestPairNote(session.desk.host).say("Looking …", watch=41)
        note.wait_for()
        page.page.mouse.move(640, 300)
        page.page.mouse.wheel(0, 60)
        page.wait(lambda: bool(heard), "that the page is touched")
        page.page.mouse.wheel(0, 60)
        page.page.evaluate("gpgrad.say('last')")
        page.wait(lambda: heard[-1] == {}, "what is said after it")
        assert heard == [{"number": 41}, {}]
        late = browser.new_page()
        late.goto(viewer.url)
        late.wait_for_function("document.title.startsWith('004 → 000')")
        late.close()
        page.close()
    finally:
        viewer.close()
