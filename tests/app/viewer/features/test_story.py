"""The story of a demonstration, without a browser."""

import numpy as np
import viser

from app.viewer.features.demo.tab import DemoTab
from app.viewer.features.session import Session
from app.viewer.session.session_file import Opened
from tests.support.synthetic import NUMBERS, make_dataset
from tests.support.waiting import until
from tests.support.widgets import find, node, run_command, user_presses

OPENED = Opened(make_dataset(), NUMBERS, "", None, NUMBERS)


def demo_of(session: Session) -> DemoTab:
    return next(feature for feature in session.desk.features if isinstance(feature, DemoTab))


def test_the_steps_are_those_of_a_closure(session: Session) -> None:
    story = demo_of(session).story
    titles = [step.title for step in story.steps()]
    assert titles[:4] == [
        "The same place?",
        "Keypoints of the gradient",
        "Lines join what looks alike",
        "The query flies in",
    ]
    assert len(titles) == 5  # no pose graph was optimised: the map does not close
    before = session.state.options
    user_presses(find(session.desk.host, "Present"))
    until(lambda: not session.state.options.keypoints, "the first step")
    run_command(session.desk.host, "Next step")
    until(
        lambda: session.state.options.keypoints and not session.state.options.inlier_lines,
        "the second step",
    )
    told = story.told
    assert told is not None
    assert (told.step, told.going) == (1, False)
    run_command(session.desk.host, "Step before")
    until(lambda: story.told is not None and story.told.step == 0, "the step before")
    run_command(session.desk.host, "Leave full screen")
    assert story.told is None
    assert session.state.options == before
    assert session.wait_idle()


def test_the_difference_fades_into_the_ground_that_was_there(
    session: Session, gui: viser.ViserServer
) -> None:
    scene = session.pair.scene
    ground = scene.colors
    shown = demo_of(session).shown
    assert shown is not None
    fade = scene.fading(tuple(255 - colors for colors in ground), shown[1])
    for share in (0.0, 0.5, 1.0):
        fade(share)
        for role, colors in zip(("query", "database"), ground, strict=True):
            drawn = np.asarray(node(gui, f"/pair/{role}/surface").colors, float)
            expected = colors + share * (255.0 - 2.0 * colors)
            np.testing.assert_allclose(drawn, expected, atol=1.0)


def test_keys_do_nothing_while_nothing_is_told(session: Session) -> None:
    before = session.state
    for label in ("Rest, or go on", "Next step", "Step before"):
        run_command(session.desk.host, label)
    assert demo_of(session).story.told is None
    assert session.state is before
