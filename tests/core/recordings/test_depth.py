"""Depth images and Livox messages of bags like those of rovers."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.params import parse_condition
from gpgrad_core.recordings.recording import RecordingSources
from tests.support.drive import make_drive
from tests.support.recordings import refused
from tests.support.sensor_bags import write_baseprod, write_livox, write_realsense
from tests.support.stereo import SIZE


@pytest.mark.parametrize("form", ["16UC1", "32FC1", "packed 16UC1", "packed 32FC1"])
def test_depth_images(form: str, tmp_path: Path) -> None:
    recording = open_recording(write_realsense(tmp_path / "a", form=form))
    assert len(recording) == 3
    (scan,) = recording.read(1, 2)
    assert scan.std is None
    assert len(scan.points) == SIZE[0] * (SIZE[1] - 4)
    assert np.abs(recording.sensor(1).apply(scan.points)[:, 2]).max() < 2e-3


def test_a_bag_like_baseprod(tmp_path: Path) -> None:
    """Depths without CameraInfo or odometry: both come from files."""
    write_baseprod(tmp_path / "log")
    poses, mount = tmp_path / "poses.txt", tmp_path / "mount.txt"
    sources = RecordingSources(poses=poses, mount=mount)
    refused(tmp_path / "log", "no calibration", "--calibration FILE", sources=sources)
    camera = tmp_path / "depth.yaml"
    sources = RecordingSources(poses=poses, mount=mount, calibration=(camera,))
    recording = open_recording(tmp_path / "log", sources)
    (scan,) = recording.read(2, 3)
    assert np.abs(recording.sensor(2).apply(scan.points)[:, 2]).max() < 2e-3
    assert recording.truth is not None


@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
def test_livox(package: str, tmp_path: Path) -> None:
    drive = make_drive(num_scans=4, points_a_scan=60)
    path = tmp_path / ("a.bag" if package == "livox_ros_driver" else "a")
    write_livox(path, drive.scans, drive.sensor, package)
    recording = open_recording(path)
    for scan, driven_points in zip(recording.read(0, 4), drive.scans, strict=True):
        np.testing.assert_allclose(scan.points, driven_points, rtol=0, atol=1e-5)
    keep = RecordingSources(keep=(parse_condition("reflectivity>=32"),))
    (scan,) = open_recording(path, keep).read(0, 1)
    np.testing.assert_allclose(scan.points, drive.scans[0][30:], rtol=0, atol=1e-5)
    refused(path, "no field ring", keep=(parse_condition("ring>1"),))
