from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import cv2
import numpy as np
import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.save import tab as save_module
from app.viewer.features.save.figures import Sheet, Written, crop, draw_picture, pixels_of
from app.viewer.features.save.tab import CLOSURES, MAPS, Exports
from app.viewer.scene.cameras import ScaleBar
from app.viewer.scene.layers import Scale
from app.viewer.session.session_file import Opened
from app.viewer.session.state import ViewState, open_dataset
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.run import Progress
from gpgrad_core.types import Dataset
from tests.support.desk import rests
from tests.support.page import FakePage
from tests.support.synthetic import make_compared, make_dataset, make_map
from tests.support.widgets import find, said, user_presses, user_sets

Order: TypeAlias = Callable[..., FakePage]
STATE = open_dataset(make_dataset(), PipelineParams())


@pytest.fixture
def exports(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> Exports:
    def detect(state: ViewState, _progress: Progress) -> DetectionResult:
        _ = state.pair
        pairs = make_compared().table
        return pairs.result(pairs.judge(replace(state.given.closure, others="off")))

    monkeypatch.setattr(
        save_module,
        "infer_map",
        lambda submap, params, memo, progress: make_map(submap),  # noqa: ARG005
    )
    return Exports(desk, lambda state: partial(detect, state))


@pytest.fixture
def order(server: viser.ViserServer, exports: Exports) -> Order:
    """Choose from lists and press a button, as a page does; gives the page with its file."""

    def press(button: str, page: FakePage | None = None, **choices: str) -> FakePage:
        page = page or FakePage()
        for label, choice in choices.items():
            user_sets(find(server, label.replace("_", " ")), choice)
        user_presses(find(server, f"Export {button}"), page)
        assert rests(exports)
        return page

    return press


def test_closures_in_every_format(server: viser.ViserServer, order: Order) -> None:
    page = FakePage()
    for kind in CLOSURES:
        order("closures", page, Closures_as=kind)
        assert CLOSURES[kind] in said(server, "export-message")
    assert set(page.files) == set(CLOSURES.values())
    assert b'"num_inliers": 16' in page.files["closures.json"]
    rows = page.files["closures.csv"].decode().splitlines()
    assert rows[0].startswith("query,database,accepted,score,num_inliers")
    assert len(rows) == 7
    assert rows[4].startswith("003,000,true,5,20,10,0.5,1,-0.5,1.57079633,")
    poses = page.files["poses_corrected.txt"].decode().splitlines()
    assert [row.split()[0] for row in poses] == ["#", "0", "1", "2", "3"]
    assert page.files["graph.g2o"].startswith(b"VERTEX_SE3:QUAT 0 ")


def test_maps_in_every_format(order: Order) -> None:
    page = FakePage()
    for kind in MAPS:
        order("map", page, Map_as=kind)
    order("map", page, Map_as="NPZ", Map_of="database")
    starts = {name: content[:4] for name, content in page.files.items()}
    assert starts == {
        "map_003.npz": b"PK\x03\x04",
        "map_003.tif": b"II*\x00",
        "map_003.ply": b"ply\n",
        "map_003.png": b"\x89PNG",
        "map_000.npz": b"PK\x03\x04",
    }


def page_of(width: int, height: int) -> FakePage:
    page = FakePage()
    page.camera.image_width, page.camera.image_height = width, height
    return page


@pytest.mark.parametrize("dark", [False, True])
def test_a_picture_is_fit_for_a_slide(
    desk: Desk, order: Order, dark: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(desk.canvases, "is_dark", lambda _page: dark)
    desk.canvases.caption = {"title": "Query 003 → database 000", "line": "Loop closure"}
    desk.canvases.scales["pair"] = Scale("Elevation", "m", "viridis", -1.0, 2.0)
    page = order("picture", page_of(450, 338))
    png = np.frombuffer(page.files["view.png"], np.uint8)
    picture = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert max(picture.shape) >= 2 * 450
    assert picture.shape[2] == 3 or (picture[..., 3] == 255).all()
    rows, columns = picture.shape[:2]
    blue, green, red = (int(value) for value in picture[rows // 2, columns // 3, :3])
    assert (blue, green, red) == (0, 0, 255)  # what the page draws
    corner = int(picture[0, -1, 0])
    assert corner < 40 if dark else corner == 255
    view = (picture[..., :3] == (0, 0, 255)).all(axis=2)
    assert view.sum() >= 0.9 * 4 * 450 * 338
    top, left = (int(np.flatnonzero(view.any(axis=axis))[0]) for axis in (1, 0))
    bottom, right = (int(np.flatnonzero(view.any(axis=axis))[-1]) for axis in (1, 0))
    below = picture[bottom + 1 :]
    for strip in (below[:, : columns // 2], below[:, columns // 2 :]):
        assert np.ptp(strip[..., 0]) > 150  # title; scale bar and colour bar
    for rim in (picture[:top], picture[:bottom, :left], picture[:bottom, right + 1 :]):
        assert np.ptp(rim[..., 0]) == 0


@pytest.mark.parametrize("pixels", [1600, 3200])
def test_a_picture_is_cropped_and_its_words_grow_with_it(pixels: int) -> None:
    view = np.full((pixels, 2 * pixels, 3), 255, np.uint8)
    view[pixels // 4 : pixels // 2, pixels // 2 : pixels] = (255, 0, 0)
    small = crop(view, (255, 255, 255))
    assert small.shape == (pixels // 4, pixels // 2, 3)
    written = Written("Title", "line", ScaleBar(pixels / 20, 1.0), None, dark=False)
    sheet = Sheet.around(small.shape[1], small.shape[0])
    drawn = pixels_of(draw_picture(small, written, sheet))
    assert drawn.shape[:2] == (sheet.height, sheet.width)
    red = (drawn == (255, 0, 0)).all(axis=2)
    assert red.sum() > 0.95 * pixels**2 / 8
    assert red.sum() > 0.5 * red.size  # and not mostly margin
    inked = (drawn.max(axis=2) < 100)[np.flatnonzero(red.any(axis=1))[-1] + 1 :]
    height = np.ptp(np.flatnonzero(inked[:, : sheet.width // 3].any(axis=1))) / sheet.height
    assert height == pytest.approx(0.10, abs=0.05)


def size_of(page: FakePage) -> tuple[int, int]:
    picture = cv2.imdecode(np.frombuffer(page.files["view.png"], np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return picture.shape[1], picture.shape[0]


def test_a_picture_may_be_twice_as_fine(order: Order) -> None:
    small = size_of(order("picture", page_of(400, 300), Picture_size="2 times"))
    fine = size_of(order("picture", page_of(400, 300), Picture_size="4 times"))
    assert fine == pytest.approx((2 * small[0], 2 * small[1]), abs=1)


def test_a_picture_that_no_page_draws_is_refused(server: viser.ViserServer, order: Order) -> None:
    assert order("picture", page_of(2100, 900), Picture_size="4 times").files == {}
    assert "8,400 x 3,600 pixels, more than 8,192" in said(server, "export-error")


@pytest.mark.parametrize("kind", ["SVG", "PDF"])
def test_a_picture_of_lines(desk: Desk, order: Order, kind: str) -> None:
    desk.canvases.scales["pair"] = Scale("Elevation", "m", "viridis", -1.0, 2.0)
    page = order("picture", page_of(400, 300), Picture_as=kind)
    content = page.files[f"view.{kind.lower()}"]
    assert content.startswith(b"%PDF" if kind == "PDF" else b"<?xml")
    # The view is as many pixels as were asked for; all round it is drawn, not painted.
    assert b"/Width 800" in content if kind == "PDF" else b'width="800" height="600"' in content


def test_the_ground_and_title_of_one_are_chosen(server: viser.ViserServer, order: Order) -> None:
    page = order("picture", page_of(400, 300), Picture_ground="light")
    light = page.files["view.png"]
    picture = cv2.imdecode(np.frombuffer(light, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture[0, -1].min() == 255
    user_sets(find(server, "Picture title"), "Another title")
    assert order("picture", page_of(400, 300), Picture_ground="light").files["view.png"] != light


def test_a_page_that_gives_no_picture_is_told_of(server: viser.ViserServer, order: Order) -> None:
    assert order("picture", FakePage(draws=False)).files == {}
    assert "bring its window to the front" in said(server, "export-error")


def test_what_cannot_be_saved_is_told(server: viser.ViserServer, desk: Desk, order: Order) -> None:
    desk.open(Opened(Dataset("one", STATE.dataset.submaps[:1]), PipelineParams(), ""))
    assert order("closures").files == {}
    assert "needs two submaps" in said(server, "export-error")
