"""What a drive shows at a time."""

from typing import TypeAlias

import numpy as np
import pytest

from app.viewer.features.world.model import Past, World, between, marks_of, words_of
from app.viewer.features.world.scene import ELLIPSE_STDS, ellipses
from app.viewer.features.world.submaps import poses_of
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import Drive, Moment
from gpgrad_core.types import Dataset
from tests.core.slam.simulated import Oracle, simulate

Driven: TypeAlias = tuple[Dataset, tuple[Moment, ...]]


@pytest.fixture(scope="module")
def drive() -> Driven:
    traverse = simulate(12, row=6, wrong=0.1)
    with Drive(detector=Oracle.of(traverse)) as drive:
        for submap in traverse.dataset.submaps:
            drive.add(submap)
        return traverse.dataset, drive.moments


def test_a_submap_comes_by_odometry_and_is_then_placed_by_its_closures(drive: Driven) -> None:
    dataset, moments = drive
    closing = next(k for k in range(12) if moments[k].loops)
    coming = Past(dataset, moments, closing, decided=False)
    placed = Past(dataset, moments, closing, moving=True)
    assert list(coming.poses) == list(placed.poses) == list(moments[closing].ids)
    for name in moments[closing - 1].ids:  # the earlier ones stand where they stood
        before = moments[closing - 1].poses[name]
        np.testing.assert_array_equal(coming.poses[name].translation, before.translation)
    assert not any(
        loop.accepted
        for loop in coming.correction.loops
        if loop.query_id == moments[closing].ids[-1]
    )
    assert placed.moves_from is not None
    for name, pose in coming.poses.items():
        np.testing.assert_array_equal(placed.moves_from[name].translation, pose.translation)
    accepted = {loop.pair for loop in placed.correction.loops if loop.accepted}
    assert accepted == {(c.query_id, c.database_id) for c in moments[closing].accepted}
    still = Past(dataset, moments, closing)
    assert still.moves_from is None
    assert not still.goes_on
    assert {loop.pair for loop in still.correction.loops} == accepted


def test_odometry_is_what_no_closure_has_touched(drive: Driven) -> None:
    dataset, moments = drive
    rows = {name: pose.row for name, pose in poses_of(dataset, "odometry").items()}
    assert {name: p.row for name, p in Past(dataset, moments, 11).odometry.items()} == rows


def test_the_line_marks_closures_corrections_and_refusals(drive: Driven) -> None:
    _, moments = drive
    marks = marks_of(moments)
    assert {number for number, kind in marks if kind == "closure"} == {
        k for k in range(12) if moments[k].loops
    }
    assert {kind for _, kind in marks} >= {"closure", "correction"}
    first = next(number for number, kind in marks if kind == "closure")
    assert "closes with" in words_of(moments[first])
    assert words_of(moments[0]) == "the first submap"


def test_an_ellipse_is_as_wide_as_the_position_is_uncertain(drive: Driven) -> None:
    dataset, moments = drive
    past = Past(dataset, moments, 4)
    certain = World(dataset, past=past).with_surfaces({}).certain
    feet = {name: pose.translation for name, pose in past.poses.items()}
    rings = ellipses(certain, feet).reshape(5, -1, 2, 3)
    for ring, pose, covariance in zip(rings, past.poses.values(), certain.values(), strict=True):
        off = ring[:, 0, :2] - pose.translation[:2]
        along = np.sqrt(np.linalg.eigvalsh(covariance[:2, :2]))
        reach = np.linalg.norm(off, axis=1)
        assert reach.max() == pytest.approx(ELLIPSE_STDS * along[1], rel=1e-4, abs=1e-3)
        np.testing.assert_allclose(ring[..., 2], pose.translation[2], atol=1e-5)


def test_between_two_poses_lies_the_middle() -> None:
    start = {"a": Pose.from_planar(SE2(0.0, 0.0, 3.0))}
    end = {"a": Pose.from_planar(SE2(2.0, 0.0, -3.0)), "b": Pose.from_planar(SE2(5.0, 5.0, 1.0))}
    middle = between(start, end, 0.5)
    assert middle["a"].planar.x == pytest.approx(1.0)
    assert abs(middle["a"].planar.yaw) == pytest.approx(np.pi)  # the short way round
    assert middle["b"].planar.x == pytest.approx(5.0)
