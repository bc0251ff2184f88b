import pytest
import viser

from app.viewer.save.session_file import Saved, parse_saved
from app.viewer.save.tab import Saving
from app.viewer.state import open_dataset, with_pair, with_params
from gpgrad_core.pipeline import PipelineParams
from tests.app.page import FakePage
from tests.app.synthetic import make_dataset, needing
from tests.app.widgets import find

STATE = open_dataset(make_dataset(), PipelineParams(), source="/data/hills & <b>co</b>")


@pytest.fixture
def restored() -> list[Saved]:
    return []


@pytest.fixture
def saving(server: viser.ViserServer, restored: list[Saved]) -> Saving:
    return Saving(server, STATE, on_restore=restored.append)


def said(saving: Saving) -> str:
    return saving._panel._command.content + saving._panel._message.content


def test_the_command_follows_the_session_and_is_escaped(saving: Saving) -> None:
    assert "--pair 003 000" in said(saving)
    assert "&lt;b&gt;co&lt;/b&gt;" in said(saving)
    assert "<b>co" not in said(saving)
    saving.follow(with_params(STATE, needing(7)))
    assert "--closure.min-inliers 7" in said(saving)
    saving.follow(with_pair(STATE, query_id="000"))
    assert "gpgrad detect" not in said(saving)
    assert "no pair" in said(saving)


def test_a_session_goes_out_and_comes_back(
    saving: Saving, server: viser.ViserServer, restored: list[Saved]
) -> None:
    client = FakePage()
    saving.follow(with_params(STATE, needing(7)))
    saving._save(client)
    ((name, content),) = client.files.items()
    assert name == "hills.gpgrad.toml"
    assert parse_saved(content.decode(), name).camera is not None
    saving._restore(name, content, client)
    assert restored[0].params == needing(7)
    assert restored[0].camera is not None
    assert restored[0].camera.position == (1.0, -2.0, 3.5)
    for broken, words in ((b"\xff", "utf-8"), (b"#" * 200_000, "too large"), (b"x = 1", "unknown")):
        saving._restore(name, broken, client)
        assert words in said(saving)
    assert len(restored) == 1
    assert find(server, "Save session").visible
