import pytest
import viser

from app.viewer.scene.placement import Canvas
from app.viewer.widgets.bridge import Bridge
from app.viewer.widgets.canvas import Canvases
from tests.support.page import FakePage
from tests.support.widgets import html_says

GOOD = {"width": 640, "height": 900.5, "left": 0, "top": 0.0, "right": 20, "bottom": 300}


@pytest.mark.parametrize(
    "bad",
    [
        {"width": 0},
        {"width": -5},
        {"height": float("nan")},
        {"height": float("inf")},
        {"width": "640"},
        {"width": True},
        {"width": None},
        {"width": 1e9},
        {"left": 640},
        {"bottom": 901},
        {"below": 601},
    ],
)
def test_a_canvas_is_what_a_page_says(server: viser.ViserServer, bad: dict[str, object]) -> None:
    bridge, page = Bridge(server), FakePage()
    canvases = Canvases(server, bridge)
    html_says(bridge, "canvas", page)
    html_says(bridge, "canvas", page, **{**GOOD, **bad})
    assert not canvases.knows(page)
    html_says(bridge, "canvas", page, **GOOD)
    assert canvases.of(page) == Canvas(640.0, 900.5, 0.0, 0.0, 20.0, 300.0)


def test_the_legend_keeps_its_room_when_the_panels_are_put_away(server: viser.ViserServer) -> None:
    bridge, page = Bridge(server), FakePage()
    canvases = Canvases(server, bridge)
    html_says(bridge, "canvas", page, **{**GOOD, "below": 90})
    assert canvases.of(page).bottom == 390.0
    page.camera.aspect = 2.0
    canvases.measure(page)  # type: ignore[arg-type]
    assert canvases.of(page) == Canvas(1801.0, 900.5, bottom=90.0)
