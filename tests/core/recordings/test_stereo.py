"""Image pairs, depth images and Livox messages become points; wrong ones say so in a line."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.errors import InputError
from gpgrad_core.recordings.build import is_recording, open_recording
from gpgrad_core.recordings.cameras import CameraModel, read_camera
from gpgrad_core.recordings.params import parse_condition
from gpgrad_core.recordings.recording import Recording, RecordingSources
from gpgrad_core.recordings.stereo import make_rig
from gpgrad_core.recordings.trajectory import Poses
from tests.support.bags import BagWriter
from tests.support.drive import assert_same_poses, make_drive
from tests.support.image_folders import (
    numbers,
    stamps_of,
    write_euroc,
    write_image,
    write_kitti,
    write_madmax,
    write_poses,
)
from tests.support.recordings import refused
from tests.support.refusal import assert_file_refused, assert_refused
from tests.support.sensor_bags import write_baseprod, write_livox, write_realsense
from tests.support.stereo import BASELINE, MOUNT, SIZE, driven, level_pair, projection


def assert_level(recording: Recording, scan: int, height: float = 0.0, off: float = 0.03) -> None:
    """The points of a scan lie on the plane, where and as closely as they claim."""
    (seen,) = recording.read(scan, scan + 1)
    assert len(seen.points) > 2_000
    assert seen.std is not None
    placed = recording.sensor(scan).apply(seen.points)
    up = 1 if recording.up == "-y" else 2
    z = -placed[:, 1] if up == 1 else placed[:, 2]
    error, ranges = z - height, np.linalg.norm(seen.points, axis=1)
    assert np.sqrt(np.mean(error**2)) < off
    # Across level ground a ray's error counts as much as it goes down.
    claimed = seen.std / ranges
    assert 0.1 < np.sqrt(np.mean(error**2) / np.mean(claimed**2)) < 1.5
    near = ranges < np.median(ranges)
    assert seen.std[near].mean() < 0.5 * seen.std[~near].mean()


@pytest.mark.parametrize("write", [write_kitti, write_euroc, write_madmax])
def test_folders(write: Callable[[Path], Path], tmp_path: Path) -> None:
    folder = write(tmp_path / "run")
    assert is_recording(folder)
    recording = open_recording(folder)
    assert len(recording) == 3
    kitti = write is write_kitti
    # KITTI's world is the first camera, a metre above the ground.
    assert_level(recording, 1, -1.0 if kitti else 0.0)
    if not kitti:
        assert_same_poses(recording.body, driven(3), 1e-4)
        assert_same_poses(recording.mount, MOUNT)
        assert recording.notes[-1].startswith("the poses are the true ones")
        poses = RecordingSources(poses=write_poses(tmp_path / "slam.txt", driven(2)))
        again = open_recording(folder, poses)
        assert len(again) == 2
        assert again.truth is not None


def bag_of_pairs(
    path: Path,
    *,
    ros1: bool = False,
    storage: str = "mcap",
    packed: bool = False,
    delay: float = 0.0,
    calibrated: bool = True,
    swap: bool = False,
) -> Path:
    with BagWriter(path, ros1=ros1, storage=storage) as bag:
        frame = "camera_left_optical"
        bag.transform(stamps_of(1)[0], "base_link", frame, MOUNT, 0, topic="/tf_static")
        for k, stamp in enumerate(stamps_of(3)):
            bag.odometry("/odom", stamp, driven(3), k, variance=0.01 * k)
            images = level_pair(k)[:: -1 if swap else 1]
            for name, image in zip(("left", "right"), images, strict=True):
                at = stamp + (delay if name == "right" else 0.0)
                topic = f"/stereo/{name}/image_rect"
                if calibrated:
                    p = projection(name == "right")
                    bag.camera(f"/stereo/{name}/camera_info", at, frame, SIZE, p)
                if packed:
                    content = cv2.imencode(".png", image)[1].tobytes()
                    bag.packed(f"{topic}/compressed", at, frame, content, "mono8; png compressed ")
                else:
                    bag.image(topic, at, frame, image, "mono8")
    return path


@pytest.mark.parametrize(
    ("ros1", "storage", "packed"),
    [(True, "", False), (False, "mcap", True), (False, "sqlite3", False)],
)
def test_bags(ros1: bool, storage: str, packed: bool, tmp_path: Path) -> None:
    path = tmp_path / ("a.bag" if ros1 else "a")
    recording = open_recording(bag_of_pairs(path, ros1=ros1, storage=storage, packed=packed))
    assert len(recording) == 3
    assert_same_poses(recording.mount[:1], MOUNT)
    assert_level(recording, 2)
    assert recording.covariance is not None


def test_what_is_wrong_with_a_bag(tmp_path: Path) -> None:
    swapped = open_recording(bag_of_pairs(tmp_path / "swapped", swap=True))
    assert_refused(lambda: list(swapped.read(0, 1)), "message 0", "the cameras are swapped")
    late = bag_of_pairs(tmp_path / "late", delay=0.2)
    refused(late, "0.200 s apart", "/stereo/left", "/stereo/right")
    good, topic = bag_of_pairs(tmp_path / "good"), "/stereo/left/image_rect"
    right = topic.replace("left", "right")
    for sources, *said in (
        (RecordingSources(cloud_topic=right, right_topic=topic), "the cameras are swapped", "left"),
        (RecordingSources(right_topic=right), "--right-topic", "--cloud-topic"),
        (RecordingSources(cloud_topic="/nothing"), "/nothing", topic),
        (RecordingSources(cloud_topic="/odom", right_topic=right), "/odom: is not a topic of im"),
    ):
        assert_refused(lambda sources=sources: open_recording(good, sources), *said)


def test_calibrations_of_files(tmp_path: Path) -> None:
    bare = bag_of_pairs(tmp_path / "bare", calibrated=False)
    refused(bare, "/stereo/left/image_rect has no calibration", "--calibration")
    files = [tmp_path / "left.yaml", tmp_path / "right.yaml"]
    for right, file in enumerate(files):
        k, p = (numbers(m) for m in (projection()[:, :3], projection(right == 1)))
        file.write_text(
            f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: nav\n"
            f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{k}]\n"
            "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
            "  data: [0, 0, 0, 0, 0]\nrectification_matrix:\n  rows: 3\n  cols: 3\n"
            "  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
            f"projection_matrix:\n  rows: 3\n  cols: 4\n  data: [{p}]\n"
        )
    assert_level(open_recording(bare, RecordingSources(calibration=tuple(files))), 0)
    refused(bare, "2 cameras need as many files, got 1", calibration=(files[0],))
    files[0].write_text(files[0].read_text().replace(f"width: {SIZE[0]}", "width: 640"))
    wrong = open_recording(bare, RecordingSources(calibration=tuple(files)))
    assert_refused(lambda: list(wrong.read(0, 1)), "240 x 180", "640 x 180", "left.yaml")


def test_wrong_calibrations(tmp_path: Path) -> None:
    cases = {
        "K: [1, 2]": "K must have 9 numbers, it has 2",
        "K: [0, 0, 1, 0, 0, 1, 0, 0, 1]": "no focal length of 1 pixel or more",
        "K: [5, 0, 1, 0, 5, 1, 0, 0, 0]": "K is not of the form fx s cx, 0 fy cy, 0 0 1",
        "distortion_model: fov": "its distortion model is fov",
        "width: 0": "width must be a number of pixels",
        "K: [a, 0, 1, 0, 5, 1, 0, 0, 1]": "not a number",
        "R: [2, 0, 0, 0, 1, 0, 0, 0, 1]": "R",
    }
    good = {
        "width": "width: 4", "height": "height: 3", "D": "D: []",
        "K": "K: [5, 0, 1, 0, 5, 1, 0, 0, 1]",
    }  # fmt: skip
    path = tmp_path / "camera.yaml"
    for line, said in cases.items():
        lines = {**good, line.split(":")[0]: line}
        assert_file_refused(read_camera, path, "\n".join(lines.values()), said)
    path.write_text("\n".join(good.values()))
    camera = read_camera(path)
    assert_refused(lambda: make_rig(camera, camera), "there is no baseline", "P of the right")
    left, right = (
        replace(camera, projection=np.array([[5, 0, x, 0], [0, 5, 1, 0], [0, 0, 1, 0]]) - tx)
        for x, tx in ((1e6, 0.0), (1.0, 0.5 * np.eye(3, 4, 3)))
    )
    image = np.zeros((3, 4), np.uint8)
    apart = make_rig(left, right, rectified=True)
    assert_refused(lambda: apart.scan(image, image, "a pair"), "999999 pixels apart", "4 wide")


def test_wrong_folders(tmp_path: Path) -> None:
    kitti = write_kitti(tmp_path / "kitti")
    (kitti / "calib.txt").rename(kitti / "away")
    refused(kitti, "kitti", "no calib.txt")
    (kitti / "calib.txt").write_text("P0: 1 2 3\n")
    refused(kitti, "P0 must have 12 numbers, it has 3")
    madmax = write_madmax(tmp_path / "madmax")
    shutil.rmtree(madmax / "ground_truth")
    refused(madmax, "madmax", "no poses", "--poses FILE")
    for file in (madmax / "img_rect_right").iterdir():
        time = int(file.stem.rsplit("_", 1)[1]) + 250_000_000
        file.rename(file.with_name(f"img_rect_right_{time}.png"))
    refused(madmax, "img_rect_left", "0.250 s apart")
    madmax = write_madmax(tmp_path / "beside")
    sources = RecordingSources(root=madmax)
    open_recording(madmax, sources)
    (madmax / "calibration").rename(tmp_path / "calibration")
    open_recording(madmax)
    refused(madmax, "beside", "has no calibration", sources=sources)
    (madmax / "calibration").symlink_to(tmp_path / "calibration", target_is_directory=True)
    refused(madmax, "beside", "has no calibration", sources=sources)
    euroc = write_euroc(tmp_path / "euroc")
    small = euroc / "mav0" / "cam1" / "data"
    for file in small.iterdir():
        write_image(file, np.zeros((90, 120), np.uint8))
    wrong = open_recording(euroc)
    assert_refused(lambda: list(wrong.read(0, 1)), "120 x 90", "sensor.yaml", "240 x 180")


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


@pytest.mark.parametrize(
    ("fisheye", "distortion"),
    [
        (False, (-0.2, 0.05, 0.001, -0.001, 0.0)),
        (False, (0.1, 0.02, 0.0, 0.0, 0.0, 0.25, 0.01, 0.0)),
        (True, (-0.02, 0.01, 0.0, 0.0)),
    ],
)
def test_pairs_that_are_not_rectified(fisheye: bool, distortion: tuple[float, ...]) -> None:
    """Both cameras are turned and bent; the points are those of the frame of the left one."""
    matrix = np.array([[240.0, 0, 118.0], [0, 238.0, 92.0], [0, 0, 1]])
    bent = np.array(distortion)
    turns = [Rotation.from_euler("xyz", t) for t in ([-0.35, 0.02, 0.01], [-0.36, -0.01, 0.0])]
    columns, rows = np.meshgrid(*(np.arange(n, dtype=np.float64) for n in SIZE))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    undo = cv2.fisheye.undistortPoints if fisheye else cv2.undistortPoints
    rays = np.column_stack([undo(pixels, matrix, bent).reshape(-1, 2), np.ones(len(pixels))])
    texture = plane_texture(np.random.default_rng(0))
    images = []
    for side, turn in enumerate(turns):
        seen = turn.apply(rays)  # in axes that look ahead: x right, y down
        depth = 1.0 / np.maximum(seen[:, 1], 1e-3)
        x, y = BASELINE * side + depth * seen[:, 0], depth * seen[:, 2]
        at = np.stack([100 * x + 500, 100 * y]).astype(np.float32).reshape(2, *SIZE[::-1])
        image = cv2.remap(texture, *at, cv2.INTER_CUBIC)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    cameras = [CameraModel(name, SIZE, matrix, bent, fisheye) for name in ("left", "right")]
    aside = turns[0].inv().apply([BASELINE, 0.0, 0.0])
    between = Poses(aside[None], Rotation.from_matrix([(turns[0].inv() * turns[1]).as_matrix()]))
    scan = make_rig(*cameras, between).scan(*images, "the pair")
    level = turns[0].apply(scan.points)
    assert len(level) > 1_500
    assert abs(np.median(level[:, 1]) - 1.0) < 0.01
    assert np.sqrt(np.mean((level[:, 1] - 1.0) ** 2)) < 0.05
    swapped = Poses(-between.translation, between.rotation)
    with pytest.raises(InputError, match="the cameras are swapped"):
        make_rig(*cameras, swapped)


def plane_texture(rng: np.random.Generator) -> np.ndarray:
    """Make the plane's texture, a centimetre a pixel, coarser far away."""
    fine = cv2.GaussianBlur(rng.normal(size=(1600, 1000)).astype(np.float32), (0, 0), 1.2)
    coarse = cv2.GaussianBlur(rng.normal(size=(1600, 1000)).astype(np.float32), (0, 0), 5.0)
    both = fine / fine.std() + coarse / coarse.std()
    return (128 + 25 * both).astype(np.float32)
