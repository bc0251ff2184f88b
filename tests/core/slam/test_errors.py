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
from tests.core.slam.simulated import Traverse, simulate
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


TRAVERSES = [simulate(12, seed, row=4) for seed in range(3)]


@examples(25)
@given(st.sampled_from(TRAVERSES), st.floats(-100, 100), st.floats(-3, 3), st.floats(-10, 10))
def test_errors_are_those_of_evo_wherever_the_frame_lies(
    traverse: Traverse, x: float, yaw: float, z: float
) -> None:
    frame = Pose.from_planar(SE2(x, -x, yaw), z)
    true = traverse.true_poses
    found = {name: frame @ pose for name, pose in odometry_poses(traverse.dataset).items()}
    ours = trajectory_error(true, found)
    place, turn = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_rad
    step = metrics.Unit.frames
    for own, metric, align in (
        (ours.absolute, metrics.APE(place), True),
        (ours.absolute_unaligned, metrics.APE(place), False),
        (ours.relative, metrics.RPE(place, 1, step), False),
        (ours.relative_turn, metrics.RPE(turn, 1, step), False),
    ):
        assert own == pytest.approx(rmse(metric, true, found, align=align), abs=1e-9)
    assert ours.absolute_median <= ours.absolute_most
    assert ours.absolute <= ours.absolute_unaligned


def test_the_truth_has_no_error_even_on_a_line() -> None:
    line = {str(k): Pose.from_planar(SE2(5.0 * k, 0.0, 0.0)) for k in range(4)}
    none = trajectory_error(line, line)
    assert max(none.absolute, none.absolute_unaligned, none.relative, none.relative_turn) < 1e-7


def test_poses_that_only_one_has_are_left_out() -> None:
    dataset = TRAVERSES[0].dataset
    found, true = odometry_poses(dataset), dataset.true_poses
    assert trajectory_error(true, found).count == 12
    del true["0003"]
    assert trajectory_error(true, found).count == 11
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


def test_heights_of_common_ground_differ_by_what_is_wrong_of_the_poses() -> None:
    found = measure_consistency(iter(submaps()), POSES)
    assert found.count == 3
    assert found.median < 0.02
    raised = Pose(POSES["2"].translation + np.array([0, 0, 0.5]), POSES["2"].quaternion)
    found = measure_consistency(submaps(), POSES | {"2": raised})
    assert found.median == pytest.approx(0.5, abs=0.02)
    assert found.high >= found.median
    apart = {name: Pose.from_planar(SE2(50.0 * int(name))) for name in POSES}
    assert measure_consistency(submaps(), apart).median is None
    assert measure_consistency(submaps(), {"0": POSES["0"]}).count == 0
