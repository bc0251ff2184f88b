"""The bridge from the viewer's own HTML to Python, in a real page of viser's."""

import time

import pytest
import viser

from app.viewer.widgets.actions import on_choice
from app.viewer.widgets.bridge import Bridge, Data, send
from tests.support.waiting import PATIENCE

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def test_what_html_says_arrives_once_and_in_order(browser: object) -> None:
    heard: list[tuple[str, Data]] = []
    slid: list[float] = []
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    bridge = Bridge(server)
    bridge.hear("cell", lambda _, data: heard.append(("cell", data)))
    bridge.hear("drag", lambda _, data: heard.append(("drag", data)))
    slider = server.gui.add_slider("Slider", 0.0, 1.0, 0.1, 0.0)
    on_choice(slider, slid.append)
    name = "a \"quoted\" 'name' <b> & é"
    server.gui.add_html(
        f'<svg width="20" height="20"><rect data-testid="cell" width="20" height="20" '
        f'onclick="{send("cell", query=name, row=3)}"/></svg>'
    )
    try:
        page = browser.new_page()  # type: ignore[attr-defined]
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(f"http://127.0.0.1:{server.get_port()}/")
        cell = page.get_by_test_id("cell")
        cell.click()
        cell.click()  # the same words again are another message
        page.evaluate("for (let k = 0; k < 9; k++) gpgrad.say('drag', {to: k}, true)")
        page.evaluate("gpgrad.say('nobody hears this', {})")
        page.evaluate("gpgrad.say('cell', {query: 'last', row: 0})")
        end = time.monotonic() + PATIENCE
        ends = [("cell", {"query": "last", "row": 0}), ("drag", {"to": 8})]  # in either order
        while not all(one in heard for one in ends) and time.monotonic() < end:
            page.wait_for_timeout(100)
        cells = [data for what, data in heard if what == "cell"]
        assert cells == [{"query": name, "row": 3}, {"query": name, "row": 3}, cells[-1]]
        drags = [data["to"] for what, data in heard if what == "drag"]
        assert drags[-1] == 8
        assert len(drags) <= 3
        assert not page.get_by_text("bridge").first.is_visible()
        assert slid == []
        # viser sends only the last of what its inputs change within 50 ms.
        page.evaluate(
            """() => {
              const key = {key: 'ArrowRight', bubbles: true};
              const move = () => document.querySelector('[role=slider]').dispatchEvent(
                new KeyboardEvent('keydown', key));
              move(); gpgrad.say('cell', {query: 'pushed out'}); move();
            }"""
        )
        while heard[-1][1].get("query") != "pushed out" and time.monotonic() < end:
            page.wait_for_timeout(100)
        assert heard[-1] == ("cell", {"query": "pushed out"})
        page.evaluate("gpgrad.say('cell', {query: 'after'})")
        while heard[-1][1].get("query") != "after" and time.monotonic() < end:
            page.wait_for_timeout(100)
        assert [data["query"] for _, data in heard[-2:]] == ["pushed out", "after"]
        while 0.2 not in slid and time.monotonic() < end:
            page.wait_for_timeout(100)
        assert slid[-1] == 0.2
        page.close()
    finally:
        server.stop()
