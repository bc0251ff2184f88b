"""A walk through Explore, Demo and the pose graph, as a newcomer would take it.

Run by hand: ``pytest tests/walks/walk_explore.py -n 0 -s``; it prints where the pictures are.
"""

import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.viewer.viewer import Viewer
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.io.poses import read_poses
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.slam import read_graph
from tests.browser.chromium import Pixels, ViewerPage, changed, find_chromium, launch
from tests.browser.conftest import QUICK

pytestmark = pytest.mark.browser
SIZE = (1280, 760)


class Tour:
    """A page, and the pictures taken of it so far."""

    def __init__(self, page: ViewerPage, viewer: Viewer, folder: Path) -> None:
        self.page = page
        self.viewer = viewer
        self.folder = folder
        self.count = 0

    def rest(self) -> None:
        """Wait until the viewer has nothing to do and the page shows it."""
        self.page.page.wait_for_timeout(400)
        assert self.viewer.wait_idle(120)
        last = self.look()
        for _ in range(60):
            self.page.page.wait_for_timeout(300)
            now = self.look()
            if changed(last, now) == 0.0:
                return
            last = now
        raise AssertionError("the picture never stood still")

    def look(self) -> Pixels:
        """See the scene between the panels."""
        png = self.page.page.screenshot()
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
        return pixels[100:-60, 310:-340]

    def until(self, before: Pixels, share: float, what: str) -> None:
        """Wait until so much of the scene has changed."""
        self.page.wait(lambda: changed(before, self.look()) > share, what)

    def shot(self, name: str, *, rest: bool = True) -> Pixels:
        """Take a picture; nothing may be blank."""
        if rest:
            self.rest()
        png = self.page.page.screenshot()
        self.count += 1
        (self.folder / f"{self.count:02d}_{name}.png").write_bytes(png)
        pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
        middle = pixels[100:-60, 310:-340]
        assert (np.abs(middle - middle[0, 0]).max(axis=-1) > 20).mean() > 0.02, f"{name} is blank"
        return middle

    def text(self, test_id: str) -> str:
        """Read a read-out; it must be there."""
        said = self.page.page.get_by_test_id(test_id).last.inner_text()
        assert said.strip(), f"{test_id} is empty"
        return said

    def tab(self, name: str) -> None:
        """Open a tab."""
        self.page.page.get_by_role("tab", name=name, exact=True).click()
        self.page.page.wait_for_timeout(300)

    def download(self, button: str) -> Path:
        """Press a button that sends a file, and keep it."""
        with self.page.page.expect_download(timeout=120_000) as coming:
            self.page.press(button)
        path = self.folder / coming.value.suggested_filename
        coming.value.save_as(path)
        return path


def expect_motion(take: Callable[[], Pixels], pause: Callable[[], None], what: str) -> None:
    """Take pictures until the same view has shown three different moments."""
    moments = [take()]
    for _ in range(40):
        pause()
        now = take()
        if all(changed(seen, now) > 0.002 for seen in moments):
            moments.append(now)
        if len(moments) == 3:
            return
    raise AssertionError(f"{what}: saw {len(moments)} different moments, not 3")


def explore(tour: Tour) -> None:
    page = tour.page
    page.press("Explore")
    first = tour.shot("explore")
    assert "10 submaps" in tour.text("world-summary")
    canvas = page.page.locator("canvas").first.bounding_box()
    assert canvas is not None
    page.page.mouse.click(
        canvas["x"] + canvas["width"] / 2, canvas["y"] + canvas["height"] / 2 + 20
    )
    tour.shot("submap_clicked")
    figures = tour.text("submap-figures")
    for name in ("points", "extent", "density", "height std", "true pose", "odometry off by"):
        assert name in figures
    for color in ("elevation", "deviation", "gradient"):
        page.choose("Colour by", color)
        tour.until(first, 0.05, f"another picture by {color}")
        tour.shot(f"by_{color}")
        assert "[m" in tour.text("legend")
    assert "median deviation" in tour.text("submap-figures")
    page.choose("Poses", "true")
    tour.shot("true_poses")
    page.choose("Poses", "odometry")
    page.choose("Colour by", "submap")
    page.press("Look at it")
    tour.shot("one_submap")
    page.press("Show all submaps")
    tour.rest()


def pose_graph(tour: Tour) -> None:
    page = tour.page
    tour.tab("Pose graph")
    assert "No closures yet" in tour.text("graph-summary")
    page.press("Find closures")
    found = tour.shot("closures_found")
    assert "closures accepted of 45 pairs" in tour.text("graph-summary")
    page.press("Optimise")
    expect_motion(
        lambda: tour.shot("relaxing", rest=False),
        lambda: page.page.wait_for_timeout(150),
        "pose graph",
    )
    assert changed(found, tour.shot("optimised")) > 0.01
    result = tour.text("graph-result")
    before, after = (
        float(one.split()[0]) for one in result.partition("(ATE)")[2].split("\n")[0].split("→")
    )
    assert after < 0.25 * before
    page.tick("Refused pairs")
    tour.shot("refused_too")
    page.tick("Refused pairs")
    page.page.get_by_role("button", name="next", exact=True).last.click()
    tour.shot("one_loop")
    page.press("refuse")
    tour.shot("refused_by_hand")
    assert "optimise again" in tour.text("graph-summary")
    page.press("Undo decision")
    tour.rest()
    assert "optimise again" not in tour.text("graph-summary")
    closures = json.loads(tour.download("closures").read_text())
    assert len(closures["pairs"]) == 45
    assert len(read_graph(tour.download("g2o")).loops) == sum(
        pair["accepted"] for pair in closures["pairs"]
    )
    names = {number: f"{number:03d}" for number in range(10)}
    assert len(read_poses(tour.download("TUM"), names)) == 10


def nudge(tour: Tour) -> None:
    page = tour.page
    page.press("See it in Tune")
    tour.shot("loop_in_tune")
    tour.tab("Nudge")
    page.tick("Move the query")
    tour.shot("handles")
    found = tour.text("nudge-figures")
    page.press("Refine")
    tour.shot("refined")
    assert "Refined in" in tour.text("nudge-message")
    assert found.split()[0] == tour.text("nudge-figures").split()[0]
    page.press("Use in the pose graph")
    tour.rest()
    assert "Accepted by hand" in tour.text("nudge-message")
    page.tick("Move the query")
    tour.tab("View")
    tour.shot("nudged_away")


def demo(tour: Tour) -> tuple[Path, Path]:
    page = tour.page
    page.press("Demo")
    tour.shot("demo")
    page.press("top")
    tour.shot("from_above")
    page.press("oblique")
    tour.rest()
    page.press("Save this view")
    page.press("closure")
    expect_motion(
        lambda: tour.shot("gliding", rest=False),
        lambda: page.page.wait_for_timeout(250),
        "closure",
    )
    tour.shot("closed")
    pair_page = tour.download("Save page")
    page.press("world")
    tour.shot("demo_world")
    page.press("pose graph")
    expect_motion(
        lambda: tour.shot("relaxing_again", rest=False),
        lambda: page.page.wait_for_timeout(250),
        "pose graph",
    )
    tour.rest()
    world_page = tour.download("Save page")
    page.press("follow loop")
    page.page.wait_for_timeout(3000)
    tour.shot("along_the_way", rest=False)
    tour.rest()
    page.press("oblique")
    page.press("Full screen")
    tour.shot("full_screen")
    assert not page.page.get_by_role("button", name="Full screen", exact=True).is_visible()
    page.page.mouse.click(SIZE[0] / 2, 60)
    page.page.keyboard.press("Escape")
    page.page.get_by_role("button", name="Full screen", exact=True).wait_for(timeout=20_000)
    page.press("Tune")
    tour.shot("back_in_tune")
    return pair_page, world_page


def expect_playing(browser: object, path: Path, folder: Path) -> None:
    """Open a page from disk without a network; it must move, and ask for nothing."""
    context = browser.new_context(  # type: ignore[attr-defined]
        viewport={"width": 1000, "height": 640}, offline=True
    )
    page = context.new_page()
    errors: list[str] = []
    outside: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda request: outside.append(request.url))
    page.goto(path.as_uri())
    page.get_by_test_id("page-title").wait_for(timeout=60_000)
    page.wait_for_timeout(4000)

    def take() -> Pixels:
        png = page.screenshot(clip={"x": 250, "y": 120, "width": 500, "height": 400})
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)

    expect_motion(take, lambda: page.wait_for_timeout(400), path.name)
    page.screenshot(path=folder / f"offline_{path.stem}.png")
    assert page.get_by_test_id("page-title").inner_text().startswith("demo")
    assert errors == []
    assert [url for url in outside if not url.startswith(("file:", "blob:", "data:"))] == []
    context.close()


def test_explore_demo_and_pose_graph() -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    folder = Path(tempfile.mkdtemp(prefix="gpgrad_tour_stage_"))
    print(f"pictures in {folder}")  # noqa: T201
    viewer = Viewer(load_dataset(demo_path()), QUICK, port=0, source=str(demo_path()))
    with launch(executable) as browser:
        page = ViewerPage(browser, viewer.url, size=SIZE)
        tour = Tour(page, viewer, folder)
        explore(tour)
        pose_graph(tour)
        nudge(tour)
        pages = demo(tour)
        assert page.errors == []
        assert page.outside == []
        page.close()
        for path in pages:
            expect_playing(browser, path, folder)
    viewer.close()
