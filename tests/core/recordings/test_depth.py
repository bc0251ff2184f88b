"""Depth images and Livox messages of bags like those of rovers."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.params import BuildParams, parse_condition
from gpgrad_core.recordings.recording import RecordingSources
from tests.support.bags import BagWriter
from tests.support.drive import make_drive
from tests.support.image_folders import stamps_of, write_poses
from tests.support.refusal import assert_refused
from tests.support.stereo import MOUNT, SIZE, driven, level_depths, level_pair, projection

FRAME = "camera_depth_optical_frame"


def compressed(depths: np.ndarray, a: float = 0.0, b: float = 0.0) -> bytes:
    """Pack depths as image_transport's compressedDepth does."""
    return struct.pack("<i2f", 0, a, b) + cv2.imencode(".png", depths)[1].tobytes()


def write_depths(path: Path, form: str, *, calibrated: bool = True) -> Path:
    """Write a bag of a RealSense on a rover, with its odometry."""
    metres = level_depths()
    metres[:4] = 0.0
    millimetres = np.rint(1000 * metres).astype(np.uint16)
    topic = "/camera/aligned_depth_to_color/image_raw"
    with BagWriter(path, ros1=False, storage="mcap") as bag:
        bag.transform(stamps_of(1)[0], "base_link", FRAME, MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(stamps_of(3)):
            bag.odometry("/odom", stamp, driven(3), k)
            bag.image("/camera/color/image_raw", stamp, FRAME, level_pair(k)[0], "mono8")
            if calibrated:
                info = topic.replace("image_raw", "camera_info")
                bag.camera(info, stamp, FRAME, SIZE, projection())
            if form == "16UC1":
                bag.image(topic, stamp, FRAME, millimetres, form)
            elif form == "32FC1":
                gaps = np.where(metres > 0, metres, np.nan).astype(np.float32)
                bag.image(topic, stamp, FRAME, gaps, form)
            elif form == "packed 16UC1":
                content = compressed(millimetres)
                bag.packed(
                    f"{topic}/compressedDepth", stamp, FRAME, content, "16UC1; compressedDepth png"
                )
            else:
                inverse = np.where(metres > 0, 40_000 / np.maximum(metres, 0.1) + 1, 0)
                content = compressed(np.rint(inverse).astype(np.uint16), 40_000, 1.0)
                bag.packed(
                    f"{topic}/compressedDepth", stamp, FRAME, content, "32FC1; compressedDepth"
                )
    return path


@pytest.mark.parametrize("form", ["16UC1", "32FC1", "packed 16UC1", "packed 32FC1"])
def test_depth_images(form: str, tmp_path: Path) -> None:
    recording = open_recording(write_depths(tmp_path / "a", form))
    assert len(recording) == 3
    (scan,) = recording.read(1, 2)
    assert scan.std is None
    assert len(scan.points) == SIZE[0] * (SIZE[1] - 4)
    sensor = recording.sensor(1)
    z = (sensor.rotation.apply(scan.points) + sensor.translation)[:, 2]
    assert np.abs(z).max() < 2e-3
    build_dataset(tmp_path / "a", tmp_path / "out", BuildParams(max_range=6.0))
    assert (tmp_path / "out" / "submaps" / "000.ply").exists()


def test_a_bag_like_baseprod(tmp_path: Path) -> None:
    """Depths without CameraInfo or odometry: both come from files."""
    metres = np.rint(1000 * level_depths()).astype(np.uint16)
    with BagWriter(tmp_path / "log", ros1=False, storage="mcap") as bag:
        bag.transform(stamps_of(1)[0], "base_link", FRAME, MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(stamps_of(3)):
            for side, image in zip(("left", "right"), level_pair(k), strict=True):
                bag.image(f"/throttle/nav_cam/{side}/image_raw", stamp, "nav", image, "bayer_gbrg8")
            topic = "/throttle/camera/depth/image_rect_raw"
            bag.image(topic, stamp, FRAME, metres, "16UC1")
            bag.fix("/gnss", stamp, (42.2 + 1e-6 * k, -1.5, 300.0))
    poses = write_poses(tmp_path / "poses.txt", 3)
    mount = tmp_path / "mount.txt"
    numbers = [*MOUNT.translation[0], *MOUNT.rotation[0].as_quat()]
    mount.write_text(" ".join(map(str, numbers)))
    sources = RecordingSources(poses=poses, mount=mount)
    assert_refused(
        lambda: open_recording(tmp_path / "log", sources), "no calibration", "--calibration FILE"
    )
    camera = tmp_path / "depth.yaml"
    k = ", ".join(map(str, projection()[:, :3].ravel()))
    camera.write_text(f"width: {SIZE[0]}\nheight: {SIZE[1]}\nK: [{k}]\n")
    sources = RecordingSources(poses=poses, mount=mount, calibration=(camera,))
    recording = open_recording(tmp_path / "log", sources)
    (scan,) = recording.read(2, 3)
    sensor = recording.sensor(2)
    z = (sensor.rotation.apply(scan.points) + sensor.translation)[:, 2]
    assert np.abs(z).max() < 2e-3
    assert recording.truth is not None


@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
def test_livox(package: str, tmp_path: Path) -> None:
    drive = make_drive(num_scans=4, points_a_scan=60)
    ros1 = package == "livox_ros_driver"
    path = tmp_path / ("a.bag" if ros1 else "a")
    with BagWriter(path, ros1=ros1) as bag:
        for k, stamp in enumerate(drive.stamps):
            bag.stamped("/pose", stamp, drive.sensor, k)
            points = np.vstack([np.zeros((2, 3)), drive.scans[k]])
            bag.livox("/livox/lidar", stamp, "livox_frame", points, package)
    recording = open_recording(path)
    for scan, driven_points in zip(recording.read(0, 4), drive.scans, strict=True):
        np.testing.assert_allclose(scan.points, driven_points, rtol=0, atol=1e-5)
    keep = RecordingSources(keep=(parse_condition("reflectivity>=32"),))
    (scan,) = open_recording(path, keep).read(0, 1)
    np.testing.assert_allclose(scan.points, drive.scans[0][30:], rtol=0, atol=1e-5)
    unknown = RecordingSources(keep=(parse_condition("ring>1"),))
    assert_refused(lambda: list(open_recording(path, unknown).read(0, 1)), "no field ring")
