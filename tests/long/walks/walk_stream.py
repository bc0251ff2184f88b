# ruff: noqa: T201 - tells where its pictures are
"""All pairs while they are compared, cancelled and resumed, to be looked at.

It prints a folder with the pictures. The dataset is the demo.
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


def test_the_matrix_fills_stays_and_resumes() -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    viewer = Viewer(load_dataset(demo_path()), PipelineParams(), port=0, source=str(demo_path()))
    folder = Path(tempfile.mkdtemp(prefix="walk-stream-"))
    print(folder)
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900))
            assert viewer.wait_idle()
            page.tab("All pairs")
            page.press("Run all pairs")
            page.wait(lambda: "still to come" in page.page.content(), "the first pairs")
            page.page.screenshot(path=str(folder / "1_filling.png"))
            page.press("Cancel")
            page.wait(lambda: "Resume (" in page.page.content(), "the run to stay")
            page.page.screenshot(path=str(folder / "2_cancelled.png"))
            page.page.get_by_text("Resume (").click()
            page.wait(lambda: "Run all pairs" in page.page.content(), "the whole", 120)
            page.wait(lambda: "still to come" not in page.page.content(), "the whole", 120)
            page.page.screenshot(path=str(folder / "3_whole.png"))
    finally:
        viewer.close()
