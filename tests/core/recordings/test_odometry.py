"""Scans without poses: how far the odometry drifts, and what is said where it fails."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.io.clouds import read_cloud
from gpgrad_core.recordings import odometry
from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.recordings.pose_files import read_pose_file
from gpgrad_core.recordings.recording import RecordingSources
from gpgrad_core.recordings.trajectory import Poses
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from tests.support.bags import BagWriter
from tests.support.recordings import refused
from tests.support.refusal import assert_refused

SOURCES = RecordingSources(odometry="kiss-icp")
MOUNT = Poses(np.array([[0.3, 0.0, 0.9]]), Rotation.from_euler("ZYX", [[0.1, 0.2, 0.0]]))
PARAMS = BuildParams(max_length=2.0)
NEAR, FAR = 40, 80
"""Number of scans of a drive, and the scan from which a second drive begins."""

needs_package = pytest.mark.skipif(
    importlib.util.find_spec("kiss_icp") is None,
    reason="the extra 'odometry' is not installed",
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A LiDAR over rocky ground without odometry: 40 scans, and 12 from the far side of a loop."""
    folder = tmp_path_factory.mktemp("odometry") / "drive"
    params = SimulationParams(sensor="lidar", max_range=10, num_submaps=8, route="loop", extent=60)
    simulate_recording(folder, 320, params, points_a_scan=4000)
    for k, scan in enumerate(sorted((folder / "scans").iterdir())):
        if not (k < NEAR or FAR <= k < FAR + 12):
            scan.unlink()
    forget_odometry(folder)
    return folder


@pytest.fixture
def short(tmp_path: Path) -> Path:
    """Two scans without odometry, for what is said before any scan is placed."""
    params = SimulationParams(num_submaps=2, extent=20.0)
    simulate_recording(tmp_path / "short", 2, params, points_a_scan=200)
    forget_odometry(tmp_path / "short")
    return tmp_path / "short"


def forget_odometry(folder: Path) -> None:
    for name in ("poses.txt", "times.txt"):
        (folder / name).unlink()


@pytest.fixture
def drive(whole: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "drive"
    shutil.copytree(whole, folder)
    for scan in sorted((folder / "scans").iterdir())[NEAR:]:
        scan.unlink()
    return folder


def true_poses(folder: Path) -> Poses:
    stamps = np.array([float(scan.stem) for scan in sorted((folder / "scans").iterdir())])
    return read_pose_file(folder / "poses_gt.txt").trajectory.at(stamps, PARAMS).poses


def errors(found: Poses, true: Poses) -> np.ndarray:
    """Errors of positions [m], from the same start."""
    start = (true[:1] @ found[:1].inverse())[np.zeros(len(found), np.intp)]
    return np.linalg.norm((start @ found).translation - true.translation, axis=1)


@needs_package
@pytest.mark.slow
def test_a_lidar_over_rocks_drifts_little_and_the_same_in_each_run(drive: Path) -> None:
    recording = open_recording(drive, SOURCES)
    found = odometry.estimate_poses(recording, PARAMS)
    true = true_poses(drive)
    driven = np.linalg.norm(np.diff(true.translation, axis=0), axis=1).sum()
    error = errors(found.body, true)
    assert driven > 4
    assert error.max() < 0.02 * driven  # measured: 0.8 %
    assert found.breaks == ()
    (note,) = found.notes
    assert "kiss-icp" in note
    assert "--gravity cloud" in note
    again = odometry.estimate_poses(recording, PARAMS)
    np.testing.assert_array_equal(again.body.translation, found.body.translation)


@needs_package
@pytest.mark.slow
def test_a_bag_without_poses_is_built_in_its_robots_frame(drive: Path, tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    scans = sorted((drive / "scans").iterdir())
    with BagWriter(path, ros1=True) as bag:
        bag.transform(float(scans[0].stem), "base_link", "lidar", MOUNT, 0, topic="/tf_static")
        for scan in scans:
            bag.cloud("/points", float(scan.stem), "lidar", read_cloud(scan).points)
    sources = RecordingSources(odometry="kiss-icp", truth=drive / "poses_gt.txt")
    report = build_dataset(path, tmp_path / "made", PARAMS, sources=sources)
    assert (report.num_scans, report.num_failed) == (NEAR, 0)
    assert report.num_submaps >= 2
    first = np.loadtxt(tmp_path / "made" / "trajectory" / "000.txt")
    np.testing.assert_allclose(first[0, 1:4], MOUNT.translation[0], atol=1e-6)
    first = Poses(first[:, 1:4], Rotation.from_quat(first[:, 4:]))
    assert errors(first, true_poses(drive)[: len(first)]).max() < 0.05


@needs_package
@pytest.mark.slow
def test_submaps_end_where_scans_share_nothing(whole: Path, drive: Path, tmp_path: Path) -> None:
    scans = sorted((whole / "scans").iterdir())
    thin = drive / "scans" / f"{scans[4].stem}.npy"
    np.save(thin, read_cloud(scans[4]).points[:20])
    thin.with_suffix(".ply").unlink()
    for scan in scans[NEAR:]:
        shutil.copy(scan, drive / "scans")
    params = BuildParams(max_length=100.0)
    report = build_dataset(drive, tmp_path / "made", params, sources=SOURCES)
    said = "\n".join(report.notes)
    assert report.num_failed >= 1, said
    assert report.num_submaps == report.num_failed + 1
    assert f"kiss-icp failed at {report.num_failed} of 52 scans" in said
    assert f"the first is {scans[NEAR].name}" in said
    assert "1 of 52 scans has fewer than 50 points" in said


@needs_package
@pytest.mark.slow
def test_even_ground_that_holds_no_scan_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    (tmp_path / "scans").mkdir()
    for k in range(20):
        seen = rng.uniform(-8, 8, (2500, 2))
        np.save(tmp_path / "scans" / f"{k:06d}.npy", np.column_stack([seen, np.full(2500, -1.2)]))
    found = odometry.estimate_poses(open_recording(tmp_path, SOURCES), PARAMS)
    assert any("is not to be trusted" in note and "give poses" in note for note in found.notes)


def test_without_the_package_one_line_says_what_to_install(
    short: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    assert_refused(
        lambda: build_dataset(short, tmp_path / "made", sources=SOURCES),
        "kiss_icp is not installed: pip install 'gpgrad[odometry]'",
    )


def test_what_does_not_go_with_odometry_is_refused(short: Path) -> None:
    both = RecordingSources(odometry="kiss-icp", poses=short / "poses_gt.txt")
    refused(short, "--poses", "kiss-icp makes the poses", sources=both)
    refused(short, "--poses FILE", "--odometry kiss-icp")
