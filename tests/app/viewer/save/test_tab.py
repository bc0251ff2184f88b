from dataclasses import replace

import pytest
import viser

from app.viewer.save.tab import SaveTab
from app.viewer.session_file import SavedSession, parse_session
from app.viewer.state import open_dataset
from gpgrad_core.pipeline import PipelineParams
from tests.app.desk import make_desk
from tests.app.page import FakePage
from tests.app.synthetic import make_dataset, needing
from tests.app.widgets import find, html_says

STATE = open_dataset(make_dataset(), PipelineParams(), source="/data/hills & <b>co</b>")


@pytest.fixture
def restored() -> list[SavedSession]:
    return []


@pytest.fixture
def saving(server: viser.ViserServer, restored: list[SavedSession]) -> SaveTab:
    desk = make_desk(server, STATE)
    return desk.join(SaveTab(desk, restored.append))


def said(saving: SaveTab) -> str:
    return saving._panel._command.content + saving._panel._message.content


def test_the_command_follows_the_session_and_is_escaped(saving: SaveTab) -> None:
    assert "--pair 003 000" in said(saving)
    assert "&lt;b&gt;co&lt;/b&gt;" in said(saving)
    assert "<b>co" not in said(saving)
    saving._desk.change(params=needing(7))
    assert "--closure.min-inliers 7" in said(saving)
    lone = replace(STATE.dataset, submaps=STATE.dataset.submaps[:1])
    saving.follow(open_dataset(lone, PipelineParams(), source="/data/one"))
    assert "gpgrad detect" not in said(saving)
    assert "not a pair" in said(saving)


def test_a_session_goes_out_and_comes_back(
    saving: SaveTab, server: viser.ViserServer, restored: list[SavedSession]
) -> None:
    client = FakePage()
    saving._desk.change(params=needing(7))
    saving._save(client)
    ((name, content),) = client.files.items()
    assert name == "hills.gpgrad.toml"
    assert parse_session(content.decode(), name).camera is not None
    saving._restore(name, content)
    assert "hills.gpgrad.toml replaces the dataset" in said(saving)
    html_says(saving._desk.bridge, "restore", sure=False)
    assert "Nothing was changed." in said(saving)
    html_says(saving._desk.bridge, "restore", sure=True)
    assert restored == []  # it must be asked for anew
    saving._restore(name, content)
    html_says(saving._desk.bridge, "restore", sure=True)
    assert restored[0].params == needing(7)
    assert restored[0].camera is not None
    assert restored[0].camera.position == (1.0, -2.0, 3.5)
    for broken, words in (
        (b"\xff", "UTF-8"),
        (b"#" * 200_000, "larger than"),
        (b"x = 1", "unknown"),
    ):
        saving._restore(name, broken)
        assert words in said(saving)
    assert len(restored) == 1
    assert find(server, "Save session").visible
