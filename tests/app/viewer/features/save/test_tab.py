from dataclasses import replace

import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.save.tab import SaveTab
from app.viewer.session.session_file import Opened, SavedSession, parse_session
from app.viewer.session.state import open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.page import FakePage
from tests.support.synthetic import make_dataset, needing
from tests.support.widgets import find, html_says, said, user_presses, user_sets

STATE = open_dataset(make_dataset(), PipelineParams(), source="/data/hills & <b>co</b>")


@pytest.fixture
def restored() -> list[SavedSession]:
    return []


@pytest.fixture(autouse=True)
def tab(desk: Desk, restored: list[SavedSession]) -> None:
    desk.join(SaveTab(desk, restored.append))


def test_the_command_follows_and_is_escaped(server: viser.ViserServer, desk: Desk) -> None:
    assert "--pair 003 000" in said(server, "command")
    assert "&lt;b&gt;co&lt;/b&gt;" in said(server, "command")
    assert "<b>co" not in said(server)
    desk.change(params=needing(7))
    assert "--closure.min-inliers 7" in said(server, "command")
    lone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    desk.open(Opened(lone, PipelineParams(), "/data/one"))
    assert "gpgrad detect" not in said(server)
    assert "not a pair" in said(server)


def test_a_session_goes_out_and_comes_back(
    server: viser.ViserServer, desk: Desk, restored: list[SavedSession]
) -> None:
    page = FakePage()
    desk.change(params=needing(7))
    user_presses(find(server, "Save session"), page)
    ((name, content),) = page.files.items()
    assert name == "hills.gpgrad.toml"
    assert parse_session(content.decode(), name).camera is not None

    def restore(content: bytes) -> None:
        user_sets(find(server, "Restore session"), viser.UploadedFile(name, content))

    restore(content)
    assert "hills.gpgrad.toml replaces the dataset" in said(server, "saving-message")
    html_says(desk.bridge, "restore", sure=False)
    assert "Nothing was changed." in said(server, "saving-message")
    html_says(desk.bridge, "restore", sure=True)
    assert restored == []  # it must be asked for anew
    restore(content)
    html_says(desk.bridge, "restore", sure=True)
    assert restored[0].params == needing(7)
    assert restored[0].camera is not None
    assert restored[0].camera.position == (1.0, -2.0, 3.5)
    for broken, words in (
        (b"\xff", "UTF-8"),
        (b"#" * 200_000, "larger than"),
        (b"x = 1", "unknown"),
    ):
        restore(broken)
        assert words in said(server, "saving-message")
    assert len(restored) == 1
