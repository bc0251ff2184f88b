from collections.abc import Callable

import numpy as np
import pytest
import viser

from app.viewer.features.session import Session
from app.viewer.session.state import LAYERS
from tests.support.page import FakePage
from tests.support.synthetic import FakePipeline, make_dataset, needing
from tests.support.widgets import find, press_key


@pytest.fixture
def session(
    open_session: Callable[..., Session],
    pipeline: FakePipeline,  # noqa: ARG001
) -> Session:
    made = open_session(make_dataset(300), needing(8))
    assert made.wait_idle(120)
    return made


def test_keys_change_what_is_shown_and_the_widgets_follow(
    server: viser.ViserServer, session: Session
) -> None:
    for number, layer in enumerate(LAYERS, start=1):
        press_key(server, str(number))
        assert session.state.options.layer == layer
    assert find(server, "Layer").value == "agreement"
    press_key(server, "Z")
    assert find(server, "Layer").value == "gradient"
    press_key(server, "L")
    press_key(server, "L")
    assert session.state.options.layout == find(server, "Layout").value == "registered"
    press_key(server, "L")
    assert session.state.options.layout == "side by side"
    for key, compare in (("B", "blink"), ("V", "swipe"), ("Z", "both")):
        press_key(server, key)
        assert session.state.options.compare == compare
        assert session.state.options.layout == "registered"
    before = session.state.options.outlier_lines
    press_key(server, "O")
    assert session.state.options.outlier_lines is not before
    assert find(server, "Outlier lines").value is not before
    assert session.wait_idle(120)


def test_keys_step_through_matches_and_pairs(server: viser.ViserServer, session: Session) -> None:
    press_key(server, "N")
    assert session.wait_idle(120)
    press_key(server, "N")
    assert session.wait_idle(120)
    assert session.state.match == 2
    press_key(server, "P")
    assert session.wait_idle(120)
    assert session.state.match == 1
    press_key(server, "J")
    assert session.state.query_id != "003"
    assert session.state.match == 0  # it was an association of the other pair
    press_key(server, "J", "shift")
    assert session.state.query_id == "003"
    press_key(server, "M")
    assert session.state.database_id == "001"


def test_the_camera_moves_on_the_page_that_asks_only(
    server: viser.ViserServer, session: Session
) -> None:
    page = FakePage()
    press_key(server, "T", page=page)
    x, y, z = np.array(page.camera.position) - page.camera.look_at
    assert z > 0
    assert np.hypot(x, y) < 0.01 * z
    press_key(server, "R", page=page)
    assert tuple(page.camera.position) == session.pair.scene.camera(session.state).position
