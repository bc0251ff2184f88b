"""The story of a demonstration, without a browser."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import viser

from app.viewer.features.demo.film import write_steps
from app.viewer.features.demo.tab import FILMS, SLIDES, DemoTab
from app.viewer.features.session import Session
from app.viewer.session.session_file import Opened
from app.viewer.session.state import Camera
from gpgrad_core.run import Cancelled
from tests.support.page import FakePage
from tests.support.synthetic import NUMBERS, make_dataset
from tests.support.waiting import until
from tests.support.widgets import find, node, run_command, user_presses, user_sets

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
    run_command(session.desk.host, "Leave full screen, or A | B")
    assert story.told is None
    assert session.state.options == before
    assert session.wait_idle()


def test_the_difference_fades_into_the_ground(session: Session, gui: viser.ViserServer) -> None:
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


def test_steps_are_added_renamed_moved_and_removed(session: Session) -> None:
    host, story = session.desk.host, demo_of(session).story

    def titles() -> list[str]:
        return [step.title for step in story.steps()]

    told = titles()
    page = FakePage()
    user_sets(find(host, "Edit"), "Add this view", page)
    assert len(titles()) == len(told) + 1
    added = story.steps()[1]
    assert added.camera == Camera((1.0, -2.0, 3.5), (0.0, 0.0, 0.0))
    assert added.options == session.state.options
    user_sets(find(host, "Title"), "Mine")
    assert titles() == [told[0], "Mine", *told[1:]]
    user_sets(find(host, "Edit"), "Earlier", page)
    assert titles() == ["Mine", *told]
    assert session.desk.present().saved.keyframes == story.steps()  # type: ignore[union-attr]
    for _ in titles():
        user_sets(find(host, "Edit"), "Remove", page)
    assert titles() == told  # without any, it is the story of the pair again


@pytest.mark.parametrize("kind", ["WebM", "GIF", "PDF", "PNG"])
def test_films_are_drawn_without_a_page(session: Session, kind: str, tmp_path: Path) -> None:
    ending = (FILMS | SLIDES)[kind]
    shown = demo_of(session).shown
    assert shown is not None
    told: list[float] = []
    path = tmp_path / f"talk{ending}"
    steps = demo_of(session).story.steps()[2:]
    write_steps(*shown, steps, session.desk.memo, True, path, told.append)
    assert told == sorted(told)
    starts = {".webm": b"\x1a\x45\xdf\xa3", ".gif": b"GIF8", ".pdf": b"%PDF", ".zip": b"PK"}
    assert path.read_bytes().startswith(starts[ending])
    if kind == "WebM":
        film = cv2.VideoCapture(str(path))
        assert film.get(cv2.CAP_PROP_FRAME_WIDTH) == 1280
        count, rate = (film.get(what) for what in (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS))
        assert 8.0 < count / rate < 14.0

    def cancel(_done: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        write_steps(*shown, steps, session.desk.memo, True, path, cancel)


def test_keys_do_nothing_while_nothing_is_told(session: Session) -> None:
    before = session.state
    for label in ("Rest, or go on", "Next step", "Step before"):
        run_command(session.desk.host, label)
    assert demo_of(session).story.told is None
    assert session.state is before
