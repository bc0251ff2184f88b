"""The pose at any time: laws of motions, and of what lies between two of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_pose_file, read_times
from gpgrad_core.recordings.trajectory import Poses, Trajectory
from tests.support.drive import assert_same_poses
from tests.support.laws import examples
from tests.support.refusal import assert_refused


def random_poses(seed: int, count: int) -> Poses:
    rng = np.random.default_rng(seed)
    return Poses(rng.normal(size=(count, 3)), Rotation.random(count, rng=rng))


@examples(20)
@given(seed=st.integers(0, 2**32 - 1))
def test_motions_are_a_group(seed: int) -> None:
    a, b, c = (random_poses(seed + k, 3) for k in range(3))
    assert_same_poses((a @ b) @ c, a @ (b @ c))
    assert_same_poses((a @ b).inverse(), b.inverse() @ a.inverse())
    points = np.random.default_rng(seed).normal(size=(5, 3))
    in_turn = a.one(0).apply(b.one(0).apply(points))
    np.testing.assert_allclose((a @ b).one(0).apply(points), in_turn, atol=1e-9)


@examples(20)
@given(
    speed=st.floats(-3, 3),
    turning=st.floats(-1, 1),
    wanted=st.lists(st.floats(0, 9), min_size=1, max_size=20),
)
def test_a_steady_motion_is_met_exactly(speed: float, turning: float, wanted: list[float]) -> None:
    """Straight at a constant speed, turning at a constant rate: what interpolation assumes."""
    stamps = np.arange(10.0)

    def moving(times: np.ndarray) -> Poses:
        yaw = turning * times
        return Poses(
            np.outer(times, [speed, 1.0, -0.5]),
            Rotation.from_euler("ZYX", np.column_stack([yaw, np.full((len(yaw), 2), 0.1)])),
        )

    times = np.array(wanted)
    located = Trajectory(stamps, moving(stamps)).at(times, BuildParams(max_time_difference=1.0))
    assert located.known.all()
    assert_same_poses(located.poses, moving(times))


def test_how_far_a_pose_may_be() -> None:
    poses = random_poses(1, 3)
    trajectory = Trajectory(np.array([0.0, 1.0, 5.0]), poses)
    wanted = np.array([-0.3, -0.1, 0.4, 0.95, 3.0, 4.95, 5.19, 5.3])
    located = trajectory.at(wanted, BuildParams(max_time_difference=0.2))
    assert located.known.tolist() == [False, True, False, True, False, True, True, False]
    # Beyond an end the last pose stands in.
    assert_same_poses(located.poses[6:7], poses[2:3])
    nearest = BuildParams(pose_matching="nearest", max_time_difference=9)
    at_nearest = trajectory.at(wanted, nearest)
    assert_same_poses(at_nearest.poses, poses[np.array([0, 0, 0, 1, 1, 2, 2, 2])])
    for params in (BuildParams(), replace(nearest, max_time_difference=0.1)):
        single = Trajectory(np.array([7.0]), poses[:1]).at(np.array([7.05, 7.2]), params)
        assert single.known.tolist() == [True, False]
        assert_same_poses(single.poses[:1], poses[:1])


def test_order_and_repeats() -> None:
    poses = random_poses(2, 4)
    trajectory = Trajectory.in_order(np.array([2.0, 1.0, 2.0, 0.0]), poses)
    assert trajectory.stamps.tolist() == [0.0, 1.0, 2.0]
    assert_same_poses(trajectory.poses, poses[np.array([3, 1, 0])])


def test_nanoseconds_without_leading_zeros_are_told_from_decimals(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    parts = [*range(12_345_678, 900_000_000, 97_000_001), 912_345_670]
    for width in ("", "09"):
        path.write_text("".join(f"1700000000.{k:{width}} 0 0 0 0 0 0 1\n" for k in parts))
        expected = 1.7e9 + 1e-9 * np.array(parts)
        np.testing.assert_allclose(read_pose_file(path).trajectory.stamps, expected, atol=1e-6)
        np.testing.assert_allclose(read_times(path), expected, atol=1e-6)
    path.write_text("1700000000.12345678 0 0 0 0 0 0 1\n1700000000.5 1 0 0 0 0 0 1\n")
    assert_refused(lambda: read_times(path), str(path), "decimals of a second or nanoseconds")
