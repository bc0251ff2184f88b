"""The canvas and the address in a real browser: one is filled, and the other says with what."""

import io
import re
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from app.viewer.features.demo.tab import DemoTab
from app.viewer.scene.cameras import place_on_screen, view_of
from app.viewer.scene.placement import Canvas
from app.viewer.server.guard import open_server
from app.viewer.server.host import pages
from app.viewer.session.state import FROM_ABOVE, ViewOptions
from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.simulation.demo import demo_path
from tests.support.waiting import PATIENCE

pytestmark = [pytest.mark.browser, pytest.mark.slow]
MAP = {
    "max_points": 3000,
    "resolution": 0.12,
    "length_scale": 0.395,
    "noise_std": 0.0358,
    "signal_std": 0.188,
}
"""How much ground is trusted, and so drawn, is not what a fit makes of it."""
GIVEN = PipelineParams(map=MapParams(**MAP))
ADDRESS = "#query=007&database=001" + "".join(f"&params.map.{k}={v}" for k, v in MAP.items())
"""What a page asks for: a later one would have the default parameters, which take far longer."""


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    made = Viewer(load_dataset(demo_path()), GIVEN, port=0, source=str(demo_path()))
    yield made
    made.close()


@pytest.fixture
def opened(browser: Any, viewer: Viewer) -> Iterator[Callable[..., Any]]:
    """Open pages of a size, with options of the view."""
    pages: list[Any] = []

    def start(size: tuple[int, int], **options: Any) -> Any:
        pages.append(open_page(browser, viewer, size))
        viewer.sessions[0].desk.change(options=ViewOptions(**options))
        rest(pages[-1], viewer)
        return pages[-1]

    yield start
    for page in pages:
        page.close()


def open_page(browser: Any, viewer: Viewer, size: tuple[int, int]) -> Any:
    """Open a page of a size on the pair."""
    from tests.browser.chromium import NO_NOTICE  # noqa: PLC0415

    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(1000 * PATIENCE)
    page.add_init_script(NO_NOTICE)
    page.goto(f"{viewer.url}/?fixedDpr=0.5{ADDRESS}")
    page.get_by_test_id("scale").wait_for()
    wait(page, lambda: "score" in page.get_by_test_id("caption").text_content())
    assert viewer.wait_idle(PATIENCE)
    return page


def rest(page: Any, viewer: Viewer) -> Any:
    """Wait until nothing is worked on and what is drawn stands still; gives it."""
    from tests.browser.chromium import decode  # noqa: PLC0415

    assert viewer.wait_idle(PATIENCE)
    page.mouse.move(5, 5)
    seen = [decode(page.screenshot())]

    def same() -> bool:
        seen.append(decode(page.screenshot()))
        return len(seen) > 3 and all(np.array_equal(seen[-1], one) for one in seen[-3:-1])

    wait(page, same)
    return seen[-1]


def wait(page: Any, condition: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited too long"
        page.wait_for_timeout(200)


def covered(page: Any, viewer: Viewer) -> tuple[float, float]:
    """Look at the free canvas.

    Returns:
        The share of it that has something on it, and how much of its width or its height the scene
        reaches over, whichever is more.
    """
    seen = rest(page, viewer).astype(int)
    box = page.get_by_test_id("over-canvas").bounding_box()
    x, y = int(box["x"]), int(box["y"])
    free = seen[y : y + int(box["height"]), x : x + int(box["width"])]
    drawn = np.abs(free - free[3, 3]).max(axis=-1) > 20
    scene = drawn[60:-60]  # without what is written over it
    reach = max(
        np.ptp(np.flatnonzero(scene.any(axis=axis))) / drawn.shape[1 - axis] for axis in (0, 1)
    )
    return float(drawn.mean()), float(reach)


@pytest.mark.parametrize(
    "size",
    [(1280, 900), pytest.param((1920, 1080), marks=pytest.mark.nightly), (390, 844)],
)
def test_the_subject_fills_the_canvas(
    opened: Callable[..., Any], viewer: Viewer, size: tuple[int, int]
) -> None:
    page = opened(size, frames=True)  # the camera fills the canvas with the submaps' boxes
    shares = [covered(page, viewer)]
    page.keyboard.press("l")
    page.wait_for_function("location.href.includes('registered')")
    shares.append(covered(page, viewer))
    page.keyboard.press("f")
    page.get_by_test_id("pair-strip").wait_for(state="hidden")
    shares.append(covered(page, viewer))
    # The canvas of a phone is higher than wide, and the submaps are as wide as it is.
    assert min(share for share, _ in shares) > (0.18 if size[0] > 640 else 0.16), shares
    assert min(reach for _, reach in shares) > (0.7 if size[0] > 640 else 0.8), shares


LISTEN = """() => {
    const marks = gpgrad.acts.marks;
    gpgrad.acts.marks = data => {
        marks(data);
        if (data.at !== undefined) window.readAt = data.at;
    };
}"""
"""Keeps the place of the canvas that was read last."""


def read(page: Any, x: float) -> None:
    """Wait until the place under the cursor is read."""
    left = page.get_by_test_id("over-canvas").bounding_box()["x"]
    wait(page, lambda: abs((page.evaluate("window.readAt") or 0) + left - x) < 1)


def test_from_above_a_place_is_shown_in_both(opened: Callable[..., Any]) -> None:
    # Without keypoints, that would draw the mark to them.
    page = opened((1280, 800), layout=FROM_ABOVE, keypoints=False)
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    marks = page.locator("[data-testid=cursor-mark]")
    page.evaluate(LISTEN)
    for k in range(24):
        x = round(canvas["x"] + (0.42 + 0.006 * k) * canvas["width"])
        page.mouse.move(x, canvas["y"] + (0.2, 0.27, 0.34)[k % 3] * canvas["height"])
        read(page, x)
        if all(marks.nth(which).is_visible() for which in (0, 1)):
            break
    boxes = [marks.nth(which).bounding_box() for which in (0, 1)]
    assert abs(boxes[0]["x"] + boxes[0]["width"] / 2 - x) < 2
    assert boxes[1]["y"] > boxes[0]["y"] + canvas["height"] / 4  # the other submap lies below


def read_out_follows(page: Any) -> None:
    """Move the cursor quickly, and see that where it rests is read."""
    canvas = page.get_by_test_id("over-canvas").bounding_box()
    for step in range(10):
        x = canvas["x"] + (0.25 + 0.003 * step) * canvas["width"]
        page.mouse.move(x, canvas["y"] + (0.5 + 0.002 * step) * canvas["height"])
    read(page, x)
    card = page.get_by_test_id("hover-card")
    card.wait_for()
    assert re.search("±|descriptors differ|without a partner", card.inner_text())


def on_ground(page: Any, words: str) -> tuple[float, float]:
    """Rest the cursor on a place of the query of which the card says something."""
    canvas, card = (
        page.get_by_test_id("over-canvas").bounding_box(),
        page.get_by_test_id("hover-card"),
    )
    for share in np.random.default_rng(1).uniform((0.2, 0.42), (0.4, 0.58), (150, 2)):
        x, y = np.rint((canvas["x"], canvas["y"]) + share * (canvas["width"], canvas["height"]))
        page.mouse.move(x, y)
        read(page, x)
        if card.is_visible() and words in card.inner_text():
            return float(x), float(y)
    raise AssertionError(f"no place says {words!r}")


def test_hovering_reads_and_a_click_keeps(opened: Callable[..., Any], viewer: Viewer) -> None:
    page = opened((1440, 900))
    page.evaluate(LISTEN)
    read_out_follows(page)
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
    assert viewer.wait_idle(PATIENCE)
    page.mouse.click(x, y)  # on what is kept
    wait(page, lambda: session.state.probe is None)
    assert viewer.wait_idle(PATIENCE)
    x, y = on_ground(page, "inlier")
    assert card.locator("img").count() == 2  # the gradient round both keypoints
    assert [marks.nth(k).is_visible() for k in (0, 1)] == [True, True]
    page.mouse.click(x, y)
    wait(page, lambda: session.state.match > 0)
    page.mouse.wheel(0, -100)  # the picture moves: nothing is told of where things were
    card.wait_for(state="hidden")
    again = page.locator("label[for]").evaluate_all(
        "all => all.map(e => e.getBoundingClientRect().y)"
    )
    assert left == again  # no row has moved


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
            page.evaluate("theme => gpgradTheme.choose(theme)", "dark" if dark else "light")
            wait(page, lambda: middle()[0] < 60 and middle()[2] > 200)  # letters and plate
            wait(page, lambda dark=dark: middle()[1] < 90 if dark else middle()[1] > 200)
    finally:
        page.close()
        server.stop()


@pytest.mark.parametrize("size", [(1024, 768), (1280, 800), (1920, 1080)])
def test_caption_legend_and_frames_never_overlap_in_present(
    opened: Callable[..., Any], viewer: Viewer, size: tuple[int, int]
) -> None:
    page = opened(size)
    story = next(f for f in viewer.sessions[0].desk.features if isinstance(f, DemoTab)).story
    story.begin()
    for number in (0, 1, 4):
        story.turn(number - (story.told.step if story.told else 0))
        wait(page, lambda number=number: (told := story.told) is not None and told.step == number)
        wait(page, lambda: not story.worker.is_busy)
        page.wait_for_timeout(600)  # the page says what its words take
        story.turn(0)  # and the camera follows
        wait(page, lambda: not story.worker.is_busy)
        camera = view_of(next(iter(pages(viewer.sessions[0].desk.host).values())))
        corners = viewer.sessions[0].pair.scene.picture.corners
        spots = place_on_screen(camera, Canvas(*size), corners)
        assert spots.min() > 0
        assert (spots.max(axis=0) < size).all()
        boxes = [
            np.concatenate([part.min(axis=0), part.max(axis=0)]) for part in (spots[:4], spots[4:])
        ]
        for name in ("lower-third", "canvas-legend", "scale"):
            seen = page.get_by_test_id(name).bounding_box()
            x, y = seen["x"], seen["y"]
            box = np.array([x, y, x + seen["width"], y + seen["height"]])
            for other in boxes:
                apart = (box[2:] <= other[:2]).any() or (other[2:] <= box[:2]).any()
                assert apart, (name, number, box, other)
            boxes.append(box)
    title = page.get_by_test_id("lower-third").locator("div").first
    letters = float(title.evaluate("e => getComputedStyle(e).fontSize").removesuffix("px"))
    assert letters >= 40 * size[1] / 1080
    assert page.locator("[data-dock-region]:visible").count() == 0  # no rails


def test_the_swipe_follows_mouse_and_arrows(opened: Callable[..., Any], viewer: Viewer) -> None:
    page = opened((1280, 800), layout="registered", compare="swipe")
    session, handle = viewer.sessions[0], page.get_by_test_id("swipe-handle")
    client = next(iter(pages(session.desk.host).values()))
    wait(page, handle.is_visible)
    before, box = view_of(client), handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 90, y, steps=4)
    page.mouse.up()
    wait(page, lambda: session.state.options.swipe > 0.55)
    rest(page, viewer)
    box, dragged = handle.bounding_box(), session.state.options.swipe
    assert box["x"] + box["width"] / 2 == pytest.approx(x + 90, abs=12)
    page.keyboard.press("ArrowRight")
    wait(page, lambda: session.state.options.swipe == pytest.approx(dragged + 0.01))
    assert view_of(client) == before
