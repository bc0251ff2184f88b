"""Writes recordings of image pairs as their datasets are: KITTI, EuRoC and MADMAX."""

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.trajectory import Poses
from tests.support.drive import START, tum
from tests.support.stereo import (
    BASELINE,
    CENTRE,
    FOCAL,
    MOUNT,
    SIZE,
    Filmed,
    driven,
    level_drive,
    level_pair,
    projection,
)

PERIOD = 0.5
Pair = tuple[np.ndarray, np.ndarray]


def numbers(values: np.ndarray) -> str:
    return ", ".join(f"{value:.12g}" for value in np.ravel(values))


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def stamps_of(count: int) -> np.ndarray:
    return START + PERIOD * np.arange(count)


def write_kitti(folder: Path, count: int = 3) -> Path:
    """Write a sequence of KITTI: its poses are those of camera 0."""
    for k in range(count):
        for side, image in enumerate(level_pair(k)):
            write_image(folder / f"image_{side}" / f"{k:06d}.png", image)
    rows = [f"P{side}: {numbers(projection(side == 1)).replace(',', '')}" for side in range(2)]
    (folder / "calib.txt").write_text("\n".join(rows))
    (folder / "times.txt").write_text("\n".join(f"{PERIOD * k:e}" for k in range(count)))
    camera = driven(count) @ MOUNT
    # The benchmark's world is the first camera: y points down.
    seen = camera[:1].inverse() @ camera
    matrices = np.concatenate(
        [seen.rotation.as_matrix(), seen.translation[:, :, None]], axis=2
    ).reshape(count, 12)
    (folder / "poses.txt").write_text("\n".join(numbers(row).replace(",", "") for row in matrices))
    return folder


def write_euroc(folder: Path, count: int = 3) -> Path:
    """Write a sequence of EuRoC, with its true poses."""
    for side in range(2):
        camera = folder / "mav0" / f"cam{side}"
        names = [f"{round(1e9 * stamp)}" for stamp in stamps_of(count)]
        for k, name in enumerate(names):
            write_image(camera / "data" / f"{name}.png", level_pair(k)[side])
        rows = "\n".join(f"{name},{name}.png" for name in names)
        (camera / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}\n")
        place = MOUNT.translation[0] + np.array([0.0, -BASELINE * side, 0.0])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = MOUNT.rotation[0].as_matrix(), place
        (camera / "sensor.yaml").write_text(
            "# of a camera\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n"
            f"  data: [{numbers(matrix[:2])},\n         {numbers(matrix[2:])}]\nrate_hz: 2\n"
            f"resolution: [{SIZE[0]}, {SIZE[1]}]\ncamera_model: pinhole\n"
            f"intrinsics: [{FOCAL}, {FOCAL}, {CENTRE[0]}, {CENTRE[1]}] #fu, fv, cu, cv\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        )
    body = driven(count)
    rows = [
        f"{round(1e9 * stamp)},{numbers(place)},{numbers(turn[[3, 0, 1, 2]])},0,0,0"
        for stamp, place, turn in zip(
            stamps_of(count), body.translation, body.rotation.as_quat(), strict=True
        )
    ]
    states = folder / "mav0" / "state_groundtruth_estimate0"
    states.mkdir()
    (states / "data.csv").write_text("#timestamp, p_RS_R_x [m]\n" + "\n".join(rows))
    return folder


def write_madmax(folder: Path, filmed: Filmed | None = None) -> Path:
    """Write a run of MADMAX, with its calibration and ground truth."""
    filmed = filmed or level_drive()
    stamps = stamps_of(len(filmed.pairs))
    for stamp, pair in zip(stamps, filmed.pairs, strict=True):
        for side, image in zip(("left", "right"), pair, strict=True):
            name = f"img_rect_{side}"
            write_image(folder / name / f"{name}_{round(1e9 * stamp)}.png", image)
    calibration = folder / "calibration"
    calibration.mkdir()
    width, height = filmed.size
    for side, p in zip(("left", "right"), filmed.projections, strict=True):
        (calibration / f"camera_rect_{side}_info.txt").write_text(
            f"header:\n  seq: 7\n  frame_id: {side}\nheight: {height}\nwidth: {width}\n"
            f'distortion_model: "plumb_bob"\nD: [0.0, 0.0, 0.0, 0.0, 0.0]\n'
            f"K: [{numbers(p[:, :3])}]\nR: [{numbers(np.eye(3))}]\nP: [{numbers(p)}]\n"
        )
    imu_b = Poses(np.array([[0.07, 0.0, -0.13]]), Rotation.from_euler("z", [[0.2]]))
    for name, pose in (("B", imu_b), ("camera_left", imu_b @ filmed.mount)):
        values = numbers(np.concatenate([pose.translation[0], pose.rotation[0].as_quat()]))
        head = "position.x, position.y, position.z, orientation.x, …".replace("…", "y, z, w")
        (calibration / f"tf__imu_to_{name}.csv").write_text(f"#{head}\n{values}\n")
    body = filmed.body
    truth = folder / "ground_truth"
    truth.mkdir()
    rows = [
        f"{stamp:.4f}, {numbers(place)}, 0.01, 0.01, 0.02, {numbers(turn[[3, 0, 1, 2]])}"
        for stamp, place, turn in zip(
            stamps, body.translation, body.rotation.as_quat(), strict=True
        )
    ]
    head = (
        "% UNIX time, x-enu(m), y-enu(m), z-enu(m), sde(m), sdn(m), sdu(m), orientation.w, "
        "orientation.x, orientation.y, orientation.z"
    )
    (truth / "gt_6DoF_gnss_and_imu.csv").write_text(
        "\n".join(["% MADMAX", "% frame B", head, *rows]) + "\n"
    )
    return folder


def write_poses(path: Path, body: Poses) -> Path:
    path.write_text(tum(stamps_of(len(body)), body))
    return path
