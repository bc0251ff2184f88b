"""A folder that is followed, in a real browser: what is written into it appears on the page."""

import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from app.viewer.session.following import Following
from app.viewer.viewer import Viewer
from gpgrad_core.live.sources import open_source
from gpgrad_core.simulation.demo import demo_path
from tests.browser.conftest import QUICK

if TYPE_CHECKING:
    from playwright.sync_api import Browser

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def write(folder: Path, number: int) -> None:
    """Do what a robot does that has finished a submap."""
    name = f"{number:03d}.ply"
    shutil.copy(demo_path() / "submaps" / name, folder / "submaps" / name)
    rows = (demo_path() / "poses_odom.txt").read_text().splitlines()
    (folder / "poses_odom.txt").write_text("\n".join(rows[: number + 2]) + "\n")


def test_submaps_that_are_written_one_by_one_appear(browser: "Browser", tmp_path: Path) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    from tests.browser.chromium import MapPage, changed  # noqa: PLC0415

    (tmp_path / "submaps").mkdir()
    following = Following(open_source(str(tmp_path)), QUICK, lambda _: None)
    viewer = Viewer(following.open, port=0)
    try:
        write(tmp_path, 0)
        page = MapPage(browser, viewer, pixel_ratio=0.5)
        strip, moment = (page.page.get_by_test_id(name) for name in ("timeline", "moment"))
        page.wait(lambda: moment.inner_text().startswith("000"), "its words")
        first = page.settle()
        for number in (1, 2):
            write(tmp_path, number)
            page.wait(lambda number=number: strip.get_attribute("data-at") == f"{number}", "it")
            page.wait(
                lambda number=number: moment.inner_text().startswith(f"00{number}"), "its words"
            )
        page.wait(lambda: changed(first, page.picture()) > 0.05, "their ground")
        page.press("Tune")  # which can choose any pair of all that came
        page.wait(lambda: len(viewer.sessions[0].state.dataset.submaps) == 3, "the third")
        page.close()
        assert page.errors == []
        assert page.outside == []
    finally:
        viewer.close()
        following.close()
    assert following.failure is None
