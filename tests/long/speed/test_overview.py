"""How fast a large dataset is to be seen.

The machine draws in software, so the times are an upper bound for one with a graphics card.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.browser.chromium import ViewerPage, find_chromium, launch
from tests.support.synthetic import make_submap

pytestmark = pytest.mark.browser

NUM_SUBMAPS, NUM_POINTS = 30, 30_000
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
