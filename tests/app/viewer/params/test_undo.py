import pytest
import viser

from app.viewer.feature import Desk
from app.viewer.params.undo import UndoTool
from app.viewer.session_file import Opened
from app.viewer.state import open_dataset
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams
from tests.app.desk import Recorder, make_desk
from tests.app.synthetic import NUMBERS, make_dataset, needing
from tests.app.widgets import find, user_presses

STATE = open_dataset(make_dataset(), NUMBERS)


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


def gone_to(recorder: Recorder) -> list[PipelineParams]:
    return [state.asked for state in recorder.states]


@pytest.fixture
def desk(server: viser.ViserServer, recorder: Recorder) -> Desk:
    made = make_desk(server, STATE, recorder)
    made.join(UndoTool(made, Commands(server)))
    return made


def drag(desk: Desk, *inliers: int) -> None:
    for count in inliers:
        desk.change(params=needing(count), moving=True)
    desk.tell(lambda feature: feature.rested(needing(inliers[-1])))


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
    desk.tell(lambda feature: feature.rested(needing(6)))
    desk.tell(lambda feature: feature.rested(needing(9)))
    desk.tell(lambda feature: feature.rested(needing(11)))
    desk.change(params=needing(11), moving=True)
    assert undone(desk, server) == [needing(9), needing(6), NUMBERS]


def test_an_undo_before_the_slider_rests_goes_to_where_it_began(
    desk: Desk, server: viser.ViserServer
) -> None:
    desk.change(params=needing(20), moving=True)
    user_presses(find(server, "Undo"))
    assert desk.state.params == NUMBERS
    desk.tell(lambda feature: feature.rested(needing(20)))  # said before the undo was known
    user_presses(find(server, "Redo"))
    assert desk.state.params == needing(20)


def test_another_dataset_has_a_history_of_its_own(
    desk: Desk, server: viser.ViserServer, recorder: Recorder
) -> None:
    drag(desk, 5)
    desk.open(Opened(make_dataset(), needing(3), ""))
    assert find(server, "Undo").disabled
    user_presses(find(server, "Undo"))
    assert gone_to(recorder)[-1] == needing(3)
