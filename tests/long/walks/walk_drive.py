# ruff: noqa: T201 - tells where its pictures are
"""The drive of the demo, played, with a picture at five times, to be looked at.

It prints a folder with the pictures. Would a stranger see the map grow, the track drift, and the
loop close?
"""

import tempfile
from pathlib import Path

import pytest

from app.viewer.viewer import Viewer
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.simulation.demo import demo_path
from tests.browser.chromium import ViewerPage, find_chromium, launch

pytestmark = pytest.mark.browser
TIMES = (1, 4, 5, 7, 9)


def test_the_drive() -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), PipelineParams(), port=0, source=str(demo_path()))
    folder = Path(tempfile.mkdtemp(prefix="walk-drive-"))
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900))
            page.press("Explore")
            strip = page.page.get_by_test_id("timeline")
            strip.get_by_label("Play").click()
            for time in TIMES:
                page.wait(lambda time=time: int(strip.get_attribute("data-at") or -1) >= time, "it")
                page.page.wait_for_timeout(500)
                page.page.screenshot(path=folder / f"{time:03d}.png")
                print(time, page.page.get_by_test_id("moment").inner_text())
            assert page.errors == []
            page.close()
    finally:
        viewer.close()
    print(folder)
