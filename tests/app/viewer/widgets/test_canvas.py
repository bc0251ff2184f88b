import pytest

from app.viewer.draw.placement import Canvas
from app.viewer.widgets.canvas import read_canvas

GOOD = {"width": 640, "height": 900.5, "left": 0, "top": 0.0, "right": 20, "bottom": 300}


def test_a_canvas_is_read() -> None:
    assert read_canvas(GOOD) == Canvas(640.0, 900.5, 0.0, 0.0, 20.0, 300.0)


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
    ],
)
def test_what_can_be_no_canvas_is_none(bad: dict[str, object]) -> None:
    assert read_canvas({**GOOD, **bad}) is None  # type: ignore[arg-type]
    assert read_canvas({}) is None
