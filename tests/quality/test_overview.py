"""How fast a large dataset is to be seen, and what is left of it after a day of switching.

Run by hand: ``pytest tests/quality/test_overview.py -n 0 -s``. The machine draws in software, so
the times are an upper bound for one with a graphics card.
"""

import gc
import time
from pathlib import Path

import numpy as np
import pytest

from app.server import Viewer
from gpgrad_core.datasets import write_dataset
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
    page.page.get_by_role("tab", name="Submaps and view", exact=True).click()
    page.page.wait_for_timeout(300)


def test_a_large_dataset_is_seen_at_once_and_leaves_nothing(tmp_path: Path) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    first, second = traverse("first", 0.0), traverse("second", 1.0)
    write_dataset(first, tmp_path / "first")
    write_dataset(second, tmp_path / "second")
    viewer = Viewer(first, QUICK, port=0, source=str(tmp_path / "first"))
    assert viewer.wait_idle(60)
    with launch(executable) as browser:
        page = ViewerPage(browser, viewer.url, size=(1280, 760), script=FIRST_PICTURE)
        opened = page.page.evaluate("window.firstPicture") / 1000
        start = time.monotonic()
        before = page.picture()
        page.press("Explore")
        page.wait(lambda: page.page.get_by_test_id("world-summary").count() > 0, "the world")
        page.wait(
            lambda: "30 submaps" in page.page.get_by_test_id("world-summary").inner_text(),
            "the overview",
        )
        page.wait(lambda: not page.is_blank() and (page.picture() != before).any(), "its picture")
        overview = time.monotonic() - start
        cells = page.page.get_by_test_id("world-summary").inner_text()
        print(f"page to first picture {opened:.1f} s, overview {overview:.1f} s: {cells}")  # noqa: T201
        used: list[tuple[float, float]] = []
        for k in range(WARM_UP + ROUNDS):
            look_around(page, viewer, tmp_path / "first", tmp_path / "second")
            used.append((resident_megabytes(), heap_megabytes(page)))
            print(f"round {k}: server {used[-1][0]:.0f} MB, page {used[-1][1]:.1f} MB")  # noqa: T201
        assert page.errors == []
        page.close()
    viewer.close()
    assert opened <= 3.0
    assert overview <= 8.0
    for before_rounds, after_rounds in zip(used[WARM_UP - 1], used[-1], strict=True):
        assert after_rounds <= 1.1 * before_rounds
