"""The canvas and the address in a real browser: one is filled, and the other says with what."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LOAD_MS = 60_000


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    made = Viewer(load_dataset(demo_path()), QUICK, port=0, source=str(demo_path()))
    yield made
    made.close()


def open_page(browser: Any, viewer: Viewer, size: tuple[int, int], address: str = "") -> Any:
    page = browser.new_page()
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.goto(f"{viewer.url}/?fixedDpr=1{address}")
    page.get_by_test_id("scale").wait_for(timeout=LOAD_MS)
    wait(page, lambda: "score" in page.get_by_test_id("caption").inner_text())
    assert viewer.wait_idle(60)
    page.evaluate("document.querySelectorAll('.mantine-Notifications-root').forEach(e=>e.remove())")
    page.wait_for_timeout(1000)
    return page


def wait(page: Any, condition: Any) -> None:
    for _ in range(300):
        if condition():
            return
        page.wait_for_timeout(200)
    raise AssertionError("waited too long")


def covered(page: Any, picture: Path) -> tuple[float, float]:
    """Look at the free canvas, and keep a picture of it to look at.

    Returns:
        The share of it that has something on it, and how much of its width or its height the scene
        reaches over, whichever is more.
    """
    from PIL import Image  # noqa: PLC0415

    page.mouse.move(5, 5)
    page.wait_for_timeout(700)
    png = page.screenshot(path=str(picture))
    seen = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    box = page.get_by_test_id("over-canvas").bounding_box()
    x, y = int(box["x"]), int(box["y"])
    free = seen[y : y + int(box["height"]), x : x + int(box["width"])]
    drawn = np.abs(free - free[3, 3]).max(axis=-1) > 20
    scene = drawn[60:-60]  # without what is written over it
    reach = max(
        np.ptp(np.flatnonzero(scene.any(axis=axis))) / drawn.shape[1 - axis] for axis in (0, 1)
    )
    return float(drawn.mean()), float(reach)


@pytest.mark.parametrize("size", [(1280, 900), (1920, 1080), (390, 844)])
def test_the_subject_fills_the_canvas(
    browser: object, viewer: Viewer, tmp_path: Path, size: tuple[int, int]
) -> None:
    page, shares = open_page(browser, viewer, size), list[tuple[float, float]]()
    shares.append(covered(page, tmp_path / "apart.png"))
    page.keyboard.press("l")
    page.wait_for_timeout(1000)
    assert viewer.wait_idle(60)
    shares.append(covered(page, tmp_path / "registered.png"))
    page.keyboard.press("f")
    page.wait_for_timeout(2500)
    shares.append(covered(page, tmp_path / "full_screen.png"))
    page.close()
    assert min(share for share, _ in shares) > 0.18, shares
    assert min(reach for _, reach in shares) > 0.7, shares


def test_a_link_made_in_one_browser_opens_the_same_in_another(
    browser: Any, viewer: Viewer, tmp_path: Path
) -> None:
    page = open_page(browser, viewer, (1280, 900))
    session = viewer.sessions[0]
    page.keyboard.press("j")  # the next query
    page.keyboard.press("3")  # another layer
    wait(page, lambda: "view.layer=gradient" in page.evaluate("location.hash"))
    assert viewer.wait_idle(60)
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    page.mouse.move(canvas["x"] + 300, 450)
    page.mouse.wheel(0, 400)
    wait(page, lambda: "camera=" in page.evaluate("location.hash"))
    page.wait_for_timeout(1500)
    link, state = page.evaluate("gpgradLink.link()"), session.state
    assert "fixedDpr" not in link
    caption = page.get_by_test_id("caption").inner_text()
    camera = page.evaluate("location.hash").split("camera=")[1]
    page.close()

    other = Viewer(load_dataset(demo_path()), None, port=0, source=str(demo_path()))
    context = browser.new_context()
    try:
        page = open_page(context, other, (1280, 900), "#" + link.partition("#")[2])
        wait(page, lambda: page.get_by_test_id("caption").inner_text() == caption)
        shown = other.sessions[0].state
        assert (shown.query_id, shown.database_id) == (state.query_id, state.database_id)
        assert shown.params == state.params
        assert shown.options == state.options
        wait(page, lambda: f"camera={camera}" in page.evaluate("location.hash"))
        page.screenshot(path=str(tmp_path / "linked.png"))

        late = open_page(context, other, (1280, 900), "#query=001&database=000")
        assert other.sessions[0].state is shown
        wait(late, lambda: late.evaluate("location.hash").startswith(f"#query={state.query_id}"))
        late.close()
        page.close()
    finally:
        context.close()
        other.close()


def test_from_above_the_place_under_the_cursor_is_shown_in_both(
    browser: object, viewer: Viewer, tmp_path: Path
) -> None:
    page = open_page(
        browser, viewer, (1920, 1080), "#query=007&database=001&view.layout=gradient%20from%20above"
    )
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    marks = page.locator("[data-testid=cursor-mark]")

    def both() -> bool:
        page.mouse.move(
            canvas["x"] + 0.27 * canvas["width"] + np.random.default_rng().uniform(),
            canvas["y"] + 0.5 * canvas["height"],
        )
        page.wait_for_timeout(150)
        return [marks.nth(k).is_visible() for k in (0, 1)] == [True, True]

    wait(page, both)
    boxes = [marks.nth(k).bounding_box() for k in (0, 1)]
    middle = boxes[0]["x"] + boxes[0]["width"] / 2
    assert abs(middle - canvas["x"] - 0.27 * canvas["width"]) < 4
    assert boxes[1]["x"] > canvas["x"] + canvas["width"] / 2
    page.screenshot(path=str(tmp_path / "from_above.png"))
    page.close()
