"""Folders of clouds, by whatever tool they were written, give what was recorded."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.recordings.build import open_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.trajectory import Poses
from tests.support.drive import MOUNT, as_kitti, assert_same_poses, make_drive, tum, write_drive
from tests.support.recordings import refused

FEW = make_drive(num_scans=5, points_a_scan=60)


def test_trajectories_by_evo(tmp_path: Path) -> None:
    """TUM and KITTI files that evo writes are read as evo means them."""
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo is not installed")
    file_interface = pytest.importorskip("evo.tools.file_interface")
    xyzw = FEW.sensor.rotation.as_quat()
    path = trajectory.PoseTrajectory3D(FEW.sensor.translation, np.roll(xyzw, 1, 1), FEW.stamps)
    write_drive(tmp_path / "tum", FEW)
    file_interface.write_tum_trajectory_file(str(tmp_path / "tum" / "poses.txt"), path)
    assert_same_poses(open_recording(tmp_path / "tum").body, FEW.sensor)

    kitti = tmp_path / "kitti"
    (kitti / "velodyne").mkdir(parents=True)
    for k, points in enumerate(FEW.scans):
        as_kitti(kitti / "velodyne" / f"{k:06d}.bin", points)
    file_interface.write_kitti_poses_file(str(kitti / "poses.txt"), path)
    recording = open_recording(kitti)
    assert_same_poses(recording.body, FEW.sensor)
    assert recording.stamps is None
    (kitti / "times.txt").write_text("".join(f"{0.1 * k:e}\n" for k in range(5)))
    np.testing.assert_allclose(open_recording(kitti).stamps, 0.1 * np.arange(5))


CAMERA = Rotation.from_matrix([[[0, -1, 0], [0, 0, -1], [1, 0, 0]]])
"""Turns x ahead, y left, z up into a camera's x right, y down, z ahead."""


def test_kittis_cameras_and_calibration(tmp_path: Path) -> None:
    """Poses of a camera whose y points down, and the LiDAR beside it."""
    from_robot = Poses(np.zeros((1, 3)), CAMERA)
    offset = Poses(np.array([[0.0, -0.3, -0.1]]), CAMERA)  # T_camera_lidar
    camera = from_robot @ FEW.sensor @ offset.inverse()
    rows = np.concatenate([camera.rotation.as_matrix(), camera.translation[:, :, None]], axis=2)
    write_drive(tmp_path / "velodyne", FEW, ".bin", as_kitti)
    (tmp_path / "velodyne" / "poses.txt").unlink()
    for k, file in enumerate(sorted((tmp_path / "velodyne").iterdir())):
        file.rename(file.with_name(f"{k:06d}.bin"))
    np.savetxt(tmp_path / "poses.txt", rows.reshape(-1, 12))
    matrix = np.column_stack([offset.rotation.as_matrix()[0], offset.translation[0]])
    row = "Tr: " + " ".join(f"{value:.12e}" for value in matrix.ravel())
    (tmp_path / "calib.txt").write_text(f"P0: {'0 ' * 12}\n{row}\n")
    recording = open_recording(tmp_path)
    assert recording.up == "-y"
    assert any("up is -y" in note for note in recording.notes)
    assert_same_poses(recording.sensor(2), (from_robot @ FEW.sensor)[2:3])


def test_where_the_sensor_sits(tmp_path: Path) -> None:
    write_drive(tmp_path, FEW)
    (tmp_path / "poses.txt").write_text(tum(FEW.stamps, FEW.body))
    values = [*MOUNT.translation[0], *MOUNT.rotation[0].as_quat()]
    (tmp_path / "mount.txt").write_text(" ".join(f"{value:.9f}" for value in values))
    recording = open_recording(tmp_path)
    assert_same_poses(recording.sensor(3), FEW.sensor[3:4])
    assert "mount.txt" in recording.notes[0]
    (tmp_path / "mount.txt").write_text("1 2 3\n")
    refused(tmp_path, "mount.txt", "tx ty tz qx qy qz qw")


@pytest.mark.parametrize(
    ("unit", "spell"),
    [
        ("", lambda stamp: f"{stamp:.6f}"),
        ("nanoseconds", lambda stamp: f"{round(stamp * 1e9)}"),
        ("microseconds", lambda stamp: f"{round(stamp * 1e6)}"),
        ("", lambda stamp: f"cloud_{int(stamp)}_{round(stamp % 1 * 1e9):09d}"),
        ("", lambda stamp: f"{int(stamp)}-{round(stamp % 1 * 1e9):09d}"),
        # without the leading zeros of nanoseconds
        ("", lambda stamp: f"{int(stamp)}.{round(stamp % 1 * 100) * 10_000_000}"),
        ("", lambda stamp: f"{int(stamp)}_{round(stamp % 1 * 100) * 10_000_000}"),
        ("", lambda stamp: f"{int(stamp)}_{round(stamp % 1 * 100) * 10_000_000}_v2"),
        ("", lambda stamp: f"{int(stamp)}.{round(stamp % 1 * 100) * 10_000_000}_0"),
    ],
)
def test_times_in_names(unit: str, spell: Callable[[float], str], tmp_path: Path) -> None:
    write_drive(tmp_path, FEW)
    shifted = FEW.stamps + 0.05
    (tmp_path / "poses.txt").write_text(tum(shifted, FEW.sensor))
    for stamp, at in zip(FEW.stamps, shifted, strict=True):
        (tmp_path / f"{stamp:.6f}.npy").rename(tmp_path / f"{spell(at)}.npy")
    recording = open_recording(tmp_path)
    np.testing.assert_allclose(recording.stamps, shifted, rtol=0, atol=1e-5)
    for scan, driven in zip(recording.read(1, 4), FEW.scans[1:4], strict=True):
        np.testing.assert_allclose(scan.points, driven, rtol=0, atol=2e-6)
    note = (f"the numbers in the scans' names are read as {unit}",) if unit else ()
    assert recording.notes == note


def test_what_cannot_be_brought_together(tmp_path: Path) -> None:
    refused(tmp_path / "none", "none: no such file or folder")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "holds no scans", ".bin")
    folder = write_drive(tmp_path / "drive", FEW)
    first = folder / f"{FEW.stamps[0]:.6f}.npy"
    refused(first, "is one file; give a folder")
    poses = (folder / "poses.txt").read_text()
    (folder / "poses.txt").unlink()
    refused(folder, "has no file of poses", "--poses FILE")
    (folder / "poses.txt").write_text(tum(FEW.stamps + 1000.0, FEW.sensor))
    stretches = "1700000000.000 to 1700000002.000 s", "1700001000.000 to 1700001002.000 s"
    refused(folder, "no scan has a pose within 0.1 s", *stretches)
    (folder / "poses.txt").write_text(poses)
    first.rename(folder / "first.npy")
    refused(folder, "first.npy holds no time", "--times FILE")
    (folder / "times.txt").write_text("1\n2\n")
    refused(folder, "times.txt: holds 2 times for 5 scans")
    np.savetxt(folder / "times.txt", FEW.stamps, fmt="%.6f")
    assert len(open_recording(folder)) == 5


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("", "holds no poses"),
        ("0 1 2 3\n", "line 1: has 4 columns; a TUM pose has 8"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", "line 2: has 7 columns"),
        ("# a\n0 0 0 0 0 0 0 2\n", "line 2: the quaternion"),
        ("0 0 0 0 0 0 0 x\n", "line 1: holds something that is not a number"),
        ("0 0 0 nan 0 0 0 1\n", "line 1: holds a value that is not finite"),
        ("1 0 0 0 0 1 0 0 0 0 2 0\n", "line 1: the first three columns of the pose's matrix"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: has 12 columns, the rows before"),
    ],
)
def test_broken_poses(rows: str, said: str, tmp_path: Path) -> None:
    folder = write_drive(tmp_path / "drive", FEW)
    (tmp_path / "mine.txt").write_text(rows)
    refused(folder, "mine.txt", said, poses=tmp_path / "mine.txt")


def test_covariances_of_tum_rows(tmp_path: Path) -> None:
    folder = write_drive(tmp_path, FEW)
    covariance = " ".join(f"{value:g}" for value in np.diag(np.arange(1.0, 7.0)).ravel())
    lines = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("".join(f"{line} {covariance}\n" for line in lines))
    recording = open_recording(folder, params=BuildParams(pose_matching="nearest"))
    np.testing.assert_allclose(recording.covariance[2], np.diag([1.0, 2.0, 3.0]))


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("name", ["{}", "scan_{:03d}_v0.05"])
def test_kittis_rows_go_by_the_number_that_differs(first: int, name: str, tmp_path: Path) -> None:
    for k in range(12):
        np.save(tmp_path / f"{name.format(k + first)}.npy", np.full((3, 3), float(k)))
    rows = np.hstack([np.eye(3), np.zeros((3, 1))])[None].repeat(12, axis=0)
    rows[:, 0, 3] = np.arange(12)
    np.savetxt(tmp_path / "poses.txt", rows.reshape(12, 12))
    recording = open_recording(tmp_path)
    read = [scan.points[0, 0] for scan in recording.read(0, 12)]
    np.testing.assert_array_equal(recording.body.translation[:, 0], read)
    note = "the KITTI rows belong to the files in the order of their names: the first to "
    told = [note + f"{name.format(1)}.npy"] * first
    assert [note.split(", the last")[0] for note in recording.notes] == told


@pytest.mark.parametrize(
    ("numbers", "rule"),
    [
        (range(1, 12), "11 scans from number 1 on and 12 KITTI poses: the first may belong to row"),
        (
            (1, 4, 9),
            "3 scans from number 1 on and 12 KITTI poses: the first may belong to row 0 or",
        ),
        (range(2, 12), "row 2 to 2.npy, row 11 to 11.npy; 2 of 12 have no scan and are left out"),
        ((0, 4, 9), "row 0 to 0.npy, row 9 to 9.npy; 9 of 12 have no scan and are left out"),
    ],
)
def test_kittis_rows_without_a_scan_are_told(
    numbers: Sequence[int], rule: str, tmp_path: Path
) -> None:
    for k in numbers:
        np.save(tmp_path / f"{k}.npy", np.full((3, 3), float(k)))
    rows = np.hstack([np.eye(3), np.zeros((3, 1))])[None].repeat(12, axis=0)
    rows[:, 0, 3] = np.arange(12)
    np.savetxt(tmp_path / "poses.txt", rows.reshape(12, 12))
    np.savetxt(tmp_path / "poses_gt.txt", rows[:11].reshape(11, 12))
    if 1 in numbers:
        refused(tmp_path, rule)
        return
    recording = open_recording(tmp_path)
    read = [scan.points[0, 0] for scan in recording.read(0, len(numbers))]
    np.testing.assert_array_equal(recording.body.translation[:, 0], read)
    assert recording.notes[0].endswith(rule)
    assert "poses_gt.txt: has 11 KITTI rows and poses.txt 12, from" in recording.notes[1]


def test_rows_of_times_go_by_order_and_say_so(tmp_path: Path) -> None:
    for k in range(12):
        np.save(tmp_path / f"scan{k + 1}.npy", np.full((3, 3), float(k)))
    standing = Poses(np.zeros((12, 3)), Rotation.identity(12))
    (tmp_path / "poses.txt").write_text(tum(np.arange(12.0), standing))
    (tmp_path / "times.txt").write_text("".join(f"{k}.0\n" for k in range(12)))
    recording = open_recording(tmp_path)
    assert [scan.points[0, 0] for scan in recording.read(0, 12)] == list(range(12))
    assert "the first to scan1.npy, the last to scan12.npy" in recording.notes[0]


CURVE = make_drive(num_scans=40, points_a_scan=3)


@pytest.mark.parametrize(
    "head",
    [
        "timestamp tx ty tz qw qx qy qz",
        "t [s], x, y, z, q_w [], q_x [], q_y [], q_z []",
        "qw qx qy qz",
    ],
)
def test_columns_of_poses_are_those_that_are_named(head: str, tmp_path: Path) -> None:
    folder = write_drive(tmp_path, CURVE)
    path, turned = folder / "poses.txt", [0, 1, 2, 3, 7, 4, 5, 6]
    rows = [[line.split()[k] for k in turned] for line in path.read_text().splitlines()]
    separator = "," if "," in head else " "
    for mark in ("#", ""):
        path.write_text("\n".join([f"{mark}{head}", *map(separator.join, rows)]))
        assert_same_poses(open_recording(folder).body, CURVE.sensor)


def test_turns_that_only_fit_the_drive_with_w_first_are_asked_about(tmp_path: Path) -> None:
    folder, angle = write_drive(tmp_path, FEW), np.linspace(0.0, 6.0, 40)
    places = np.column_stack([np.sin(angle), -np.cos(angle), 0 * angle])
    stamps = np.linspace(FEW.stamps[0], FEW.stamps[-1], 40)
    drive = Poses(places, Rotation.from_rotvec(np.outer(angle, [0.0, 0.05, 1.0])))
    (folder / "poses.txt").write_text(tum(stamps, drive))
    assert len(open_recording(folder)) == len(FEW.stamps)
    rolled = Rotation.from_quat(np.roll(drive.rotation.as_quat(), 1, axis=1))
    wrong = tum(stamps, Poses(places, rolled))
    (folder / "poses.txt").write_text(wrong)
    refused(folder, "poses.txt: its turns fit the drive only if w")
    (folder / "poses.txt").write_text(f"# t x y z qx qy qz qw\n{wrong}")
    assert len(open_recording(folder)) == len(FEW.stamps)


def test_poses_of_euroc_and_of_rtabmap(tmp_path: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    folder = write_drive(tmp_path, CURVE)
    path = folder / "poses.txt"
    assert_same_poses(open_recording(folder).body, CURVE.sensor)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(f"{line} {k}" for k, line in enumerate(lines)))
    assert_same_poses(open_recording(folder).body, CURVE.sensor)
    path.write_text("\n".join(f"{line} 0.5" for line in lines))
    refused(folder, "line 1: has 9 columns, and the last is no")

    rows: list[str] = []
    for time, *pose in (line.split() for line in lines):
        turned = [pose[k] for k in (0, 1, 2, 6, 3, 4, 5)]
        rows.append(",".join([f"{round(float(time) * 1e9)}", *turned, "0", "nan"]))
    head = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z [],v_x [m s^-1],b_w []"
    path.write_text("\n".join([head, *rows]))
    body = open_recording(folder).body
    theirs = file_interface.read_euroc_csv_trajectory(path)
    np.testing.assert_allclose(body.translation, theirs.positions_xyz)
    assert_same_poses(body, CURVE.sensor)
