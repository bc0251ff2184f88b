from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import viser

from app.viewer.pair import tab as pair_module
from app.viewer.runner import Capacity
from app.viewer.session import Session
from app.viewer.session_file import Opened
from app.viewer.state import LAYERS
from app.viewer.widgets.commands import CAMERA_KEYS
from gpgrad_core.run.memo import Memo
from tests.app.synthetic import FakePipeline, make_dataset, needing
from tests.app.widgets import find


@pytest.fixture
def session(server: viser.ViserServer, monkeypatch: pytest.MonkeyPatch) -> Iterator[Session]:
    monkeypatch.setattr(pair_module, "register_pair", FakePipeline())
    made = Session(
        server, Opened(make_dataset(300), needing(8), "", None, needing(8)), Memo(), Capacity()
    )
    assert made.wait_idle(120)
    yield made
    made.close()


def press(
    server: viser.ViserServer, key: str, modifier: str | None = None, page: Any = None
) -> None:
    """Let a page press the key of a command."""
    (handle,) = [
        handle
        for handle in server.gui._command_handle_from_uuid.values()
        if (handle.hotkey, handle.modifier) == (key, modifier)
    ]
    event = viser.CommandEvent(
        client=page or MagicMock(spec=viser.ClientHandle), client_id=1, target=handle
    )
    for callback in handle._impl.trigger_cb:
        coroutine: Any = callback(event)
        with pytest.raises(StopIteration):
            coroutine.send(None)


def click(origin: Any, down: float) -> viser.SceneClickEvent:
    """A click whose line of sight goes straight up or down."""
    x, y, z = (float(value) for value in origin)
    page: Any = None
    return viser.SceneClickEvent(page, 1, (x, y, z), (0.0, 0.0, down), (0.5, 0.5), "shift")


def test_every_key_is_one_commands_and_none_flies_the_camera(
    server: viser.ViserServer,
    session: Session,  # noqa: ARG001
) -> None:
    keys = [
        (handle.hotkey, handle.modifier)
        for handle in server.gui._command_handle_from_uuid.values()
        if handle.hotkey is not None
    ]
    assert len(keys) == len(set(keys))
    assert not {key for key, modifier in keys if modifier is None} & CAMERA_KEYS


def test_keys_change_what_is_shown_and_the_widgets_follow(
    server: viser.ViserServer, session: Session
) -> None:
    for number, layer in enumerate(LAYERS, start=1):
        press(server, str(number))
        assert session.state.options.layer == layer
    assert find(server, "Layer").value == "agreement"
    press(server, "Z")
    assert find(server, "Layer").value == "elevation"
    press(server, "L")
    press(server, "L")
    assert session.state.options.layout == find(server, "Layout").value == "registered"
    press(server, "L")
    assert session.state.options.layout == "side by side"
    for key, compare in (("B", "blink"), ("V", "swipe"), ("Z", "both")):
        press(server, key)
        assert session.state.options.compare == compare
        assert session.state.options.layout == "registered"
    before = session.state.options.outlier_lines
    press(server, "O")
    assert session.state.options.outlier_lines is not before
    assert find(server, "Outlier lines").value is not before
    assert session.wait_idle(120)


def test_keys_step_through_matches_and_pairs(server: viser.ViserServer, session: Session) -> None:
    press(server, "N")
    assert session.wait_idle(120)
    press(server, "N")
    assert session.wait_idle(120)
    assert session.state.match == 2
    press(server, "P")
    assert session.wait_idle(120)
    assert session.state.match == 1
    press(server, "J")
    assert session.state.query_id != "003"
    assert session.state.match == 0  # it was an association of the other pair
    press(server, "J", "shift")
    assert session.state.query_id == find(server, "Query").value == "003"
    press(server, "M")
    assert session.state.database_id == "001"


def test_a_click_is_read_until_it_is_cleared(server: viser.ViserServer, session: Session) -> None:
    ground = session.pair.scene._ground
    assert ground is not None
    above = ground.placements[1].apply(np.array([[0.3, 0.4, 9.0]]))[0]
    session.inspect.clicked(click(above, -1.0))
    probe = session.state.probe
    assert probe is not None
    assert (probe.role, probe.x, probe.y) == ("database", pytest.approx(0.3), pytest.approx(0.4))
    assert session.wait_idle(120)
    session.inspect.clicked(click(above, 1.0))
    assert session.state.probe == probe
    press(server, "U")
    assert session.state.probe is None
    assert session.wait_idle(120)


def test_the_camera_moves_on_the_page_that_asks_only(
    server: viser.ViserServer, session: Session
) -> None:
    page = MagicMock(spec=viser.ClientHandle)
    page.camera, page._websock_connection = SimpleNamespace(), MagicMock()
    press(server, "T", page=page)
    x, y, z = np.array(page.camera.position) - page.camera.look_at
    assert z > 0
    assert np.hypot(x, y) < 0.01 * z
    press(server, "R", page=page)
    assert page.camera.position == session.pair.scene.camera(session.state).position
