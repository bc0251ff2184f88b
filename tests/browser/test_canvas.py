"""The canvas and the address in a real browser: one is filled, and the other says with what."""

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.viewer.server.guard import open_server
from app.viewer.server.host import set_theme
from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LOAD_MS = 60_000
GIVEN = replace(
    QUICK, map=replace(QUICK.map, length_scale=0.395, noise_std=0.0358, signal_std=0.188)
)
"""How much ground is trusted, and so drawn, is not what a fit makes of it."""


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    made = Viewer(load_dataset(demo_path()), GIVEN, port=0, source=str(demo_path()))
    yield made
    made.close()


def open_page(browser: Any, viewer: Viewer, size: tuple[int, int], address: str = "") -> Any:
    page = browser.new_page()
    page.set_viewport_size({"width": size[0], "height": size[1]})
    page.goto(f"{viewer.url}/?fixedDpr=1{address}")
    page.get_by_test_id("scale").wait_for(timeout=LOAD_MS)
    wait(page, lambda: "score" in page.get_by_test_id("caption").text_content())
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


def test_from_above_the_place_under_the_cursor_is_shown_in_both(
    browser: object, viewer: Viewer, tmp_path: Path
) -> None:
    # Without keypoints, that would draw the mark to them.
    view = "view.layout=gradient%20from%20above&view.keypoints=false"
    page = open_page(browser, viewer, (1920, 1080), f"#query=007&database=001&{view}")
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
    assert abs(middle - canvas["x"] - 0.27 * canvas["width"]) < 2
    assert boxes[1]["x"] > canvas["x"] + canvas["width"] / 2
    page.screenshot(path=str(tmp_path / "from_above.png"))
    page.close()


def test_the_read_out_follows_the_cursor_to_where_it_rests(browser: object, viewer: Viewer) -> None:
    page = open_page(browser, viewer, (1440, 900), "#query=007&database=001")
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    page.evaluate(
        """() => {
          const marks = gpgrad.acts.marks;
          gpgrad.acts.marks = data => {
            marks(data);
            if (data.at !== undefined) window.readAt = data.at;
          };
        }"""
    )
    for step in range(10):
        x = canvas["x"] + (0.25 + 0.003 * step) * canvas["width"]
        page.mouse.move(x, canvas["y"] + (0.5 + 0.002 * step) * canvas["height"])
    wait(page, lambda: abs((page.evaluate("window.readAt") or 0) + canvas["x"] - x) < 1)
    card = page.get_by_test_id("hover-card")
    assert card.is_visible()
    assert "±" in card.inner_text() or "descriptors differ" in card.inner_text()
    page.close()


def on_ground(page: Any, words: str) -> tuple[float, float]:
    """Rest the cursor on a place of the query of which the card says something."""
    canvas, card = (
        page.get_by_test_id("over-canvas").bounding_box(),
        page.get_by_test_id("hover-card"),
    )
    for share in np.random.default_rng(1).uniform((0.2, 0.42), (0.4, 0.58), (150, 2)):
        x, y = np.rint((canvas["x"], canvas["y"]) + share * (canvas["width"], canvas["height"]))
        page.mouse.move(x, y)
        page.wait_for_timeout(300)
        if card.is_visible() and words in card.inner_text():
            return float(x), float(y)
    raise AssertionError(f"no place says {words!r}")


def test_hovering_reads_the_ground_and_a_keypoints_partner_and_a_click_keeps_them(
    browser: object, viewer: Viewer, tmp_path: Path
) -> None:
    page = open_page(browser, viewer, (1440, 900), "#query=007&database=001")
    session = viewer.sessions[0]
    marks = page.locator("[data-testid=cursor-mark]")
    card = page.get_by_test_id("hover-card")
    left = page.locator("label[for]").evaluate_all(
        "all => all.map(e => e.getBoundingClientRect().y)"
    )
    x, y = on_ground(page, "slope")
    assert "database 001" in card.inner_text()
    assert marks.nth(0).is_visible()
    page.mouse.click(x, y)
    wait(page, lambda: session.state.probe is not None)
    assert session.state.probe.role == "query"
    assert viewer.wait_idle(60)
    page.mouse.click(x, y)  # on what is kept
    wait(page, lambda: session.state.probe is None)
    assert viewer.wait_idle(60)
    x, y = on_ground(page, "inlier")
    assert card.locator("img").count() == 2  # the gradient round both keypoints
    assert [marks.nth(k).is_visible() for k in (0, 1)] == [True, True]
    page.screenshot(path=str(tmp_path / "keypoint.png"))
    page.mouse.click(x, y)
    wait(page, lambda: session.state.match > 0)
    page.mouse.wheel(0, -100)  # the picture moves: nothing is told of where things were
    assert not card.is_visible()
    again = page.locator("label[for]").evaluate_all(
        "all => all.map(e => e.getBoundingClientRect().y)"
    )
    assert left == again  # no row has moved
    page.close()


def test_labels_are_dark_on_a_dark_page(browser: Any) -> None:
    from PIL import Image  # noqa: PLC0415

    server, _ = open_server("127.0.0.1", 0)
    server.scene.add_label(
        "label", "MMMM", font_size_mode="scene", font_scene_height=2.0, anchor="center-center"
    )
    server.initial_camera.position = (0.0, 0.0, 10.0)
    page = browser.new_page()

    def middle() -> tuple[float, float, float]:
        """Give the least, the middle and the largest grey value within the label."""
        png = page.screenshot()
        grey = np.asarray(Image.open(io.BytesIO(png)).convert("L"), float)
        rows, columns = grey.shape
        part = grey[rows // 2 - 50 : rows // 2 + 50, columns // 2 - 150 : columns // 2 + 150]
        return float(part.min()), float(np.median(part)), float(part.max())

    try:
        page.goto(f"http://127.0.0.1:{server.get_port()}/?fixedDpr=1")
        for dark in (False, True, False):
            set_theme(server, dark=dark)
            wait(page, lambda: middle()[0] < 60 and middle()[2] > 200)  # letters and plate
            wait(page, lambda dark=dark: middle()[1] < 90 if dark else middle()[1] > 200)
    finally:
        page.close()
        server.stop()
