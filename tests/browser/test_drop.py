"""Folders and files that are dropped on the page from the system's own file manager."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gpgrad_core.io.folder import write_dataset
from tests.support.synthetic import make_dataset

pytestmark = [pytest.mark.browser, pytest.mark.slow]


def drag(page: Any, path: Path, *kinds: str) -> None:
    """Drag a file or a folder over the middle of the page, and perhaps drop it there."""
    session = page.context.new_cdp_session(page)
    data = {"items": [], "files": [str(path)], "dragOperationsMask": 1}
    for kind in kinds:
        session.send("Input.dispatchDragEvent", {"type": kind, "x": 480, "y": 200, "data": data})


def test_what_is_dropped_is_opened(open_viewer: Callable[..., Any], tmp_path: Path) -> None:
    viewer = open_viewer()
    page = viewer.page
    write_dataset(make_dataset(num_points=300, name="hills"), tmp_path / "hills")
    (tmp_path / "hills" / "film.mp4").write_bytes(b"film" * 1000)
    (tmp_path / "letter.doc").write_bytes(b"Dear")
    drag(page, tmp_path / "hills", "dragEnter", "dragOver")
    page.get_by_test_id("drop").wait_for(state="visible")
    drag(page, tmp_path / "hills", "drop")
    page.get_by_test_id("drop").wait_for(state="hidden")
    page.get_by_text("hills · 4 submaps").wait_for()
    assert viewer.viewer.wait_idle(60)  # else its picture takes the place of what is said next
    drag(page, tmp_path / "letter.doc", "dragEnter", "dragOver", "drop")
    page.get_by_test_id("status").filter(has_text="letter.doc: is neither").wait_for()
    drag(page, tmp_path / "hills" / "submaps" / "001.ply", "dragEnter", "dragOver", "drop")
    page.get_by_text("uploaded clouds · 1 submap").wait_for()
