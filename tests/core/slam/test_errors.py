"""Trajectory errors are evo's, and heights where submaps overlap tell of wrong poses."""

import numpy as np
import pytest
from evo.core import metrics, trajectory
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import measure_consistency, trajectory_error
from gpgrad_core.slam.graph import odometry_poses
from gpgrad_core.types import Submap
from tests.core.slam.simulated import simulate
from tests.support.ground import Ground
from tests.support.laws import examples


def theirs(poses: dict[str, Pose]) -> trajectory.PosePath3D:
    quaternions = [pose.quaternion[[3, 0, 1, 2]] for pose in poses.values()]
    places = [pose.translation for pose in poses.values()]
    return trajectory.PosePath3D(np.array(places), np.array(quaternions))


def rmse(
    metric: metrics.PE, true: dict[str, Pose], found: dict[str, Pose], *, align: bool
) -> float:
    reference, estimate = theirs(true), theirs(found)
    if align:
        estimate.align(reference)
    metric.process_data((reference, estimate))
    return float(metric.get_statistic(metrics.StatisticsType.rmse))


@pytest.mark.parametrize("seed", range(3))
def test_errors_are_those_of_evo(seed: int) -> None:
    traverse = simulate(40, seed)
    true, found = traverse.true_poses, odometry_poses(traverse.dataset)
    ours = trajectory_error(true, found)
    place, turn = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad
    step = metrics.Unit.frames
    for own, metric, align in (
        (ours.absolute, metrics.APE(place), True),
        (ours.absolute_unaligned, metrics.APE(place), False),
        (ours.relative, metrics.RPE(place, 1, step), False),
        (ours.relative_turn, metrics.RPE(turn, 1, step), False),
    ):
        assert own == pytest.approx(rmse(metric, true, found, align=align))
    assert ours.absolute_median <= ours.absolute_most
    assert ours.absolute <= ours.absolute_unaligned


SMALL = simulate(12, row=4)


@examples(25)
@given(x=st.floats(-100, 100), yaw=st.floats(-3, 3), z=st.floats(-10, 10))
def test_the_frame_of_the_world_does_not_matter(x: float, yaw: float, z: float) -> None:
    found = odometry_poses(SMALL.dataset)
    frame = Pose.from_planar(SE2(x, -x, yaw), z)
    moved = {name: frame @ pose for name, pose in found.items()}
    here, there = (trajectory_error(SMALL.true_poses, poses) for poses in (found, moved))
    assert there.absolute == pytest.approx(here.absolute, abs=1e-9)
    assert there.relative == pytest.approx(here.relative, abs=1e-9)
    assert there.relative_turn == pytest.approx(here.relative_turn, abs=1e-9)


def test_the_truth_has_no_error_even_on_a_line() -> None:
    line = {str(k): Pose.from_planar(SE2(5.0 * k, 0.0, 0.0)) for k in range(4)}
    none = trajectory_error(line, line)
    assert max(none.absolute, none.absolute_unaligned, none.relative, none.relative_turn) < 1e-7


def test_poses_that_only_one_has_are_left_out() -> None:
    traverse = simulate(10, row=5)
    found = odometry_poses(traverse.dataset)
    true = traverse.dataset.true_poses
    assert trajectory_error(true, found).count == 10
    del true["0003"]
    assert trajectory_error(true, found).count == 9
    with pytest.raises(InputError, match="found 0"):
        trajectory_error({}, found)


POSES = {f"{k}": Pose.from_planar(SE2(1.5 * k, 0.0, 0.3 * k)) for k in range(3)}


def submaps() -> list[Submap]:
    rng, ground = np.random.default_rng(0), Ground.random(2)
    clouds = []
    for name, pose in POSES.items():
        xy = rng.uniform(-2, 2, (4000, 2)) + pose.translation[:2]
        points = np.column_stack([xy, ground.height(xy)])
        clouds.append(Submap.from_points(pose.inverse().apply(points), name))
    return clouds


def test_true_poses_leave_next_to_no_difference() -> None:
    found = measure_consistency(iter(submaps()), POSES)
    assert found.count == 3
    assert found.median < 0.02


def test_a_wrong_height_shows() -> None:
    raised = Pose(POSES["2"].translation + np.array([0, 0, 0.5]), POSES["2"].quaternion)
    found = measure_consistency(submaps(), POSES | {"2": raised})
    assert found.median == pytest.approx(0.5, abs=0.02)
    assert found.high >= found.median


def test_apart_there_is_nothing_to_compare() -> None:
    apart = {name: Pose.from_planar(SE2(50.0 * int(name))) for name in POSES}
    assert measure_consistency(submaps(), apart).median is None
    assert measure_consistency(submaps(), {"0": POSES["0"]}).count == 0
