import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import viser

from app.viewer.features.data.locating import LocateTool, lit
from app.viewer.features.desk import Desk
from app.viewer.server.limits import Permissions
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset
from tests.core.locating.test_locate import CELL, CORNER, model, submap
from tests.support.desk import Recorder, make_desk, rests, uses
from tests.support.page import FakePage
from tests.support.widgets import find, user_presses, user_sets

SUBMAPS = (submap(12.0, 20.0, 0.4, "query_1"), submap(30.0, 22.0, 2.0, "query_2"))
STATE = open_dataset(Dataset("drive", SUBMAPS), PipelineParams())
Make = Callable[..., LocateTool]


def write_model(path: Path) -> Path:
    """Write the model as a GeoTIFF of UTM zone 33."""
    heights = model().heights[::-1].astype(np.float32)
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 32633)
    north = CORNER[1] + heights.shape[0] * CELL
    extra: list[Any] = [
        (33550, "d", 3, (CELL, CELL, 0.0), True),
        (33922, "d", 6, (0.0, 0.0, 0.0, CORNER[0], north, 0.0), True),
        (34735, "H", len(keys), keys, True),
    ]
    tifffile.imwrite(path, heights, extratags=extra)
    return path


@pytest.fixture
def make(server: viser.ViserServer, tmp_path: Path, recorder: Recorder) -> Iterator[Make]:
    desks: list[Desk] = []

    def start(**places: Any) -> LocateTool:
        (tmp_path / "uploads").mkdir()
        desk = make_desk(
            server, STATE, recorder, replace(Permissions(uploads=tmp_path / "uploads"), **places)
        )
        desks.append(desk)
        return desk.join(LocateTool(desk))

    yield start
    for desk in desks:
        desk.close()
    assert list((tmp_path / "uploads").iterdir()) == []


@pytest.mark.slow
def test_submaps_are_found_listed_and_opened_on_the_model(
    make: Make, server: viser.ViserServer, tmp_path: Path, recorder: Recorder
) -> None:
    tool = make(root=tmp_path)
    user_sets(find(server, "Model"), str(write_model(tmp_path / "dem.tif")))
    uses(tool, "Locate")
    assert "2 of 2 found on dem.tif, to 0.0" in tool.result.content
    east = CORNER[0] + SE2(12.0, 20.0, 0.4).apply(SUBMAPS[0].centre[None, :2])[0, 0]
    assert re.search(rf"\b{east:.0f}\.\d", tool.result.content)  # where it lies, not its frame
    assert tool.result.content.count("<circle") == 2
    page = FakePage()
    user_presses(find(server, "Save located.json"), page)
    assert rests(tool)
    assert b'"num_windows"' in page.files["drive-located.json"]
    user_presses(find(server, "Open on the model"))
    opened = recorder.datasets[-1].dataset
    assert [one.id for one in opened.submaps] == ["query_1", "query_2", "map_003"]
    assert tool.result.content == ""


def test_what_is_no_model_is_told(make: Make, server: viser.ViserServer, tmp_path: Path) -> None:
    (tmp_path / "root").mkdir()
    write_model(tmp_path / "dem.tif")
    tool = make(root=tmp_path / "root")
    user_presses(find(server, "Locate"))
    assert "Type the path of a GeoTIFF first" in tool.bar.said
    user_sets(find(server, "Model"), str(tmp_path / "dem.tif"))
    uses(tool, "Locate")
    assert "may open nothing else" in tool.bar.said
    file: Any = viser.UploadedFile("../dem.tif", b"II*\0")
    uses(tool, "Upload a GeoTIFF", file)
    assert "outside of its folder" in tool.bar.said
    file = viser.UploadedFile("dem.tif", b"II*\0")
    uses(tool, "Upload a GeoTIFF", file)
    assert ">dem.tif: " in tool.bar.said
    assert str(tmp_path) not in tool.bar.said


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (700, 3)])
def test_any_model_has_a_picture(shape: tuple[int, int]) -> None:
    heights = np.arange(np.prod(shape), dtype=float).reshape(shape)
    heights[0, 0] = np.nan
    pixels = lit(Elevations(heights, (1.0, 1.0)), 2)
    assert pixels.shape == (-(-shape[0] // 2), -(-shape[1] // 2), 4)
    assert pixels[-1, 0, 3] == 0
