from typing import Any

import numpy as np
import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.features.demo.pages import Composed, save_page
from app.viewer.scene.animation import Animation
from app.viewer.scene.cameras import blend, follow, orbit, set_view, top
from app.viewer.scene.placement import Extent, glide, place
from app.viewer.session.state import Camera
from gpgrad_core.se2 import SE2
from tests.support.page import ProtocolPage

VIEW = Camera((0.0, -8.0, 6.0), (0.0, 0.0, 0.0))
QUERY = Extent((-2.0, -1.0, 0.0), (4.0, 3.0, 1.0))
DATABASE = Extent((-3.0, -3.0, 2.0), (3.0, 3.0, 3.0))
MOTION = SE2(1.0, -2.0, 2.5)


def distance(camera: Camera) -> float:
    return float(np.linalg.norm(np.subtract(camera.position, camera.look_at)))


def test_the_top_view_is_as_far_away() -> None:
    assert distance(top(VIEW)) == pytest.approx(10.0, rel=1e-4)
    assert top(VIEW).position[2] == pytest.approx(10.0)


@given(share=st.floats(0.0, 1.0))
def test_a_flight_stays_above_ground_and_as_far_away(share: float) -> None:
    camera = blend(VIEW, top(VIEW), share)
    assert distance(camera) == pytest.approx(10.0, rel=1e-3)
    assert camera.position[2] >= 6.0 - 1e-9


def test_flights_end_where_they_should() -> None:
    for share, end in ((0.0, VIEW), (1.0, top(VIEW))):
        np.testing.assert_allclose(blend(VIEW, top(VIEW), share).position, end.position, atol=1e-9)
    np.testing.assert_allclose(orbit(VIEW, 1.0).position, VIEW.position, atol=1e-9)
    np.testing.assert_allclose(orbit(VIEW, 0.5).position, (0.0, 8.0, 6.0), atol=1e-9)


def test_following_looks_along_the_way() -> None:
    path = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0]])
    camera = follow(path, 0.25)
    assert camera.look_at == pytest.approx((5.0, 0.0, 0.0))
    assert camera.position[0] < 5.0
    assert camera.position[2] > 0
    assert follow(path, 1.0).look_at == pytest.approx((10.0, 10.0, 0.0))


def test_a_submap_glides_from_its_place_to_its_place() -> None:
    for share, layout in ((0.0, "side by side"), (1.0, "registered")):
        placed = place(QUERY, DATABASE, layout, MOTION, 0.3)  # type: ignore[arg-type]
        for made, wanted in zip(glide(QUERY, DATABASE, MOTION, 0.3, share), placed, strict=True):
            np.testing.assert_allclose(made.position, wanted.position, atol=1e-9)
            assert made.yaw == pytest.approx(wanted.yaw)
    start, half, end = (
        glide(QUERY, DATABASE, MOTION, 0.3, share)[0].apply(QUERY.center[None])[0]
        for share in (0.0, 0.5, 1.0)
    )
    np.testing.assert_allclose(half[:2], (start + end)[:2] / 2, atol=1e-9)
    assert half[2] > (start + end)[2] / 2 + 0.5  # over the ground


def test_a_page_holds_title_legend_and_every_moment() -> None:
    drawn: list[float] = []

    def compose(server: object) -> Composed:
        frame = server.scene.add_frame("/moves")  # type: ignore[attr-defined]

        def draw(share: float) -> None:
            drawn.append(share)
            frame.position = (share, 0.0, 0.0)

        return Composed(VIEW, "<b>metres</b>", Animation(0.5, draw))

    page = save_page(compose, title="a <b>", caption="c & d", dark=True).decode()
    assert "<title>a &lt;b&gt;</title>" in page
    assert "c &amp; d" in page
    assert "<b>metres</b>" in page
    assert "__VISER_EMBED_DATA__" in page
    assert drawn[0] == 0.0
    assert drawn[-1] == 1.0
    assert len(drawn) == 13


def test_a_page_that_reports_late_looks_where_it_was_brought(
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
    page.close()
