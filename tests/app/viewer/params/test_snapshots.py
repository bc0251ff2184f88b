from dataclasses import replace

import pytest
import viser

from app.viewer.params.snapshots import SnapshotsTool, differences
from app.viewer.state import open_dataset, with_params
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams
from tests.app.desk import make_desk
from tests.app.synthetic import NUMBERS, make_dataset, needing

STATE = open_dataset(make_dataset(), NUMBERS)


@pytest.fixture
def tool(server: viser.ViserServer) -> SnapshotsTool:
    desk = make_desk(server, STATE)
    return desk.join(SnapshotsTool(desk, Commands(server)))


def test_one_key_changes_between_a_and_b(tool: SnapshotsTool) -> None:
    desk = tool._desk
    assert tool._note.content == ""
    tool.keep("A")
    assert "A shown. Change something, and keep it as B." in tool._note.content
    desk.change(params=needing(7))
    assert "Neither is shown." in tool._note.content
    tool.keep("B")
    assert "B shown. min inliers " in tool._note.content
    tool.switch()
    assert desk.state.asked == STATE.params
    assert "A shown." in tool._note.content
    tool.switch()
    assert desk.state.asked == needing(7)
    desk.change(params=needing(9))
    tool.switch()
    assert desk.state.asked == STATE.params


def test_without_the_other_nothing_happens(tool: SnapshotsTool) -> None:
    tool.switch()
    tool.keep("A")
    tool.switch()
    assert tool._desk.state.asked == STATE.params


def test_another_dataset_has_none(tool: SnapshotsTool) -> None:
    tool.keep("A")
    tool.follow(open_dataset(make_dataset(name="others"), PipelineParams()))
    assert tool._note.content == ""


def test_differences_are_told_with_their_units() -> None:
    params = PipelineParams()
    assert differences(params, params) == "A and B are the same."
    other = replace(params, map=replace(params.map, length_scale=0.4, noise_std=0.02))
    assert differences(params, other) == (
        "length scale [m] automatic → 0.4, noise std [m] automatic → 0.02."
    )
    many = replace(
        other,
        closure=replace(other.closure, min_score=2.0, min_inliers=3),
        registration=replace(other.registration, inlier_radius=0.3),
    )
    assert differences(params, many).endswith(", and 2 more.")
    assert with_params(STATE, many).params == many
