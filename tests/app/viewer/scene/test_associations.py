import cv2
import numpy as np

from app.viewer.scene.associations import (
    ARC_PIECES,
    KINDS,
    MOST_LINES,
    keypoint_dots,
    mark_of,
    match_lines,
    on_surface,
    outline,
    shown_counts,
    shown_kinds,
    shown_matches,
    spread,
    step_match,
)
from app.viewer.scene.colors import INLIER, OUTLIER, REFUSED_INLIER, Rgb
from app.viewer.scene.placement import Box, Placement, place
from app.viewer.session.state import ViewOptions, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import T_DATABASE_QUERY, height, make_dataset, make_result

STATE = open_dataset(make_dataset(), PipelineParams())
RESULT = make_result(STATE, num_inliers=12, num_outliers=5)
BOXES = Box.of(STATE.query), Box.of(STATE.database)


def test_a_position_takes_the_height_of_the_ground_there() -> None:
    positions = np.array([[0.3, -1.1], [1.0, 0.4]])
    points = on_surface(RESULT.database_map, positions, lift=0.05)
    np.testing.assert_array_equal(points[:, :2], positions)
    np.testing.assert_allclose(points[:, 2], height(positions) + 0.05, atol=0.12)
    off = on_surface(RESULT.database_map, np.array([[99.0, -99.0]]))
    assert np.isfinite(off).all()  # that of the rim


def test_inliers_and_outliers_are_joined_apart() -> None:
    placed = place(*BOXES, "side by side", None, 0.0)
    inliers = match_lines(RESULT, placed, inliers=True, lift=0.0)
    outliers = match_lines(RESULT, placed, inliers=False, lift=0.0)
    assert inliers.shape == (12 * ARC_PIECES, 2, 3)
    assert outliers.shape == (5 * ARC_PIECES, 2, 3)
    arcs = inliers.reshape(12, ARC_PIECES, 2, 3)
    assert (arcs[:, 0, 0, 0] < 0).all()  # from the query's side …
    assert (arcs[:, -1, 1, 0] > 0).all()  # … to the database's
    np.testing.assert_array_equal(arcs[:, 1:, 0], arcs[:, :-1, 1])  # without a gap
    broken = outliers.reshape(5, ARC_PIECES, 2, 3)
    assert (broken[:, 1:, 0] != broken[:, :-1, 1]).any(axis=2).all()  # told apart without colour
    middle = arcs[:, ARC_PIECES // 2, 0, 2]
    assert (middle > arcs[:, 0, 0, 2]).all()  # over the ground


def test_of_many_associations_a_few_that_are_spread_are_joined() -> None:
    many = make_result(STATE, num_inliers=150, num_outliers=30)
    all_inliers = shown_matches(many, inliers=True, everything=True)
    some = shown_matches(many, inliers=True, everything=False)
    assert all_inliers.sum() == 150
    assert some.sum() == MOST_LINES
    assert not (some & ~all_inliers).any()
    assert shown_matches(many, inliers=False, everything=False).sum() == MOST_LINES
    # They reach as far as all of them do, and none is far from one that is drawn.
    places, drawn = many.matches.query_xy[all_inliers], many.matches.query_xy[some]
    np.testing.assert_allclose(np.ptp(drawn, axis=0), np.ptp(places, axis=0), rtol=0.2)
    missed = np.linalg.norm(places[:, None] - drawn[None], axis=2).min(axis=1)
    assert missed.max() < np.linalg.norm(np.ptp(places, axis=0)) / 4


def test_few_positions_are_all_chosen_and_equal_ones_are_no_error() -> None:
    assert spread(np.zeros((3, 2)), 3).tolist() == [0, 1, 2]
    assert len(spread(np.zeros((9, 2)), 4)) <= 4
    assert spread(np.empty((0, 2)), 4).tolist() == []


def test_registered_inliers_meet_and_outliers_do_not() -> None:
    placed = place(*BOXES, "registered", T_DATABASE_QUERY, 0.0)
    lengths = [
        np.linalg.norm(lines[::ARC_PIECES, 0] - lines[ARC_PIECES - 1 :: ARC_PIECES, 1], axis=1)
        for lines in (
            match_lines(RESULT, placed, inliers=inliers, lift=0.0) for inliers in (True, False)
        )
    ]
    assert lengths[0].max() < 0.25  # cells are 0.1 m
    assert lengths[1].min() > 1.0


def test_keypoints_are_marked_by_what_became_of_them() -> None:
    for index in (0, 1):
        dots = keypoint_dots(RESULT, index, lift=0.0)
        assert len(dots.points) == 18
        kinds = [KINDS[place] for place in dots.kinds]
        assert kinds == 12 * ["inlier"] + 5 * ["outlier"] + ["unmatched"]
        inliers = keypoint_dots(RESULT, index, lift=0.0, shown=shown_kinds(STATE.options))
        assert set(inliers.kinds) == {KINDS.index("inlier")}  # no others unless asked for
    assert shown_counts(RESULT, ViewOptions(other_keypoints=True)) == {
        "inlier": 12,
        "outlier": 5,
        "unmatched": 2,
    }


def test_marks_are_told_apart_without_their_hue() -> None:
    marks = {kind: mark_of(kind) for kind in KINDS}
    for mark in marks.values():  # seen on light and on dark ground
        assert abs(lightness(mark.rim) - lightness(mark.core)) > 45
    inlier, outlier = marks["inlier"], marks["outlier"]
    assert lightness(inlier.core) > lightness(inlier.rim)
    assert lightness(outlier.core) < lightness(outlier.rim)
    assert marks["unmatched"].rim_width < 0.5 * min(inlier.rim_width, outlier.rim_width)
    # What fills inliers is far lighter than what outliers are drawn with: marks and lines.
    for inliers in (INLIER, REFUSED_INLIER):
        assert lightness(inliers) - lightness(OUTLIER) > 25


def lightness(color: Rgb) -> float:
    lab = cv2.cvtColor(np.array([[color]], dtype=np.float32) / 255, cv2.COLOR_RGB2LAB)
    return float(lab[0, 0, 0])


def test_an_outline_is_closed() -> None:
    lines = outline(Placement().apply(BOXES[0].corners))
    assert lines.shape == (4, 2, 3)
    np.testing.assert_array_equal(lines[:, 1], np.roll(lines[:, 0], -1, axis=0))


def test_steps_stop_at_the_kinds_that_are_shown_and_go_round() -> None:
    result = make_result(STATE, num_inliers=3, num_outliers=2)

    def walk(step: int, **kinds: bool) -> list[int]:
        number, way = 0, list[int]()
        for _ in range(4):
            number = step_match(result, number, step, **kinds)
            way.append(number)
        return way

    assert walk(1, inliers=True, outliers=False) == [1, 2, 3, 1]
    assert walk(-1, inliers=False, outliers=True) == [5, 4, 5, 4]
    assert walk(1, inliers=False, outliers=False) == [1, 2, 3, 4]
    nothing_fits = make_result(STATE, num_inliers=0, num_outliers=2)
    assert step_match(nothing_fits, 0, 1, inliers=True, outliers=False) == 1
    empty = make_result(STATE, num_inliers=0, num_outliers=0)
    assert step_match(empty, 0, 1, inliers=True, outliers=True) == 0
