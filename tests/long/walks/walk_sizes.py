# ruff: noqa: T201 - tells where its pictures are
"""A walk through every part of the viewer, in four sizes, light and dark.

It prints a folder with the pictures and one sheet of all of them for each size. Look at each as a
stranger would: is it plain what is shown, in which unit, and what to do next?
"""

import tempfile
from collections.abc import Callable
from math import ceil
from pathlib import Path

import pytest
from PIL import Image

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.chromium import ViewerPage, find_chromium, launch

pytestmark = pytest.mark.browser
SIZES = ((1280, 900), (1440, 900), (1920, 1080), (390, 844))
WIDE = 640
"""Windows from this width on have panels beside the canvas."""
NO_NOTICE = "document.querySelectorAll('.mantine-Notifications-root').forEach(one => one.remove())"
"""The client warns that there is no graphics card."""
SHEET = 4
"""Pictures side by side on a sheet."""


class Album:
    """A page, and the pictures that were taken of it."""

    def __init__(self, page: ViewerPage, viewer: Viewer, folder: Path) -> None:
        self.page, self.viewer, self.folder = page, viewer, folder
        self.pictures: list[Path] = []
        folder.mkdir()

    def take(self, name: str, act: Callable[[], object] = lambda: None) -> None:
        """Act, wait until all is done, and take a picture."""
        act()
        self.page.page.wait_for_timeout(400)
        assert self.viewer.wait_idle(300)
        self.page.page.wait_for_timeout(900)
        path = self.folder / f"{len(self.pictures):02d}_{name}.png"
        self.page.page.screenshot(path=str(path))
        self.pictures.append(path)

    def sheet(self) -> Path:
        """Put all pictures onto one sheet."""
        pictures = [Image.open(path).convert("RGB") for path in self.pictures]
        width, height = pictures[0].size
        sheet = Image.new("RGB", (width * SHEET, height * ceil(len(pictures) / SHEET)))
        for k, picture in enumerate(pictures):
            sheet.paste(picture, (k % SHEET * width, k // SHEET * height))
        path = self.folder.with_suffix(".png")
        sheet.save(path)
        return path


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_every_part(size: tuple[int, int], dark: bool) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), PipelineParams(), port=0, source=str(demo_path()))
    name = f"{size[0]}x{size[1]}_{'dark' if dark else 'light'}"
    folder = Path(tempfile.mkdtemp(prefix="walk-sizes-")) / name
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=size if size[0] >= WIDE else SIZES[0])
            page.page.evaluate("theme => gpgradTheme.choose(theme)", "dark" if dark else "light")
            if size[0] < WIDE:  # anew, as a phone opens it
                page.page.set_viewport_size({"width": size[0], "height": size[1]})
                page.page.reload()
                page.page.get_by_test_id("verdict").wait_for()
                page.page.wait_for_timeout(3000)
                page.page.evaluate(NO_NOTICE)
            album = Album(page, viewer, folder)
            (_walk_wide if size[0] >= WIDE else _walk_narrow)(album)
            print(f"\n{album.sheet()}")
            assert page.errors == []
            assert page.outside == []
    finally:
        viewer.close()


def test_a_saved_page_plays_without_a_network(tmp_path: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), PipelineParams(), port=0, source=str(demo_path()))
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url)
            page.press("Demo")
            with page.page.expect_download(timeout=120_000) as coming:
                page.press("Save page")
            coming.value.save_as(tmp_path / "page.html")
            page.close()
            asked: list[str] = []
            errors: list[str] = []
            alone = browser.new_context(offline=True).new_page()
            alone.on("pageerror", lambda error: errors.append(str(error)))
            alone.on("request", lambda request: asked.append(request.url))
            alone.goto((tmp_path / "page.html").as_uri())
            alone.get_by_test_id("page-title").wait_for(timeout=60_000)
            middle = {"x": 350, "y": 200, "width": 500, "height": 400}
            moments: set[bytes] = set()
            for _ in range(40):
                alone.wait_for_timeout(400)
                moments.add(alone.screenshot(clip=middle))
            assert len(moments) > 2
            assert errors == []
            assert all(url.startswith(("file:", "blob:", "data:")) for url in asked)
    finally:
        viewer.close()


def _walk_wide(album: Album) -> None:
    page, mouse = album.page, album.page.page.mouse
    left, right = page.panel_edges()
    across, height = right - left, page.page.viewport_size["height"]  # type: ignore[index]
    # On the query, which stands behind the database or to its left.
    on_query = (0.45, 0.25) if across < 0.8 * height else (0.28, 0.4)

    def click(right: float = 0.0, down: float = 0.0) -> None:
        page.shift_click(left + (on_query[0] + right) * across, (on_query[1] + down) * height)

    album.take("open")
    album.take("submaps", lambda: page.page.get_by_test_id("pair-query").click())
    page.page.keyboard.press("Escape")
    album.take("layers", lambda: page.widget("Surfaces"))
    album.take("mask", lambda: page.drag("Variance mask", -25))
    album.take("cannot_judge", lambda: page.type_value("Variance mask", "0.01"))
    page.press("Reset parameters")
    album.take("registered", lambda: page.key("l"))
    album.take("agreement", lambda: page.choose("Layer", "agreement"))
    album.take("from_above", lambda: page.choose("Layout", "gradient from above"))
    x, y = left + on_query[0] * across, on_query[1] * height
    mouse.move(x, y)
    album.take("cursor", lambda: mouse.move(x + 6, y + 10))
    page.choose("Layout", "side by side")
    page.choose("Layer", "elevation")
    page.tab("Inspect")
    album.take("reading", click)
    page.tick("Ruler")
    click(-0.03)
    album.take("profile", lambda: click(0.07, 0.07))
    page.tick("Ruler")
    page.tab("All pairs")
    album.take("all_pairs", lambda: page.press("Run all pairs"))
    album.take("triage")
    album.take("refused", lambda: page.key("x"))
    page.tab("Data")
    album.take("data")
    page.tab("Save")
    album.take("save")
    page.tab("Inspect")
    page.page.get_by_text("Nudge", exact=True).click()
    album.take("nudge")
    album.take("explore", lambda: page.press("Explore"))
    page.tab("Pose graph")
    page.press("Find closures")
    page.wait(lambda: "closures accepted" in page.say("graph-summary"), "closures", timeout=240)
    album.take("closures")
    album.take("optimised", lambda: page.press("Optimise"))
    album.take("demo", lambda: page.press("Demo"))
    album.take("full_screen", lambda: page.key("f"))


def _walk_narrow(album: Album) -> None:
    page = album.page
    album.take("open")
    album.take("submaps", lambda: page.page.get_by_test_id("pair-database").click())
    page.page.keyboard.press("Escape")
    album.take("registered", lambda: page.key("l"))
    for mode in ("Explore", "Demo"):
        page.press(mode)
        page.page.mouse.move(5, 5)  # a finger does not rest on what it has pressed
        album.take(mode.lower())
