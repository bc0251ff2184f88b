"""The ROS 2 example closes loops, without ROS; the node itself is only compiled."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import gpgrad_core as gg
from tests.end_to_end.process import ROOT

FOLDER = ROOT / "assets" / "examples" / "ros2_node"
PARAMS = gg.PipelineParams(map=gg.MapParams(resolution=0.05))


@pytest.fixture(scope="module")
def closing() -> ModuleType:
    """The example's module, which lies in no package."""
    spec = importlib.util.spec_from_file_location("closing", FOLDER / "closing.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["closing"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_scans_become_submaps_that_close_loops(closing: Any) -> None:
    pytest.importorskip("gtsam", reason="GTSAM has no wheels for this system")
    demo = gg.load_dataset(gg.demo_path())
    truth = {submap.id: submap.pose_true for submap in demo.submaps}
    closer = closing.ScanCloser(length=0.85, voxel=0.01, params=PARAMS)
    closures: list[Any] = []
    chosen = [demo.submaps[k] for k in (1, 2, 8)]
    for submap in chosen:
        assert submap.pose_odometry is not None
        for k, part in enumerate(np.array_split(submap.points, 4)):
            # The sensor sees its part from a place of its own, tilted.
            tilt = gg.Pose(np.array([0.3 * k, 0.0, 0.1]), np.array([0.1, 0.0, 0.0, 0.99**0.5]))
            T_odom_sensor = closing.level(submap.pose_odometry) @ tilt
            closures += closer.add(tilt.inverse().apply(part), T_odom_sensor)
    assert closures
    for closure in closures:
        query, database = (chosen[int(name)] for name in (closure.query, closure.database))
        a, b = truth[query.id], truth[database.id]
        assert a is not None
        assert b is not None
        # The submap's frame lies at the first scan's sensor, 0.1 m above that of the dataset.
        true = b.inverse() @ a
        assert closure.position[:2] == pytest.approx(true.translation[:2], abs=0.15)
        covariance = np.reshape(closure.covariance, (6, 6))
        np.testing.assert_array_equal(covariance, covariance.T)
        assert covariance[5, 5] > 0
        assert covariance[3, 3] == 0
    assert list(closer.poses) == ["0000", "0001", "0002"]
    closer.close()


def test_scans_without_ground_make_no_submap(closing: Any) -> None:
    closer = closing.ScanCloser(length=0.5)
    pose = gg.Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    nothing = np.full((5, 3), np.nan)
    assert list(closer.add(nothing, pose)) == []
    further = gg.Pose(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]))
    assert list(closer.add(nothing, further)) == []
    assert list(closer.finish()) == []
    closer.close()


def test_points_are_thinned_and_poses_levelled(closing: Any) -> None:
    points = np.array([[0.01, 0.0, 0.0], [0.02, 0.0, 0.0], [0.2, 0.0, 0.0]])
    np.testing.assert_array_equal(closing.thinned(points, 0.1), points[[0, 2]])
    tilted = gg.Pose(np.array([1.0, 2.0, 3.0]), np.array([0.3, 0.1, 0.2, 0.9]) / 0.95**0.5)
    level = closing.level(tilted)
    assert level.planar.yaw == pytest.approx(tilted.planar.yaw)
    np.testing.assert_allclose(level.apply(np.array([[0.0, 0.0, 1.0]])), [[1.0, 2.0, 4.0]])


def test_the_node_is_sound_as_far_as_can_be_told_without_ros() -> None:
    for file in sorted(Path(FOLDER).glob("*.py")):
        compile(file.read_text(encoding="utf-8"), str(file), "exec")
