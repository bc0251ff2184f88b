"""The pose at any time, where submaps end, and which way is up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.level import estimate_up, ground_normal, rotation_to_z, up_axis
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_pose_file, read_times
from gpgrad_core.recordings.trajectory import FrameTree, Poses, Trajectory, cut
from gpgrad_core.se2 import Pose, level_pose
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


def test_a_frame_in_another_is_found_over_their_common_one() -> None:
    parents = {"lidar": "arm", "arm": "map", "camera": "mast", "mast": "map"}
    random = random_poses(0, 4)
    poses = {name: random.one(k) for k, name in enumerate(parents)}
    edges = {
        name: Trajectory(np.zeros(1), Poses.of(pose), fixed=True) for name, pose in poses.items()
    }
    found = FrameTree(parents, edges).between("camera", "lidar", np.zeros(1), BuildParams())
    assert found is not None
    points = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_allclose(
        poses["mast"].apply(poses["camera"].apply(found.poses.one(0).apply(points))),
        poses["arm"].apply(poses["lidar"].apply(points)),
        atol=1e-12,
    )


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
    assert located.valid.all()
    assert_same_poses(located.poses, moving(times))


def test_how_far_a_pose_may_be() -> None:
    poses = random_poses(1, 3)
    trajectory = Trajectory(np.array([0.0, 1.0, 5.0]), poses)
    wanted = np.array([-0.3, -0.1, 0.4, 0.95, 3.0, 4.95, 5.19, 5.3])
    located = trajectory.at(wanted, BuildParams(max_time_difference=0.2))
    assert located.valid.tolist() == [False, True, False, True, False, True, True, False]
    # Beyond an end the last pose stands in.
    assert_same_poses(located.poses[6:7], poses[2:3])
    nearest = BuildParams(pose_matching="nearest", max_time_difference=9)
    at_nearest = trajectory.at(wanted, nearest)
    assert_same_poses(at_nearest.poses, poses[np.array([0, 0, 0, 1, 1, 2, 2, 2])])
    for params in (BuildParams(), replace(nearest, max_time_difference=0.1)):
        single = Trajectory(np.array([7.0]), poses[:1]).at(np.array([7.05, 7.2]), params)
        assert single.valid.tolist() == [True, False]
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


def drive(xy: np.ndarray, yaw: np.ndarray | float = 0.0) -> Poses:
    turn = Rotation.from_rotvec(np.outer(np.broadcast_to(yaw, len(xy)), [0.0, 0.0, 1.0]))
    return Poses(np.column_stack([xy, np.zeros(len(xy))]), turn)


def straight(length: float, step: float) -> Poses:
    along = np.arange(0.0, length, step)
    return drive(np.column_stack([along, np.zeros(len(along))]))


@examples(20)
@given(
    seed=st.integers(0, 2**32 - 1),
    max_length=st.floats(0.3, 10.0),
    max_time=st.one_of(st.none(), st.floats(0.5, 20.0)),
)
def test_every_scan_is_in_one_submap(seed: int, max_length: float, max_time: float | None) -> None:
    rng = np.random.default_rng(seed)
    poses = drive(np.cumsum(rng.normal(0, 0.2, (80, 2)), axis=0))
    stamps = np.cumsum(rng.uniform(0.01, 0.5, 80))
    params = BuildParams(max_length=max_length, max_time=max_time)
    pieces = cut(stamps, poses, params)
    assert [k for piece in pieces for k in piece] == list(range(80))
    assert all(len(piece) for piece in pieces)
    steps = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
    for piece in pieces:
        # Up to its last scan nothing was reached.
        assert steps[piece.start : piece.stop - 1].sum() < max_length + 80 * 0.05
        if max_time is not None:
            assert stamps[piece.stop - 1] - stamps[piece.start] < max_time


@pytest.mark.parametrize(
    ("params", "stamps", "poses", "starts"),
    [
        (BuildParams(max_length=2.5), np.arange(100.0), straight(10.0, 0.1), [0, 25, 50, 75]),
        (
            BuildParams(max_length=None, max_turn=0.8),
            np.arange(25.0),
            drive(np.zeros((25, 2)), np.linspace(3.0, 3.0 + 2.4, 25)),  # passes through pi
            [0, 8, 16, 24],
        ),
        (
            BuildParams(max_length=None, max_time=2.0),
            np.arange(0.0, 5.0, 0.5),
            straight(5.0, 0.5),
            [0, 4, 8],
        ),
    ],
    ids=["length", "turn", "time"],
)
def test_each_limit_ends_a_submap(
    params: BuildParams, stamps: np.ndarray, poses: Poses, starts: list[int]
) -> None:
    assert [piece.start for piece in cut(stamps, poses, params)] == starts


def test_a_robot_that_stands_still_drives_nowhere() -> None:
    """Poses tremble by a centimetre at 10 Hz: in an hour that adds up to hundreds of metres."""
    rng = np.random.default_rng(0)
    poses = drive(rng.normal(0, 0.005, (3000, 2)))
    assert len(cut(np.arange(3000.0), poses, BuildParams(max_length=1.0))) == 1


def test_cut_by_uncertainty() -> None:
    """Variance grows by 1 cm² a scan: its root by 5 cm every 25."""
    variance = 1e-4 * np.arange(100.0)
    covariance = variance[:, None, None] * np.diag([0.3, 1.0, 0.2])
    params = BuildParams(max_length=None, max_uncertainty=0.05)
    driven = np.arange(100.0), straight(10.0, 0.1), params
    assert [piece.start for piece in cut(*driven, covariance)] == [0, 25, 50, 75]
    assert_refused(lambda: cut(*driven), "needs poses with covariances")


def test_something_has_to_end_a_submap() -> None:
    assert_refused(lambda: BuildParams(max_length=None), "something has to end a submap")
    assert_refused(lambda: BuildParams(min_range=3.0, max_range=2.0), "above min_range, 3 m")
    with pytest.raises(ValueError, match="max_turn must be from"):
        BuildParams(max_turn=9.0)


UP = np.array([0.0, 0.0, 1.0])


@examples(20)
@given(seed=st.integers(0, 2**32 - 1))
def test_turning_upright_is_the_shortest_turn(seed: int) -> None:
    up = np.random.default_rng(seed).normal(size=3)
    turn = rotation_to_z(up)
    np.testing.assert_allclose(turn.apply(up / np.linalg.norm(up)), UP, atol=1e-9)
    angle = np.arccos(np.clip(up[2] / np.linalg.norm(up), -1, 1))
    assert turn.magnitude() == pytest.approx(angle, abs=1e-7)
    for name in ("x", "-x", "y", "-y", "z", "-z"):
        axis = up_axis(name)
        np.testing.assert_allclose(rotation_to_z(axis).apply(axis), UP, atol=1e-12)


@examples(20)
@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.0, 1.0), roll=st.floats(-1.0, 1.0))
def test_the_level_frame_heads_where_the_body_does(yaw: float, pitch: float, roll: float) -> None:
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    pose = Pose(np.array([1.0, 2.0, 3.0]), turn.as_quat())
    level = level_pose(pose)
    np.testing.assert_allclose(level.rotation[:, 2], UP, atol=1e-12)
    assert level.planar.yaw == pytest.approx(yaw, abs=1e-9)
    np.testing.assert_array_equal(level.translation, pose.translation)
    nadir = Rotation.from_euler("ZYX", [yaw, np.pi / 2, roll])  # a camera that looks down
    level = level_pose(Pose(np.zeros(3), nadir.as_quat()))
    np.testing.assert_allclose(level.rotation[:, 2], UP, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 0.2, 0.6])
def test_the_ground_tells_up_in_spite_of_a_wall(tilt: float) -> None:
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-5, 5, (4000, 2)), rng.normal(-1.2, 0.03, 4000)])
    wall = rng.uniform([4.0, -4.0, -1.2], [4.0, 4.0, 1.0], (600, 3))
    turn = Rotation.from_rotvec([tilt, 0.0, 0.0])
    normal = ground_normal(turn.apply(np.vstack([flat, wall])))
    assert np.degrees(np.arccos(normal @ turn.apply(UP))) < 1.5


def test_slopes_average_out_and_nonsense_is_refused() -> None:
    rng = np.random.default_rng(3)
    normals = list(Rotation.from_rotvec(rng.normal(0, 0.1, (24, 3))).apply(UP))
    up, spread = estimate_up(normals, "drive")
    assert np.degrees(np.arccos(up @ UP)) < 2.5
    assert 0.05 < spread < 0.25
    assert ground_normal(rng.normal(size=(5, 3))) is None
    assert_refused(lambda: estimate_up([], "drive"), "drive: no scan shows enough ground")
    scattered = list(Rotation.random(200, rng=rng).apply(UP))
    assert_refused(lambda: estimate_up(scattered, "drive"), "disagree on the direction up")
