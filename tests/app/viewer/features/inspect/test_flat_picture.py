from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.viewer.features.inspect.flat_picture import NOTHING, WIDTH, draw_pane
from app.viewer.scene.colors import CHOSEN, DATABASE, INLIER, OUTLIER, QUERY
from app.viewer.session.state import ViewOptions, ViewState, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import make_dataset, make_result

STATE = open_dataset(make_dataset(num_points=300), PipelineParams())
RESULT = make_result(STATE)
BARE = {"keypoints": False, "inlier_lines": False, "outlier_lines": False}


def seeing(**options: Any) -> ViewState:
    return replace(STATE, options=replace(ViewOptions(), **options))


def share_of(image: np.ndarray, color: tuple[int, int, int], near: int = 40) -> float:
    """Share of the pixels that have a colour, about."""
    return float((np.abs(image.astype(int) - color).max(axis=-1) < near).mean())


def test_side_by_side_both_gradient_images_stand_above_each_other() -> None:
    image = draw_pane(seeing(**BARE), RESULT)
    assert image.shape[1] == WIDTH
    assert image.shape[0] > 1.9 * WIDTH
    assert share_of(image[:3], QUERY, 10) > 0.9  # the frames have the submaps' colours
    assert share_of(image[-3:], DATABASE, 10) > 0.9
    # The steepest place of the query's map is where the picture is lightest; white is a round
    # number above it.
    steep = RESULT.query_map.gradient * RESULT.query_map.trusted(0.3)
    rows, columns = steep.shape
    row, column = np.unravel_index(steep.argmax(), steep.shape)
    x, y = (
        int(column * (WIDTH - 1) / (columns - 1)),
        int((rows - 1 - row) * (WIDTH - 1) / (columns - 1)),
    )
    assert image[y, x].min() > 200


def test_each_switch_draws_what_it_says() -> None:
    bare = draw_pane(seeing(**BARE), RESULT)
    for option, color in (
        ("inlier_lines", INLIER),
        ("outlier_lines", OUTLIER),
        ("keypoints", INLIER),
    ):
        drawn = draw_pane(seeing(**(BARE | {option: True})), RESULT)
        difference = np.abs(drawn.astype(int) - bare).max(axis=-1) > 25
        assert difference.any(), option
        # What is drawn is nearer to its colour than what was there.
        towards = np.abs(drawn[difference] - np.array(color)).mean()
        assert towards < np.abs(bare[difference] - np.array(color)).mean(), option


def test_the_chosen_association_stands_out_in_both_images() -> None:
    without = draw_pane(seeing(**BARE), RESULT)
    image = draw_pane(replace(seeing(**BARE), match=3), RESULT)
    half = image.shape[0] // 2
    for part, before in ((image[:half], without[:half]), (image[half:], without[half:])):
        assert share_of(part, CHOSEN) > 1e-4
        assert share_of(before, CHOSEN) == 0.0
    beyond = draw_pane(replace(seeing(**BARE), match=999), RESULT)
    np.testing.assert_array_equal(beyond, without)
    lines = BARE | {"inlier_lines": True}
    assert share_of(draw_pane(replace(seeing(**lines), match=1), RESULT), INLIER) < share_of(
        draw_pane(seeing(**lines), RESULT), INLIER
    )


def test_registered_each_way_of_comparing_shows_another_picture() -> None:
    pictures = [
        draw_pane(seeing(layout="registered", compare=compare, **BARE), RESULT)
        for compare in ("both", "query", "database", "swipe")
    ]
    pictures.append(draw_pane(seeing(layout="registered", layer="difference", **BARE), RESULT))
    assert len({picture.shape for picture in pictures}) == 1
    for k, first in enumerate(pictures):
        assert share_of(first, NOTHING, 3) < 0.9
        for second in pictures[k + 1 :]:
            assert (np.abs(first.astype(int) - second).max(axis=-1) > 30).mean() > 0.02


def test_the_swipe_shows_the_query_left_and_the_database_right() -> None:
    options = {"layout": "registered", **BARE}
    query = draw_pane(seeing(compare="query", **options), RESULT)
    database = draw_pane(seeing(compare="database", **options), RESULT)
    swiped = draw_pane(seeing(compare="swipe", swipe=0.4, **options), RESULT)
    line = int(0.4 * (WIDTH - 1))
    np.testing.assert_array_equal(swiped[:, : line - 2], query[:, : line - 2])
    np.testing.assert_array_equal(swiped[:, line + 2 :], database[:, line + 2 :])


def test_laid_onto_each_other_equal_ground_is_grey() -> None:
    image = draw_pane(seeing(layout="registered", **BARE), RESULT).astype(int)
    bright = image.min(axis=-1) > 90
    assert bright.mean() > 0.01
    spread = image[bright].max(axis=-1) - image[bright].min(axis=-1)
    assert np.median(spread) < 50


@pytest.mark.parametrize("layout", ["side by side", "registered"])
def test_no_motion_and_no_association_are_no_error(layout: str) -> None:
    empty = make_result(STATE, num_inliers=0, num_outliers=0)
    lost = replace(empty, registration=replace(empty.registration, T_database_query=None))
    image = draw_pane(replace(seeing(layout=layout), match=1), lost)
    assert image.shape[0] > 1.9 * WIDTH  # above each other
