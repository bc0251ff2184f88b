"""The bag of words knows a picture again, grows as it goes, and says what it lacks."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PipelineParams, detect_loop_closures
from gpgrad_core.detection.images import nearest_words
from gpgrad_core.errors import InputError
from gpgrad_core.methods.appearance import AppearanceDetector, see
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Dataset, Submap
from tests.support.ground import submap

Image = NDArray[np.uint8]


def picture(seed: int) -> Image:
    """Draw grey discs and squares of all sizes."""
    rng = np.random.default_rng(seed)
    image = np.full((240, 320), 128, np.uint8)
    for _ in range(250):
        x, y = (int(v) for v in rng.integers(0, (320, 240)))
        size, shade = int(rng.integers(2, 15)), int(rng.integers(0, 256))
        if rng.uniform() < 0.5:
            cv2.circle(image, (x, y), size, shade, -1)
        else:
            cv2.rectangle(image, (x, y), (x + size, y + size), shade, -1)
    return image


def turned(image: Image, degrees: float) -> Image:
    turn = cv2.getRotationMatrix2D((160, 120), degrees, 1.0)
    return np.asarray(cv2.warpAffine(image, turn, (320, 240)), np.uint8)


@pytest.fixture
def seen(tmp_path: Path) -> list[Submap]:
    """Four places, the last of them the second again, with the camera rolled."""
    views = [picture(1), picture(2), picture(3), turned(picture(2), 15)]
    files = [tmp_path / f"{k}.png" for k in range(4)]
    for file, image in zip(files, views, strict=True):
        cv2.imwrite(str(file), image)
    return [replace(submap(k, 50), id=str(k), images=(file,)) for k, file in enumerate(files)]


@pytest.mark.slow
def test_a_place_seen_again_ranks_first(seen: list[Submap]) -> None:
    detector = AppearanceDetector(PipelineParams(), Memo())
    result = detect_loop_closures(Dataset("seen", tuple(seen)), detector=detector)
    scores = {(c.query_id, c.database_id): c.registration.score for c in result.closures}
    again = scores.pop(("3", "1"))
    assert again > 50
    assert again > 5 * max(scores.values())
    assert not any(closure.accepted for closure in result.closures)  # it knows no motion


def test_two_places_alone_can_be_compared(seen: list[Submap]) -> None:
    detector = AppearanceDetector(PipelineParams(), Memo())
    assert detector(seen[3], seen[1]).score > 5 * detector(seen[2], seen[1]).score


def test_words_are_told_by_the_ratio_of_the_nearest_two() -> None:
    rng = np.random.default_rng(0)
    words = rng.integers(0, 256, (20, 32), dtype=np.uint8)
    nearly = words[[3, 7]].copy()
    nearly[:, 0] ^= 1
    between = words[[5]] & words[[6]]
    found = nearest_words(np.concatenate([nearly, between]), words)
    assert found[:2].tolist() == [3, 7]
    assert nearest_words(nearly, words[:1]).tolist() == [-1, -1]


def test_what_is_missing_is_said(seen: list[Submap], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="0: appearance needs camera images"):
        see(replace(seen[0], images=()))
    broken = tmp_path / "broken.png"
    for content in (b"not an image", b""):
        broken.write_bytes(content)
        with pytest.raises(InputError, match=r"broken\.png: is not an image"):
            see(replace(seen[0], images=(broken,)))
