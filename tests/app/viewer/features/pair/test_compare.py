from dataclasses import replace

import numpy as np
import viser

from app.viewer.features.pair.compare import (
    REFERENCE,
    compare_inliers,
    ground_of_one,
    motion_in_words,
)
from app.viewer.features.session import Session
from app.viewer.scene.placement import beside
from app.viewer.session.session_file import Opened
from app.viewer.session.state import open_dataset
from gpgrad_core.se2 import SE2
from tests.support.desk import changes, uses
from tests.support.synthetic import NUMBERS, FakePipeline, make_dataset, make_map, make_result
from tests.support.widgets import find, node, said, user_sets

OPENED = Opened(make_dataset(num_points=400), NUMBERS, "", None, NUMBERS)
STATE = open_dataset(make_dataset(), NUMBERS)
RESULT = make_result(STATE)


def test_the_same_inliers_are_found_again_where_keypoints_have_moved() -> None:
    matches = RESULT.matches
    moved = replace(matches, query_xy=matches.query_xy[::-1] + 0.01)
    moved = replace(moved, database_xy=matches.database_xy[::-1])
    inliers = RESULT.registration.inliers[::-1].copy()
    inliers[-3:] = False  # the first three of before
    inliers[0] = True  # the last outlier of before
    after = replace(
        RESULT, matches=moved, registration=replace(RESULT.registration, inliers=inliers)
    )
    found = compare_inliers(RESULT, after, 0.1)
    assert found.lost.tolist() == [0, 1, 2]
    assert found.gained.tolist() == [0]
    first, second = found.both
    assert (first + second == len(matches) - 1).all()
    assert len(found.lost) + len(first) == RESULT.registration.num_inliers
    assert len(found.gained) + len(first) == after.registration.num_inliers
    none = replace(after, registration=replace(after.registration, inliers=inliers & False))
    assert len(compare_inliers(RESULT, none, 0.1).lost) == RESULT.registration.num_inliers
    assert not len(compare_inliers(RESULT, after, 0.001).both[0])


def test_ground_is_lost_under_a_stricter_mask_and_on_a_coarser_grid() -> None:
    fine, coarse = make_map(STATE.query, 0.1), make_map(STATE.query, 0.2)
    lost = ground_of_one(fine, 0.9, fine, 0.5)
    more = fine.trusted(0.9).sum() - fine.trusted(0.5).sum()
    assert len(lost.points) == more > 0
    assert np.isclose(lost.area, more * 0.1**2)
    assert not ground_of_one(fine, 0.5, fine, 0.9).area
    assert ground_of_one(coarse, 0.9, fine, 0.9).area < 0.1 * lost.area


def test_the_motion_is_told_at_the_middle_of_the_query() -> None:
    motion = RESULT.registration.T_database_query
    assert motion is not None
    assert motion_in_words(RESULT, RESULT) == "0.0 cm, 0.00°"
    moved = replace(RESULT.registration, T_database_query=SE2(0.03, 0.04) @ motion)
    assert motion_in_words(RESULT, replace(RESULT, registration=moved)) == "5.0 cm, 0.00°"
    without = replace(RESULT.registration, T_database_query=None)
    assert not motion_in_words(RESULT, replace(RESULT, registration=without))


def test_two_pictures_never_meet() -> None:
    here, other = np.array([[0.0, 0, 0], [4, 2, 0]]), np.array([[-1.0, 5, 0], [1, 9, 0]])
    x, y = beside(other, here, behind=True)
    assert not x
    assert (other[:, 1] + y).min() > 2
    x, y = beside(other, here, behind=False)
    assert not y
    assert (other[:, 0] + x).max() < 0


def test_a_stands_beside_b_until_it_is_left(
    session: Session, gui: viser.ViserServer, pipeline: FakePipeline
) -> None:
    alone = session.pair.scene.camera(session.state)
    uses(session, "A | B", "Keep as A")
    assert node(gui, REFERENCE).visible
    assert "Loop closure" in node(gui, f"{REFERENCE}/heading").text
    assert session.pair.scene.camera(session.state) != alone
    legend = session.desk.canvases.caption["legend"]
    assert "0 only in A" in legend
    assert "12 in both" in legend
    count = len(pipeline.calls)
    uses(session, "Minimum inliers", 20)
    assert len(pipeline.calls) == count + 1  # of B: A is as it was
    assert "No loop closure" in node(gui, "/pair/heading").text
    assert "Loop closure" in node(gui, f"{REFERENCE}/heading").text
    changes(session, options=replace(session.state.options, layout="registered"))
    both = np.asarray(node(gui, f"{REFERENCE}/both").points)
    assert len(both) == 4 * 12  # pins: a line would have no length
    assert (both[:, 1, 2] > both[:, 0, 2]).all()
    session.desk.choose("002", "000")
    assert session.wait_idle(120)
    assert node(gui, REFERENCE).visible
    uses(session, "Mode", "Demo")
    assert not node(gui, REFERENCE).visible
    user_sets(find(gui, "Mode"), "Tune")
    session.desk.leave_reference()
    assert session.wait_idle(120)
    assert not node(gui, REFERENCE).visible
    assert not node(gui, "/pair/heading").visible
    assert "only in A" not in session.desk.canvases.caption["legend"]
    assert "Up to date" in said(gui, "status")
