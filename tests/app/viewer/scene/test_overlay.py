import numpy as np
import pytest

from app.viewer.scene.overlay import (
    axes_on_screen,
    length_text,
    line_of_sight,
    place_on_screen,
    scale_bar,
)
from app.viewer.scene.placement import Canvas
from app.viewer.session.state import Camera

CANVAS = Canvas(640.0, 900.0)
OBLIQUE = Camera((3.0, -8.0, 12.0), (3.0, 0.0, 0.0))


def test_the_scale_is_true_where_the_camera_looks() -> None:
    bar = scale_bar(OBLIQUE, CANVAS)
    ends = np.array([OBLIQUE.look_at, np.add(OBLIQUE.look_at, (bar.metres, 0.0, 0.0))])
    seen = place_on_screen(OBLIQUE, CANVAS, ends)
    np.testing.assert_allclose(seen[0], (320.0, 450.0), atol=1e-9)
    assert seen[1, 0] - seen[0, 0] == pytest.approx(bar.pixels)
    assert 0.3 * 160.0 < bar.pixels <= 160.0


def test_nearer_the_bar_means_less() -> None:
    near = Camera((3.0, -0.8, 1.2), (3.0, 0.0, 0.0))
    assert scale_bar(near, CANVAS).metres < scale_bar(OBLIQUE, CANVAS).metres


def test_lengths_have_units_that_suit_them() -> None:
    assert [length_text(length) for length in (0.02, 0.2, 5.0, 1000.0)] == [
        "2 cm",
        "0.2 m",
        "5 m",
        "1 km",
    ]


def test_the_axes_point_where_they_are_seen() -> None:
    above = Camera((0.0, -0.01, 10.0), (0.0, 0.0, 0.0))
    np.testing.assert_allclose(axes_on_screen(above), [(1.0, 0.0), (0.0, -1.0)], atol=1e-5)
    from_east = Camera((10.0, 0.0, 10.0), (0.0, 0.0, 0.0))
    x, y = axes_on_screen(from_east)
    np.testing.assert_allclose(x, (0.0, np.sqrt(0.5)), atol=1e-9)  # towards the eye: down
    np.testing.assert_allclose(y, (1.0, 0.0), atol=1e-9)


def test_a_pixel_looks_at_what_is_seen_there() -> None:
    point = np.array([[4.0, 1.5, 0.3]])
    x, y = place_on_screen(OBLIQUE, CANVAS, point)[0]
    eye, toward = line_of_sight(OBLIQUE, CANVAS, x, y)
    offset = point[0] - eye
    np.testing.assert_allclose(
        toward / np.linalg.norm(toward), offset / np.linalg.norm(offset), atol=1e-9
    )
    behind = place_on_screen(OBLIQUE, CANVAS, np.array([[3.0, -80.0, 12.0]]))
    assert np.isnan(behind).all()
