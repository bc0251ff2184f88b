from collections.abc import Iterator

import pytest
import viser

from app.viewer.params.undo import UndoTool
from app.viewer.state import open_dataset, with_params
from app.viewer.widgets.commands import Commands
from gpgrad_core.pipeline import PipelineParams
from tests.app.desk import Recorder, make_desk
from tests.app.synthetic import make_dataset, needing
from tests.app.widgets import find, user_presses

STATE = open_dataset(make_dataset(), PipelineParams())
NEVER = 600.0
"""By the clock; a test says itself when a slider rests [s]."""


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


def gone_to(recorder: Recorder) -> list[PipelineParams]:
    return [state.params for state in recorder.states]


@pytest.fixture
def undo(server: viser.ViserServer, recorder: Recorder) -> Iterator[UndoTool]:
    made = UndoTool(make_desk(server, STATE, recorder), Commands(server), settled_after=NEVER)
    yield made
    made.close()


def drag(undo: UndoTool, *inliers: int) -> None:
    for count in inliers:
        undo.follow(with_params(STATE, needing(count)))
    undo._stop()
    undo._settle()


def test_a_drag_is_one_step(undo: UndoTool, server: viser.ViserServer, recorder: Recorder) -> None:
    back, forth = find(server, "Undo"), find(server, "Redo")
    assert back.disabled
    drag(undo, 5, 6, 7, 8)
    drag(undo, 9, 12)
    assert not back.disabled
    user_presses(back)
    user_presses(back)
    assert gone_to(recorder) == [needing(8), PipelineParams()]
    assert back.disabled
    assert forth.visible
    user_presses(forth)
    assert gone_to(recorder)[-1] == needing(8)
    drag(undo, 30)
    assert not forth.visible


def test_an_undo_before_the_slider_rests_goes_to_where_it_began(
    undo: UndoTool, server: viser.ViserServer, recorder: Recorder
) -> None:
    undo.follow(with_params(STATE, needing(20)))
    user_presses(find(server, "Undo"))
    assert gone_to(recorder) == [PipelineParams()]
    user_presses(find(server, "Redo"))
    assert gone_to(recorder)[-1] == needing(20)


def test_another_dataset_has_a_history_of_its_own(
    undo: UndoTool, server: viser.ViserServer, recorder: Recorder
) -> None:
    drag(undo, 5)
    undo.follow(open_dataset(make_dataset(), needing(3)))
    assert find(server, "Undo").disabled
    user_presses(find(server, "Undo"))
    assert gone_to(recorder) == [needing(3)]
