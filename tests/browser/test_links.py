"""Addresses as people open them: typed, reloaded, copied, kept, and gone back and forward to."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.viewer.scene.cameras import line_of_sight, place_on_screen, view_of
from app.viewer.server.admission import Admission
from app.viewer.server.host import pages
from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.run.store import Store
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK
from tests.support.waiting import PATIENCE

pytestmark = [pytest.mark.browser, pytest.mark.slow]
SMALL: Any = {"viewport": {"width": 960, "height": 490}, "device_scale_factor": 0.5}
"""What is drawn costs most of the time, and nobody looks."""
ONCE_MORE = """
new MutationObserver(changes => {
  for (const {addedNodes} of changes) for (const node of addedNodes) {
    for (const one of node.querySelectorAll?.('img[onerror*="gpgradLink"]') ?? [])
      for (let k = 0; k < 40; k++) setTimeout(() => one.onerror?.(), 37 * k);
  }
}).observe(document, {childList: true, subtree: true});
"""
"""Runs the script of the address again and again while a page starts, as a slow browser does."""
TOKEN = "a-token-to-share"


def start(token: str | None, port: int = 0) -> Viewer:
    return Viewer(
        load_dataset(demo_path()),
        QUICK,
        port=port,
        source=str(demo_path()),
        store=Store(),
        admission=Admission(token=token),
    )


OPEN, GUARDED = pytest.param(None, id="without a token"), pytest.param(TOKEN, id="with a token")
RARE = pytest.param(TOKEN, id="with a token", marks=pytest.mark.nightly)
guarded = pytest.mark.parametrize("viewer", [GUARDED], indirect=True)
"""Where the token has a part in it."""


@pytest.fixture(params=[OPEN, RARE])
def viewer(request: pytest.FixtureRequest) -> Iterator[Viewer]:
    made = start(request.param)
    yield made
    made.close()


@pytest.fixture
def person(browser: Any) -> Iterator[Any]:
    """A browser with nothing in it yet."""
    context = browser.new_context(**SMALL)
    context.set_default_timeout(1000 * PATIENCE)
    yield context
    context.close()


def is_there(page: Any) -> None:
    """Wait until the viewer is on the page, and the page's address says what is shown."""
    page.get_by_test_id("verdict").wait_for()
    shows(page, "#query=")


def come(person: Any, viewer: Viewer) -> Any:
    """Open a page on the viewer."""
    page = person.new_page()
    page.goto(viewer.link)
    is_there(page)
    return page


def shows(page: Any, part: str) -> None:
    """Wait until the address of a page has a part."""
    page.wait_for_function("part => location.href.includes(part)", arg=part, polling=100)


def address(page: Any) -> str:
    return str(page.evaluate("location.href"))


def lasting_address(page: Any) -> str:
    """Wait until a page's address stays: the camera is in it until the panels have their places."""
    now = address(page)
    for _ in range(30):
        before = now
        page.wait_for_timeout(1000)
        now = address(page)
        if now == before:
            return now
    raise AssertionError(f"the address does not stay: {now}")


def follows(page: Any, viewer: Viewer, link: str) -> None:
    """Wait until a page and its session show what a link asks for."""
    is_there(page)
    for _ in range(300):
        state, text = viewer.sessions[0].state, page.evaluate("window.gpgradLink?.text")
        asked = f"#query={state.query_id}&" in link, "elevation" in link
        if asked == (True, state.options.layer == "elevation") and text == link.partition("#")[2]:
            break
        page.wait_for_timeout(200)
    else:
        raise AssertionError(f"{address(page)} in place of {link}")
    shows(page, "#" + text)


def turn_the_wheel(page: Any) -> None:
    """Move the camera; once more where it was just brought to the next pair."""
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    page.mouse.move(canvas["x"] + canvas["width"] / 2, 300)
    for _ in range(20):
        page.mouse.wheel(0, 300)
        if "camera=" in lasting_address(page):
            return
    raise AssertionError(f"the camera is not in {address(page)}")


def press(page: Any, key: str, part: str) -> str:
    """Press a key that changes what is shown; gives the address that comes of it."""
    page.evaluate("document.activeElement && document.activeElement.blur()")
    page.keyboard.press(key)
    shows(page, part)
    return lasting_address(page)


def test_a_page_is_reloaded_and_outlives_a_wrong_link(person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    link = press(page, "1", "view.layer=elevation")
    assert link.startswith(f"{viewer.link}/#" if "?" not in viewer.link else f"{viewer.link}#")
    page.reload()
    follows(page, viewer, link)
    assert address(page) == link
    page.evaluate("history.replaceState(null, '', '?x=1')")  # as viser's client may at any time
    assert address(page) == link
    page.evaluate("location.hash = 'query=nobody&database=001'")
    page.get_by_text("The link cannot be opened").wait_for()
    follows(page, viewer, link)
    page.evaluate("location.hash = ''")
    follows(page, viewer, link)


def test_a_link_is_opened_by_a_slow_browser(person: Any, viewer: Viewer) -> None:
    page = person.new_page()
    page.add_init_script(ONCE_MORE)
    link = f"{viewer.link}#query=008&database=001&params.map.max_points=3000"
    link += "&params.map.resolution=0.12&camera=0,-38.78,53.15,0,-3.673,-3.041"
    page.goto(link)
    follows(page, viewer, link)


@guarded
def test_a_link_is_opened_in_another_browser(browser: Any, person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    press(page, "j", "query=008")  # the next query
    turn_the_wheel(page)
    copied = page.evaluate("gpgradLink.link()")
    other = browser.new_context(**SMALL)
    try:
        guest = other.new_page()  # while the first is open: it sees the same from there, too
        guest.goto(address(page))
        follows(guest, viewer, copied)
        guest.close()
        link = press(page, "j", "query=009")
        press(page, "j", "query=000")
        page.close()
        page = other.new_page()
        page.goto(link)
        follows(page, viewer, link)
        page.close()
        kept = other.new_page()  # a bookmark, or the link of a report, which holds no token
        assert TOKEN not in copied
        kept.goto(copied)
        follows(kept, viewer, copied)
    finally:
        other.close()


@guarded
def test_a_link_in_a_report_is_clicked(person: Any, viewer: Viewer, tmp_path: Path) -> None:
    """As that of a report, which lies on the disk."""
    page = come(person, viewer)
    link = page.evaluate("gpgradLink.link()")
    report = tmp_path / "report.html"
    report.write_text(f'<a href="{link.replace("&", "&amp;")}">the pair</a>')
    page.goto(report.as_uri())
    page.get_by_text("the pair").click()
    follows(page, viewer, link)


def test_back_and_forward_go_between_links(person: Any, viewer: Viewer) -> None:
    page = person.new_page()
    page.goto("about:blank")
    page.goto(viewer.link)
    is_there(page)
    first = press(page, "j", "query=008")
    other = first.replace("query=008", "query=006")
    other = other.replace("&params", "&view.layer=elevation&params", 1)
    page.goto(other)  # the page stays: only what is after # is another
    follows(page, viewer, other)
    page.evaluate("window.gpgradSame = true")
    # What the server wrote before it heard of the way back comes to a busy page after it.
    late = f"gpgrad.acts.address({{...gpgradLink, text: {json.dumps(other.partition('#')[2])}}})"
    page.evaluate(f"window.addEventListener('popstate', () => {late}, {{once: true}})")
    page.go_back()
    follows(page, viewer, first)
    page.go_forward()
    follows(page, viewer, other)
    assert page.evaluate("window.gpgradSame")
    page.goto("about:blank")
    page.go_back()  # from elsewhere, where the page is made anew
    follows(page, viewer, other)
    page.go_back()
    follows(page, viewer, first)


def test_back_and_forward_go_through_pairs_and_modes(person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    watcher = come(person, viewer)  # nobody acts here: it follows, and has one entry
    entries = watcher.evaluate("history.length")
    parts = [f"query={name}&" for name in ("007", "008", "009", "000", "002", "003")]
    for part in parts[1:]:
        page.keyboard.press("j")
        shows(page, part)
    page.get_by_role("button", name="Explore", exact=True).click()
    shows(page, "scene=world")
    length = page.evaluate("history.length")
    viewer.sessions[0].desk.change(
        params=replace(QUICK, closure=replace(QUICK.closure, min_score=4))
    )
    shows(page, "min_score=4")
    assert page.evaluate("history.length") == length  # a slider makes no entry
    for part in reversed(parts):
        page.go_back()
        shows(page, part)
        assert "scene=world" not in address(page)
    for part in (*parts[1:], "scene=world"):
        page.go_forward()
        shows(page, part)
    shows(watcher, "scene=world")
    assert watcher.evaluate("history.length") == entries


def test_the_matrix_beside_the_map_lights_up_pairs(person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    page.keyboard.press("Shift+P")
    matrix = page.locator("body > [data-board] svg[data-asks]")
    page.get_by_text("loop closures in 45 pairs").wait_for()
    page.get_by_role("button", name="Explore", exact=True).click()
    shows(page, "scene=world")
    assert viewer.wait_idle(PATIENCE)  # no outline is drawn of a submap that is not on the map yet
    matrix.focus()
    for key in ("ArrowDown", "ArrowDown", "ArrowRight"):
        matrix.press(key)
    page.locator("[data-board] [data-said]", has_text="003 → 001 · score ").wait_for()
    page.wait_for_function("document.querySelectorAll('[data-lit] polygon').length == 2")
    matrix.press("Enter")
    shows(page, "query=003&database=001")
    page.get_by_role("button", name="Close the matrix").click()
    matrix.wait_for(state="detached")


def test_an_arc_lights_up_its_pair_and_leads_to_it_and_back(person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    page.keyboard.press("Shift+P")
    page.get_by_text("loop closures in 45 pairs").wait_for()
    page.get_by_role("button", name="Explore", exact=True).click()
    shows(page, "scene=world")
    assert viewer.wait_idle(PATIENCE)
    session = viewer.sessions[0]
    (client,) = pages(session.desk.host).values()
    page.wait_for_timeout(2000)  # until the board has its place, and the camera fits the rest
    canvas, before = session.desk.canvases.of(client), view_of(client)
    best = session.world.scene.arches[0]
    arch = session.world.scene.arch((best.query_id, best.database_id))
    # A click is at a whole pixel; on this small canvas the next arc may be as near as the next one.
    x, y = np.round(place_on_screen(before, canvas, arch)[len(arch) // 2]).tolist()
    (query, database), _ = session.world.look(*line_of_sight(before, canvas, x, y), 0.01)
    box = page.locator("canvas").first.bounding_box()
    page.mouse.move(box["x"] + x, box["y"] + y)
    page.get_by_test_id("hover-card").get_by_text(f"{query} → {database}").wait_for()
    page.wait_for_function("document.querySelectorAll('[data-lit] polygon').length == 2")
    page.locator("[data-board] [data-spot][visibility=visible]").wait_for()
    page.locator("[data-board] [data-said]", has_text=f"{query} → {database} · score").wait_for()
    page.mouse.click(box["x"] + x, box["y"] + y)
    shows(page, f"query={query}&database={database}")
    page.wait_for_function("!document.querySelector('[data-lit] polygon')")
    page.go_back()
    shows(page, "scene=world")
    end = time.monotonic() + PATIENCE
    while not np.allclose(view_of(client).position, before.position, rtol=0.01):
        assert time.monotonic() < end, (view_of(client), before)
        page.wait_for_timeout(100)


@guarded
def test_a_page_outlives_its_server(person: Any, viewer: Viewer) -> None:
    page = come(person, viewer)
    press(page, "j", "query=008")
    desk = viewer.sessions[0].desk
    asked = replace(QUICK, closure=replace(QUICK.closure, min_score=4.5))
    desk.change(params=asked, options=replace(desk.state.options, layer="elevation"))
    shows(page, "view.layer=elevation")
    link = lasting_address(page)
    url, token = viewer.url, viewer.link.partition("token=")[2] or None
    viewer.close()
    said = page.get_by_test_id("connection")
    said.filter(has_text="does not answer").wait_for()
    again = start(token, int(url.rpartition(":")[2]))
    try:
        assert again.url == url
        said.filter(has_text="Connected").wait_for()
        follows(page, again, link)
        assert again.sessions[0].state.params.closure.min_score == 4.5
        page.reload()
        follows(page, again, link)
    finally:
        again.close()


@pytest.mark.parametrize("viewer", [OPEN], indirect=True)
def test_old_links_still_open(person: Any, viewer: Viewer) -> None:
    page = person.new_page()
    for between, query in (("#", "006"), ("/?#", "005")):
        page.goto(f"{viewer.link}{between}query={query}&database=001")
        is_there(page)
        shows(page, f"query={query}")


@guarded
def test_one_works_alone_and_follows_the_others_again(person: Any, viewer: Viewer) -> None:
    first, second = come(person, viewer), come(person, viewer)
    press(first, "j", "query=008")
    shows(second, "query=008")
    second.get_by_role("button", name="Work alone").click()
    shows(second, "/alone")
    is_there(second)
    assert "websocket" not in address(second)
    second.get_by_text("You work alone").wait_for()  # the last to come
    for _ in range(60):  # a page has its keys last, and this one may be pressed again
        second.keyboard.press("1")
        second.wait_for_timeout(1000)
        if "view.layer=elevation" in address(second):
            break
    press(first, "j", "query=009")
    assert "elevation" not in address(first)
    assert "query=008" in address(second)
    second.reload()
    is_there(second)
    shows(second, "view.layer=elevation")
    second.get_by_text("You work alone").wait_for()
    second.get_by_role("button", name="Follow").click()
    shows(second, "query=009")
    assert "elevation" not in address(second)
    assert "alone" not in address(second)
    assert first.get_by_test_id("presence").inner_text().startswith("2 people here")
