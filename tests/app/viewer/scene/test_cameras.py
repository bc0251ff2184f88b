from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.features.demo.pages import Composed, save_page
from app.viewer.scene.cameras import (
    Animation,
    axes_on_screen,
    blend,
    ease,
    follow,
    frames,
    line_of_sight,
    orbit,
    place_on_screen,
    play,
    scale_bar,
    set_view,
    top,
)
from app.viewer.scene.placement import Canvas
from app.viewer.session.state import Camera
from app.viewer.web import viser_parts
from gpgrad_core.run import Cancelled
from tests.support.page import ProtocolPage

CANVAS = Canvas(640.0, 900.0)
OBLIQUE = Camera((3.0, -8.0, 12.0), (3.0, 0.0, 0.0))
VIEW = Camera((0.0, -8.0, 6.0), (0.0, 0.0, 0.0))


@given(share=st.floats(0.0, 1.0))
def test_a_flight_stays_above_ground_and_as_far_away(share: float) -> None:
    camera = blend(VIEW, top(VIEW), share)
    assert camera.distance == pytest.approx(10.0, rel=1e-3)
    assert camera.position[2] >= 6.0 - 1e-9


def test_flights_end_where_they_should() -> None:
    for share, end in ((0.0, VIEW), (1.0, top(VIEW))):
        np.testing.assert_allclose(blend(VIEW, top(VIEW), share).position, end.position, atol=1e-9)
    assert top(VIEW).position[2] == pytest.approx(10.0)  # as far away
    np.testing.assert_allclose(orbit(VIEW, 1.0).position, VIEW.position, atol=1e-9)
    np.testing.assert_allclose(orbit(VIEW, 0.5).position, (0.0, 8.0, 6.0), atol=1e-9)


def test_following_looks_along_the_way() -> None:
    path = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]])
    camera = follow(path, 0.25)
    assert camera.look_at == pytest.approx((5.0, 0.0, 0.0))
    assert camera.position[0] < 5.0
    assert camera.position[2] > 0
    assert follow(path, 1.0).look_at == pytest.approx((10.0, 10.0, 0.0))


def test_a_page_holds_title_legend_and_every_moment(tmp_path: Path) -> None:
    drawn: list[float] = []

    def compose(server: object) -> Composed:
        frame = server.scene.add_frame("/moves")  # type: ignore[attr-defined]

        def draw(share: float) -> None:
            drawn.append(share)
            frame.position = (share, 0.0, 0.0)

        moments = ((seconds, 0.0) for seconds in frames(Animation(0.5, draw)))
        return Composed(VIEW, "c &amp; d", legend="<b>metres</b>", pictures=moments)

    save_page(tmp_path / "page.html", compose, title="a <b>")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<title>a &lt;b&gt;</title>" in page
    assert "c &amp; d" in page
    assert "<b>metres</b>" in page
    assert "__VISER_EMBED_DATA__" in page
    hidden = f"{viser_parts()['VISER_PANEL']}, [data-testid=no-graphics-card]"
    assert f"{hidden} {{ display: none !important; }}" in page  # its playback, and a note
    assert page.index("'no graphics card'") < page.index("__VISER_EMBED_DATA__")
    assert drawn[0] == 0.0
    assert drawn[-1] == 1.0
    assert len(drawn) == 13


def test_late_reports_change_none(
    server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A report may come in the midst of being brought somewhere, and be true already."""
    page = ProtocolPage(f"http://127.0.0.1:{server.get_port()}")
    page.wait(lambda: len(server.get_clients()) == 1, "the page")
    (client,) = server.get_clients().values()
    moved: Any = viser.CameraHandle.position

    def move(camera: Any, position: Any) -> None:
        moved.fset(camera, position)
        camera._state.look_at = np.array(VIEW.look_at)

    monkeypatch.setattr(viser.CameraHandle, "position", moved.setter(move))
    client.camera.look_at = (1.0, 2.0, 3.0)
    set_view(client, VIEW)
    page.wait(lambda: page.look_at == list(VIEW.look_at), "the view")
    client.camera._state.position, page.looks_from = np.array(VIEW.position), None
    set_view(client, VIEW)
    page.wait(lambda: page.looks_from == list(VIEW.position), "the place, which it reported before")
    page.close()


def test_a_motion_ends_on_its_last_moment_and_rests_at_both_ends_in_a_page() -> None:
    drawn: list[float] = []
    play(Animation(0.1, drawn.append))
    assert drawn == sorted(drawn)
    assert drawn[-1] == 1.0
    drawn.clear()
    seconds = list(frames(Animation(1.0, drawn.append, rest=2.0)))
    assert (drawn[0], drawn[-1]) == (0.0, 1.0)
    assert seconds[0] == seconds[-1] == pytest.approx(2.0 + seconds[1])
    assert sum(seconds) == pytest.approx(5.0, abs=0.1)


def test_playing_can_be_stopped() -> None:
    def stop(fraction: float) -> None:  # noqa: ARG001
        raise Cancelled

    drawn: list[float] = []
    with pytest.raises(Cancelled):
        play(Animation(1.0, drawn.append), stop)
    assert drawn == []


@given(share=st.floats(0.0, 1.0))
def test_ease_is_as_slow_at_both_ends(share: float) -> None:
    assert 0.0 <= ease(share) <= 1.0
    assert ease(share) == pytest.approx(1.0 - ease(1.0 - share))


def test_the_scale_is_true_where_the_camera_looks() -> None:
    bar = scale_bar(OBLIQUE, CANVAS)
    ends = np.array([OBLIQUE.look_at, np.add(OBLIQUE.look_at, (bar.metres, 0.0, 0.0))])
    seen = place_on_screen(OBLIQUE, CANVAS, ends)
    np.testing.assert_allclose(seen[0], (320.0, 450.0), atol=1e-9)
    assert seen[1, 0] - seen[0, 0] == pytest.approx(bar.pixels)
    assert 0.3 * 106.7 < bar.pixels <= 106.7
    near = Camera((3.0, -0.8, 1.2), (3.0, 0.0, 0.0))
    assert scale_bar(near, CANVAS).metres < scale_bar(OBLIQUE, CANVAS).metres


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
