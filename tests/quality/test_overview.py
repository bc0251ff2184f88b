"""How fast a large dataset is to be seen, and what is left of it after a day of switching.

Run by hand: ``pytest tests/quality/test_overview.py -n 0 -s``. The machine draws in software, so
the times are an upper bound for one with a graphics card.
"""

import gc
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.viewer.server import Viewer
from gpgrad_core.datasets import load_dataset, write_dataset
from gpgrad_core.gradient_map import MapParams
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.app.synthetic import make_submap
from tests.browser.chromium import ViewerPage, find_chromium, launch

pytestmark = pytest.mark.browser

NUM_SUBMAPS, NUM_POINTS = 30, 30_000
ROUNDS, WARM_UP = 10, 3
QUICK = PipelineParams(map=MapParams(max_points=2000, resolution=0.15))
"""Of the pair and the maps; the overview takes all points whatever these say."""


FIRST_PICTURE = """
for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    const result = draw.apply(this, given);
    const count = name.startsWith("drawArrays") ? given[2] : given[1];
    if (window.firstPicture === undefined && count > 1000) {
      this.finish();
      window.firstPicture = performance.now();
    }
    return result;
  };
}
"""
"""Notes when the first surface was drawn [ms since the page began to load]."""
SINCE_LOADED = "window.firstPicture - performance.getEntriesByType('navigation')[0].loadEventEnd"


def traverse(name: str, turn: float) -> Dataset:
    """Submaps along two rounds of a circle."""
    submaps = []
    for k in range(NUM_SUBMAPS):
        angle = turn + 4 * np.pi * k / NUM_SUBMAPS
        pose = SE2(20 * np.cos(angle), 20 * np.sin(angle), angle + np.pi / 2)
        submaps.append(make_submap(f"{k:03d}", pose, NUM_POINTS, side=11.0))
    return Dataset(name, tuple(submaps))


def resident_megabytes() -> float:
    gc.collect()
    status = Path("/proc/self/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


def heap_megabytes(page: ViewerPage) -> float:
    session = page.page.context.new_cdp_session(page.page)
    for _ in range(3):
        session.send("HeapProfiler.collectGarbage")
        page.page.wait_for_timeout(200)
    used = session.send("Runtime.getHeapUsage")
    session.detach()
    return (used["usedSize"] + used.get("backingStorageSize", 0.0)) / 1e6


def look_around(page: ViewerPage, viewer: Viewer, folder: Path, other: Path) -> None:
    """Once round all that an hour at the viewer is made of."""
    page.press("Explore")
    for color in ("elevation", "deviation", "submap"):
        page.choose("Colour by", color)
        assert viewer.wait_idle(120)
    page.page.get_by_role("button", name="next", exact=True).first.click()
    page.press("Tune")
    page.choose("Layer", "gradient")
    page.choose("Layer", "elevation")
    assert viewer.wait_idle(120)
    page.page.get_by_role("tab", name="Data", exact=True).click()
    for path in (other, folder):
        page.type_text("Folder", str(path))
        page.press("Load")
        page.page.wait_for_timeout(1500)
        assert viewer.wait_idle(120)
    page.page.get_by_role("tab", name="View", exact=True).click()
    page.page.wait_for_timeout(300)


@pytest.fixture
def viewer(tmp_path: Path) -> Iterator[Viewer]:
    for name, turn in (("first", 0.0), ("second", 1.0)):
        write_dataset(traverse(name, turn), tmp_path / name)
    first = load_dataset(tmp_path / "first")
    made = Viewer(first, QUICK, port=0, source=str(tmp_path / "first"))
    assert made.wait_idle(60)
    yield made
    made.close()


@pytest.fixture
def page(viewer: Viewer) -> Iterator[ViewerPage]:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    with launch(executable) as browser:
        opened = ViewerPage(browser, viewer.url, size=(1280, 760), script=FIRST_PICTURE)
        yield opened
        assert opened.errors == []
        opened.close()


def test_a_large_dataset_is_seen_at_once(page: ViewerPage) -> None:
    opened = page.page.evaluate(SINCE_LOADED) / 1000
    before = page.picture()
    start = time.monotonic()
    page.press("Explore")
    summary = page.page.get_by_test_id("world-summary")
    page.wait(lambda: summary.count() > 0 and "30 submaps" in summary.inner_text(), "the overview")
    page.wait(lambda: not page.is_blank() and (page.picture() != before).any(), "its picture")
    overview = time.monotonic() - start
    print(f"first picture {opened:.1f} s, overview {overview:.1f} s: {summary.inner_text()}")
    assert opened <= 3.0
    assert overview <= 8.0


def test_switching_leaves_nothing(page: ViewerPage, viewer: Viewer, tmp_path: Path) -> None:
    used: list[tuple[float, float]] = []
    for k in range(WARM_UP + ROUNDS):
        look_around(page, viewer, tmp_path / "first", tmp_path / "second")
        used.append((resident_megabytes(), heap_megabytes(page)))
        print(f"round {k}: server {used[-1][0]:.0f} MB, page {used[-1][1]:.1f} MB")
    for before, after in zip(used[WARM_UP - 1], used[-1], strict=True):
        assert after <= 1.1 * before
