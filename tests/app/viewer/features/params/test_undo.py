import pytest
import viser

from app.viewer.features.desk import Desk
from app.viewer.features.params.tab import (
    KEEP,
    LEAVE,
    LONGEST,
    SWAP,
    HistoryTool,
    ReferenceTool,
)
from app.viewer.session.session_file import Opened
from app.viewer.session.state import open_dataset
from app.viewer.widgets.commands import Commands
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import NUMBERS, make_dataset, needing
from tests.support.widgets import find, press_key, user_presses, user_sets

STATE = open_dataset(make_dataset(), NUMBERS)


@pytest.fixture(autouse=True)
def tool(desk: Desk) -> HistoryTool:
    commands = Commands(desk.host)
    desk.join(ReferenceTool(desk, commands))
    return desk.join(HistoryTool(desk, commands))


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


def test_an_undo_in_a_drag_goes_to_where_it_began(desk: Desk, server: viser.ViserServer) -> None:
    desk.change(params=needing(20), moving=True)
    user_presses(find(server, "Undo"))
    assert desk.state.params == NUMBERS
    desk.release(needing(20))  # said before the undo was known
    user_presses(find(server, "Redo"))
    assert desk.state.params == needing(20)


def test_all_is_undone_and_the_oldest_are_forgotten(desk: Desk, server: viser.ViserServer) -> None:
    for count in range(1, LONGEST + 9):
        desk.change(params=needing(count))
    steps = undone(desk, server)
    assert steps == [needing(count) for count in range(LONGEST + 7, 7, -1)]
    forth = find(server, "Redo")
    for count in range(9, LONGEST + 9):
        assert forth.visible
        user_presses(forth)
        assert desk.state.params == needing(count)
    assert not forth.visible
    user_presses(forth)
    assert desk.state.params == needing(LONGEST + 8)


def test_another_dataset_has_a_history_of_its_own(desk: Desk, server: viser.ViserServer) -> None:
    drag(desk, 5)
    desk.open(Opened(make_dataset(), needing(3), ""))
    assert find(server, "Undo").disabled
    user_presses(find(server, "Undo"))
    assert desk.state.asked == needing(3)


def test_a_setting_is_kept_changed_with_the_present_one_and_left(desk: Desk) -> None:
    buttons = find(desk.host, "A | B")
    press_key(desk.host, "9")  # without A nothing happens
    assert desk.state.setting == ("gradient", STATE.params)
    user_sets(buttons, KEEP)
    desk.change(params=needing(7), method="paper")
    assert desk.state.reference == ("gradient", STATE.params)
    press_key(desk.host, "9")
    assert desk.state.setting == ("gradient", STATE.params)
    assert desk.state.reference == ("paper", needing(7))
    user_sets(buttons, SWAP)
    assert desk.state.setting == ("paper", needing(7))
    press_key(desk.host, "0")
    assert desk.state.reference == desk.state.setting
    user_sets(buttons, LEAVE)
    assert desk.state.reference is None
    assert buttons.options == (KEEP,)
