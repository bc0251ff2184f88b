"""What is said of a place or of a keypoint under the cursor."""

from dataclasses import replace

import numpy as np
import pytest
import viser

from app.viewer.features.hover import Keypoint, gradient_patches, keypoint_card, reading_card
from app.viewer.features.pair import PairScene, Picture
from app.viewer.session.state import Probe, open_dataset
from gpgrad_core.detection import PipelineParams
from tests.support.synthetic import make_dataset, make_result

STATE = open_dataset(make_dataset(), PipelineParams())
RESULT = make_result(STATE, num_inliers=12, num_outliers=5)


@pytest.fixture
def picture(server: viser.ViserServer) -> Picture:
    scene = PairScene(server)
    assert scene.picture is None  # nothing is drawn yet
    return scene.show(STATE, RESULT)


def test_a_place_is_read_in_both_submaps(picture: Picture) -> None:
    cards = [
        reading_card(picture, Probe("query", float(x), float(y)))
        for x, y in RESULT.matches.query_xy[:12]
    ]
    for card in cards:
        assert card.index(f"query {STATE.query_id}") < card.index(f"database {STATE.database_id}")
        assert card.count("±") == card.count("slope")
        assert card.count("slope") + card.count("saw no ground") == 2
    assert any(card.count("slope") == 2 for card in cards)
    alone = replace(picture, registration=None)  # while the motion is being found
    assert reading_card(alone, Probe("database", 0.0, 0.0)).count("slope") == 1


def test_a_place_that_only_one_submap_saw_is_said_so(picture: Picture) -> None:
    corner = picture.maps[0].grid
    card = reading_card(picture, Probe("query", float(corner.x[0]), float(corner.y[0])))
    assert "masked" in card or "saw no ground" in card


@pytest.mark.parametrize(
    ("number", "match", "words", "pictures"),
    [(0, 0, "inlier 1", 2), (12, 12, "outlier 13", 2), (17, None, "without a partner", 1)],
)
def test_a_keypoint_is_shown_with_its_partner(
    picture: Picture, number: int, match: int | None, words: str, pictures: int
) -> None:
    card = keypoint_card(picture, RESULT, Keypoint(0, number, match))
    assert words in card
    assert card.count("<img ") == pictures


def test_the_patches_of_an_inlier_lie_alike_and_those_of_an_outlier_do_not() -> None:
    def likeness(match: int) -> float:
        query, database = RESULT.matches.pairs[match].tolist()
        (_, first), (_, second) = gradient_patches(RESULT, [(0, query), (1, database)])
        return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])

    inliers = [likeness(match) for match in range(12)]
    outliers = [likeness(match) for match in range(12, 17)]
    assert np.median(inliers) > 0.6
    assert np.median(inliers) > np.median(outliers) + 0.3
