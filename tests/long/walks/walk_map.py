# ruff: noqa: T201 - tells where its pictures are
"""Explore as a map: before and after the pose graph, dark and light, to be looked at.

It prints a folder with the pictures, at 1440x900, of the demo and of two of the shared sets.
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


@pytest.mark.parametrize("name", ["demo", "marsyard2021", "sthelens"])
def test_the_map(name: str, request: pytest.FixtureRequest) -> None:
    executable = find_chromium()
    if executable is None:
        pytest.skip("no Chromium was found")
    path = demo_path() if name == "demo" else request.getfixturevalue("real_data") / name
    viewer = Viewer(load_dataset(path), PipelineParams(), port=0, source=str(path))
    folder = Path(tempfile.mkdtemp(prefix=f"walk-map-{name}-"))
    try:
        with launch(executable) as browser:
            page = ViewerPage(browser, viewer.url, size=(1440, 900))
            session = viewer.sessions[0]

            def take(title: str) -> None:
                assert session.wait_idle(300)
                page.page.wait_for_timeout(2500)
                page.page.screenshot(path=str(folder / f"{title}.png"))

            page.page.evaluate("gpgradTheme.choose('light')")
            page.press("Explore")
            take("0_opened")
            page.page.get_by_role("tab", name="Pose graph").click()
            page.press("Find closures")
            take("1_closures")
            page.press("Optimise")
            take("2_after_light")
            page.page.evaluate("gpgradTheme.choose('dark')")
            take("3_after_dark")
            print(f"\n{folder}")
            assert page.errors == []
    finally:
        viewer.close()
