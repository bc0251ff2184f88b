"""Which way is up: from axes, from poses, and from the ground itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.level import estimate_up, ground_normal, rotation_to_z, up_axis
from gpgrad_core.se2 import Pose, level_pose
from tests.support.laws import examples
from tests.support.refusal import assert_refused

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
    wall = np.column_stack(
        [np.full(600, 4.0), rng.uniform(-4, 4, 600), rng.uniform(-1.2, 1.0, 600)]
    )
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
