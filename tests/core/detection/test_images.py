"""Images confirm a place that they show again, contradict an alias, and are silent of most."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations
from math import comb, inf, log10
from pathlib import Path

import cv2
import numpy as np
import pytest

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import PipelineParams, detect_loop_closures
from gpgrad_core.detection.images import (
    EPIPOLAR_DISTANCE,
    FALSE_ALARMS,
    MOST_IMAGES,
    ImageFeatures,
    compare_images,
    extract_orb,
    judge_by_images,
    log_false_alarms,
    some_of,
)
from gpgrad_core.detection.verdict import ClosureParams, why_of
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, LoopClosure, Refusal, Registration, Submap
from tests.support.ground import submap
from tests.support.views import Scenery

PLACES = [(3.0, 4.0, 0.3), (8.0, 5.0, 1.7), (5.0, 9.0, 3.9)]
"""On the ground [m], and the heading [rad]."""


@cache
def scenery() -> Scenery:
    return Scenery.random(1)


@cache
def picture(x: float, y: float, yaw: float, seed: int = 0) -> NDArray[np.uint8]:
    return scenery().seen(x, y, yaw, seed=seed)


@cache
def view(x: float, y: float, yaw: float, seed: int = 0) -> ImageFeatures:
    return extract_orb("front.png", picture(x, y, yaw, seed))


def verdict(query: ImageFeatures, database: ImageFeatures, motion: SE2) -> str:
    return judge_by_images([query], [database], motion).verdict


def test_another_place_that_looks_alike_does_not_agree() -> None:
    for query, database in combinations([view(*place) for place in PLACES], 2):
        found = compare_images(query, database)
        assert found.log_false_alarms > np.log10(FALSE_ALARMS), found
        assert verdict(query, database, SE2(0.1, -0.2, 0.1)) == "contradicted"


def test_the_same_place_is_known_again_from_beside() -> None:
    for x, y, yaw in PLACES:
        database, query = view(x, y, yaw), view(x + 0.3, y - 0.3, yaw + np.radians(12), seed=5)
        found = compare_images(query, database)
        assert found.log_false_alarms < -5, found
        assert verdict(query, database, SE2(0.3, 0.3, np.radians(12))) == "confirmed"


def test_another_side_of_a_place_cannot_be_told_from_another_place() -> None:
    x, y, yaw = PLACES[0]
    one, other = view(x, y, yaw), view(*PLACES[1])
    for turn in (np.radians(90), np.pi):
        query = view(x, y, yaw + turn, seed=5)
        assert compare_images(query, one).log_false_alarms > -1
        assert verdict(query, one, SE2(0.0, 0.0, turn)) == "silent"
        assert verdict(other, one, SE2(0.0, 0.0, turn)) == "silent"
    assert verdict(other, one, SE2(2.0, 0.0, 0.0)) == "silent"


def test_bare_and_noisy_images_are_silent() -> None:
    for noise in (0.0, 15.0):
        chance = np.random.default_rng(1).normal(128, noise, (2, 240, 320))
        pictures = np.clip(chance, 0, 255).astype(np.uint8)
        one, other = (extract_orb("front.png", picture) for picture in pictures)
        assert one.num_corners < 10
        assert compare_images(one, other).log_false_alarms > 0
        found = judge_by_images([one], [other], SE2())
        assert found.verdict == "silent"
        assert "too little texture" in found.reason


def test_a_turned_image_agrees_with_a_motion_that_turns_as_much() -> None:
    # A camera that looks ahead sees the same from one side up to 90 degrees: its image moves to
    # the side, and does not turn.
    fitting = {5.0: {0}, 95.0: {1}, 170.0: {1, 2}}
    level = picture(*PLACES[1])
    database = extract_orb("down.png", level)
    for quarters in (0, 1, 2):
        query = extract_orb("down.png", np.ascontiguousarray(np.rot90(level, quarters)))
        turn = np.degrees(abs(compare_images(query, database).turn))
        assert turn == pytest.approx(90 * quarters, abs=10)
        for degrees, fits in fitting.items():
            said = judge_by_images([query], [database], SE2(yaw=np.radians(degrees)))
            expected = "confirmed" if quarters in fits else "contradicted"
            assert said.verdict == expected, (quarters, degrees, said)
            assert quarters in fits or "the image is turned by" in said.reason


def test_images_of_two_cameras_confirm_but_never_contradict() -> None:
    front, other = view(*PLACES[0]), view(*PLACES[1])
    rear = replace(front, name="rear.png")
    assert verdict(front, rear, SE2(yaw=np.pi)) == "confirmed"
    assert verdict(other, rear, SE2()) == "silent"


def test_chance_is_counted() -> None:
    assert log_false_alarms(7, 500, (320, 240)) == inf
    assert log_false_alarms(8, 500, (320, 240)) > 0
    ways = 3 * (40 - 7) * comb(40, 20) * comb(20, 7)
    chance = ways * (2 * EPIPOLAR_DISTANCE * 400 / (320 * 240)) ** (20 - 7)
    assert log_false_alarms(20, 40, (320, 240)) == pytest.approx(log10(chance))
    assert log_false_alarms(30, 40, (320, 240)) < log_false_alarms(20, 40, (320, 240))
    assert log_false_alarms(20, 80, (320, 240)) > log_false_alarms(20, 40, (320, 240))


def test_some_of_many_images_are_compared() -> None:
    files = tuple(Path(f"{k}.png") for k in range(10))
    assert some_of(files[:4]) == files[:4]
    assert some_of(files) == tuple(files[k] for k in (0, 3, 6, 9))
    assert len(some_of(files)) == MOST_IMAGES


Made = Callable[..., list[LoopClosure]]


@pytest.fixture
def detect(tmp_path: Path) -> Made:
    """Detect closures between twins: the same terrain, each with an image of its own."""

    def found(pictures: list[NDArray[np.uint8] | None], images: str) -> list[LoopClosure]:
        twins = [with_image(k, one, tmp_path) for k, one in enumerate(pictures)]
        params = PipelineParams(closure=ClosureParams(images=images))  # pyright: ignore
        return list(
            detect_loop_closures(Dataset("twins", tuple(twins)), params, detector=alike).closures
        )

    return found


def alike(query: Submap, database: Submap) -> Registration:
    """Find that two submaps lie on each other, as their terrain is the same."""
    assert len(query.points) == len(database.points)
    return Registration(SE2(0.1, 0.0, 0.05), np.ones(30, bool), 1.0, 10.0, 0.9, 9.0)


def with_image(k: int, picture: NDArray[np.uint8] | None, folder: Path) -> Submap:
    files = ()
    if picture is not None:
        file = folder / f"{k:03d}" / "front.png"
        file.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(file), picture)
        files = (file,)
    odometry = Pose.from_planar(SE2(float(k)))
    return replace(submap(1, 50), id=f"{k:03d}", images=files, pose_odometry=odometry)


@pytest.mark.slow
def test_what_images_may_do_is_chosen(detect: Made) -> None:
    x, y, yaw = PLACES[0]
    same, other = picture(x, y, yaw), picture(*PLACES[2])
    again = picture(x + 0.1, y, yaw + 0.05, seed=3)
    grey = np.full_like(same, 128)

    def of(image: NDArray[np.uint8] | None, images: str) -> tuple[str | None, bool]:
        (closure,) = detect([same, image], images)
        return closure.images and closure.images.verdict, closure.accepted

    assert of(other, "off") == (None, True)
    assert of(other, "show") == ("contradicted", True)
    assert of(other, "veto") == ("contradicted", False)
    assert of(other, "require") == ("contradicted", False)
    assert of(again, "veto") == of(again, "require") == ("confirmed", True)
    assert of(grey, "show") == of(grey, "veto") == ("silent", True)
    assert of(grey, "require") == ("silent", False)
    assert of(None, "veto") == (None, True)
    assert of(None, "require") == (None, False)


def test_the_reason_says_what_the_images_said(detect: Made) -> None:
    pictures = [picture(*place) for place in PLACES[:2]]
    (closure,) = detect(pictures, "veto")
    assert closure.images is not None
    assert closure.reason == f"the images contradict the motion: {closure.images.reason}"
    assert closure.refusal == Refusal("images contradict", detail=closure.images.reason)
    assert why_of(closure.refusal) == closure.reason
    assert "puts the camera back within 0.1 m and 3°" in closure.reason
    (closure,) = detect([pictures[0], None], "require")
    assert closure.reason.endswith("there are not images of both submaps")


def test_an_image_that_cannot_be_read_is_named_only_if_images_are_asked(tmp_path: Path) -> None:
    twins = tuple(with_image(k, np.full((50, 50), 9, np.uint8), tmp_path) for k in (0, 1))
    twins[1].images[0].write_bytes(b"no image")
    dataset = Dataset("twins", twins)
    assert detect_loop_closures(dataset, detector=alike).closures[0].accepted
    params = PipelineParams(closure=ClosureParams(images="show"))
    with pytest.raises(InputError, match=r"front\.png: is not an image that can be read"):
        detect_loop_closures(dataset, params, detector=alike)
