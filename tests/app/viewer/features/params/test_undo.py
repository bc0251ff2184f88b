from dataclasses import replace

import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from app.viewer.features.desk import Desk
from app.viewer.features.params.undo import LONGEST, History, SnapshotsTool, UndoTool, differences
from app.viewer.session.session_file import Opened
from app.viewer.session.state import open_dataset, with_params
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PipelineParams
from tests.support.desk import go_to
from tests.support.synthetic import NUMBERS, make_dataset, needing
from tests.support.widgets import find, user_presses

values = st.lists(st.integers(0, 3), max_size=30)


@given(values=values)
def test_undoing_all_and_redoing_all_comes_back(values: list[int]) -> None:
    history = History(0)
    for value in values:
        history = history.push(value)
    end, steps = history, len(history.past)
    for _ in range(steps):
        history = history.undo()
    assert history.present == 0
    assert history.undo() is history
    for _ in range(steps):
        history = history.redo()
    assert history == end
    assert history.redo() is history


def test_the_oldest_are_forgotten() -> None:
    history = History(0)
    for value in range(1, LONGEST + 50):
        history = history.push(value)
    assert len(history.past) == LONGEST


STATE = open_dataset(make_dataset(), NUMBERS)


@pytest.fixture(autouse=True)
def undo(desk: Desk, server: viser.ViserServer) -> None:
    desk.join(UndoTool(desk, Commands(server)))


def drag(desk: Desk, *inliers: int) -> None:
    for count in inliers:
        desk.change(params=needing(count), moving=True)
    desk.release(needing(inliers[-1]))


def undone(desk: Desk, server: viser.ViserServer) -> list[PipelineParams]:
    """Undo all of it, and list where that led."""
    steps: list[PipelineParams] = []
    while not find(server, "Undo").disabled:
        user_presses(find(server, "Undo"))
        steps.append(desk.state.params)
    return steps


def test_a_press_is_one_step(desk: Desk, server: viser.ViserServer) -> None:
    assert find(server, "Undo").disabled
    drag(desk, 5, 6, 7, 8)
    drag(desk, 9, 12)
    assert undone(desk, server) == [needing(8), NUMBERS]
    forth = find(server, "Redo")
    assert forth.visible
    user_presses(forth)
    assert desk.state.params == needing(8)
    drag(desk, 30)
    assert not forth.visible


def test_any_other_change_is_a_step(desk: Desk, server: viser.ViserServer) -> None:
    desk.change(params=needing(5))
    desk.change(params=needing(6))
    desk.change(options=STATE.options)  # nothing to undo
    desk.change(params=needing(7), moving=True)
    desk.change(params=needing(20))  # by somebody else, while a hand is on a slider
    assert undone(desk, server) == [needing(7), needing(6), needing(5), NUMBERS]


def test_a_busy_page_says_late_where_a_press_ended(desk: Desk, server: viser.ViserServer) -> None:
    # The values of the second press come before the end of the first, and the end of the third
    # before its value.
    desk.change(params=needing(5), moving=True)
    desk.change(params=needing(9), moving=True)
    desk.release(needing(6))
    desk.release(needing(9))
    desk.release(needing(11))
    desk.change(params=needing(11), moving=True)
    assert undone(desk, server) == [needing(9), needing(6), NUMBERS]


def test_an_undo_before_the_slider_rests_goes_to_where_it_began(
    desk: Desk, server: viser.ViserServer
) -> None:
    desk.change(params=needing(20), moving=True)
    user_presses(find(server, "Undo"))
    assert desk.state.params == NUMBERS
    desk.release(needing(20))  # said before the undo was known
    user_presses(find(server, "Redo"))
    assert desk.state.params == needing(20)


def test_another_dataset_has_a_history_of_its_own(desk: Desk, server: viser.ViserServer) -> None:
    drag(desk, 5)
    desk.open(Opened(make_dataset(), needing(3), ""))
    assert find(server, "Undo").disabled
    user_presses(find(server, "Undo"))
    assert desk.state.asked == needing(3)


@pytest.fixture
def tool(desk: Desk) -> SnapshotsTool:
    return desk.join(SnapshotsTool(desk, Commands(desk.host)))


def test_one_key_changes_between_a_and_b(tool: SnapshotsTool, desk: Desk) -> None:
    assert tool.note.content == ""
    tool.keep("A")
    assert "A shown. Change something, and keep it as B." in tool.note.content
    desk.change(params=needing(7))
    assert "Neither is shown." in tool.note.content
    tool.keep("B")
    assert "B shown. min inliers " in tool.note.content
    tool.switch()
    assert desk.state.asked == STATE.params
    assert "A shown." in tool.note.content
    tool.switch()
    assert desk.state.asked == needing(7)
    desk.change(params=needing(9))
    tool.switch()
    assert desk.state.asked == STATE.params


def test_without_the_other_nothing_happens(tool: SnapshotsTool, desk: Desk) -> None:
    tool.switch()
    tool.keep("A")
    tool.switch()
    assert desk.state.asked == STATE.params


def test_another_dataset_has_none(tool: SnapshotsTool, desk: Desk) -> None:
    tool.keep("A")
    go_to(desk, open_dataset(make_dataset(name="others"), PipelineParams()))
    assert tool.note.content == ""


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
