import numpy as np
import viser

from app.viewer.features.session import Session
from app.viewer.session.layers import LAYERS
from app.viewer.session.session_file import Opened
from tests.support.page import FakePage
from tests.support.synthetic import make_dataset, needing
from tests.support.widgets import find, press_key

OPENED = Opened(make_dataset(300), needing(8), "", None, needing(8))


def test_keys_change_the_view_and_widgets_follow(gui: viser.ViserServer, session: Session) -> None:
    for number, layer in enumerate(LAYERS, start=1):
        press_key(gui, str(number))
        assert session.state.options.layer == layer
    assert find(gui, "Layer").value == "agreement"
    press_key(gui, "Z")
    assert find(gui, "Layer").value == "gradient"
    press_key(gui, "L")
    press_key(gui, "L")
    assert session.state.options.layout == find(gui, "Layout").value == "registered"
    press_key(gui, "L")
    assert session.state.options.layout == "side by side"
    for key, compare in (("B", "blink"), ("V", "swipe"), ("Z", "both")):
        press_key(gui, key)
        assert session.state.options.compare == compare
        assert session.state.options.layout == "registered"
    before = session.state.options.outlier_lines
    press_key(gui, "O")
    assert session.state.options.outlier_lines is not before
    assert session.wait_idle(120)  # a worker may tell of it
    assert find(gui, "Outlier lines").value is not before


def test_keys_step_through_matches_and_pairs(gui: viser.ViserServer, session: Session) -> None:
    press_key(gui, "N")
    assert session.wait_idle(120)
    press_key(gui, "N")
    assert session.wait_idle(120)
    assert session.state.match == 2
    press_key(gui, "P")
    assert session.wait_idle(120)
    assert session.state.match == 1
    press_key(gui, "J")
    assert session.state.query_id != "003"
    assert session.state.match == 0  # it was an association of the other pair
    press_key(gui, "J", "shift")
    assert session.state.query_id == "003"
    press_key(gui, "M")
    assert session.state.database_id == "001"


def test_only_the_camera_of_the_page_moves(gui: viser.ViserServer, session: Session) -> None:
    page = FakePage()
    press_key(gui, "T", page=page)
    x, y, z = np.array(page.camera.position) - page.camera.look_at
    assert z > 0
    assert np.hypot(x, y) < 0.01 * z
    press_key(gui, "R", page=page)
    assert tuple(page.camera.position) == session.pair.scene.camera(session.state).position
