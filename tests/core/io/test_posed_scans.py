"""Scans with a pose each: as the Canadian planetary terrain has them, and as SLAM programs dump."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

from app.viewer.features.data.folders import check_inside, list_folder
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset, open_dataset, outline_dataset
from gpgrad_core.io.poses import read_matrix_pose
from gpgrad_core.recordings.build import build_dataset, open_recording
from gpgrad_core.recordings.params import BuildParams
from gpgrad_core.slam import join_datasets
from gpgrad_core.types import Dataset
from tests.support.drive import Drive, assert_same_poses, ground, make_drive
from tests.support.refusal import assert_refused

PRINTED = """\
0.818033 -0.564399 -0.110798 10.253338
0.571935 0.818601 0.052751 -0.353549
0.060927 -0.106521 0.992442 0.064736
0.000000 0.000000 0.000000 1.000000
"""
"""A pose of p2at_met, as the tutorial of the Canadian Space Agency prints it."""
FEW = make_drive(num_scans=4, points_a_scan=300)


def write_scans(folder: Path, drive: Drive) -> Path:
    """Write scans with np.savetxt, each beside the matrix of its pose."""
    for k, points in enumerate(drive.scans):
        name = f"p2at_met_{k:03d}"
        (folder / name).mkdir(parents=True)
        np.savetxt(folder / name / f"{name}.xyz", points, fmt="%.6f")
        sensor = drive.sensor[k : k + 1]
        matrix = np.eye(4)
        matrix[:3, :3] = sensor.rotation.as_matrix()[0]
        matrix[:3, 3] = sensor.translation[0]
        np.savetxt(folder / name / f"{name}.gt", matrix, fmt="%.6f")
    return folder


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    return write_scans(tmp_path / "p2at_met", FEW)


def test_the_printed_pose(tmp_path: Path) -> None:
    (tmp_path / "a.gt").write_text(PRINTED)
    pose = read_matrix_pose(tmp_path / "a.gt")
    np.testing.assert_allclose(pose.translation, [10.253338, -0.353549, 0.064736])
    rows = np.array([line.split() for line in PRINTED.splitlines()], float)
    np.testing.assert_allclose(pose.rotation, rows[:3, :3], atol=2e-6)


def test_every_scan_is_a_level_submap_also_in_large_sets_and_in_several(scans: Path) -> None:
    dataset, (_, sources) = load_dataset(scans), open_dataset(scans, most_bytes=0)
    joined = join_datasets([outline_dataset(scans)])
    assert [submap.id for submap in dataset.submaps] == [f"p2at_met_{k:03d}" for k in range(4)]
    assert "there is no odometry" in dataset.notes[0]
    for k, submap in enumerate(dataset.submaps):
        assert submap.pose_odometry is None
        np.testing.assert_allclose(submap.pose_true.rotation[:, 2], [0, 0, 1], atol=1e-12)
        world = submap.pose_true.apply(submap.points)
        np.testing.assert_allclose(world[:, 2], ground(world[:, :2]), atol=1e-4)
        for again in (sources[k].load(), joined.outline.load(k)[0]):
            assert again.fingerprint == submap.fingerprint
            assert again.pose_true is not None


def test_a_build_puts_scans_together(scans: Path, tmp_path: Path) -> None:
    recording = open_recording(scans)
    assert recording.stamps is None
    assert_same_poses(recording.body, FEW.sensor, 1e-5)
    report = build_dataset(scans, tmp_path / "out", BuildParams(max_length=1.0))
    assert report.num_scans == 4
    assert any("no odometry" in note for note in report.notes)
    built = load_dataset(tmp_path / "out")
    assert len(built.submaps) == 2
    for submap in built.submaps:
        world = submap.pose_true.apply(submap.points)
        assert np.median(np.abs(world[:, 2] - ground(world[:, :2]))) < 0.01


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "has 3 rows"),
        ("1 0 0\n", "line 1: a pose is four rows of four numbers"),
        (PRINTED + "0 0 0 1\n", "line 5: a pose is four rows"),
        (PRINTED.replace("0.818033", "0.9"), "are no rotation"),
        (PRINTED.replace("0.818033", "x"), "line 1: holds something that is not a number: 'x'"),
        (PRINTED.replace("0.000000 1.0", "0.100000 1.0"), "last row"),
        (PRINTED.replace("10.253338", "1e10"), "further from the origin"),
        ("9" * 20_000, "larger than 10,000 bytes"),
    ],
)
def test_wrong_poses(scans: Path, text: str, said: str) -> None:
    file = scans / "p2at_met_002" / "p2at_met_002.gt"
    file.write_text(text)
    for read in (load_dataset, open_recording):
        assert_refused(lambda read=read: read(scans), str(file), said)


def test_cut_and_missing_files(scans: Path) -> None:
    cloud = scans / "p2at_met_001" / "p2at_met_001.xyz"
    text = cloud.read_text()
    cloud.write_text(text[: len(text) // 2].rsplit(" ", 1)[0])
    assert_refused(lambda: load_dataset(scans), str(cloud), "line", "columns")
    cloud.write_text("1 0 0\n1 0 1\n1 0 2\n")
    left = load_dataset(scans)
    assert len(left.submaps) == 3
    assert left.notes[-1].startswith(f"{cloud}: all 3 points lie on one line")
    (scans / "p2at_met_001" / "p2at_met_001.gt").unlink()
    assert_refused(lambda: load_dataset(scans), "p2at_met_001.xyz but no pose p2at_met_001.gt")


def test_a_page_may_open_them_and_no_links_to_elsewhere(scans: Path) -> None:
    root = scans.parent
    assert list_folder(root, Path("p2at_met")).is_dataset
    assert check_inside(root, Path("p2at_met")) == scans.resolve()
    outside = root.parent / f"{root.name}-outside.xyz"
    outside.write_text("0 0 0\n")
    cloud = scans / "p2at_met_001" / "p2at_met_001.xyz"
    cloud.unlink()
    cloud.symlink_to(outside)
    with pytest.raises(InputError, match="no such file or folder"):
        check_inside(root, Path("p2at_met"))


# --- keyframes of SLAM programs ------------------------------------------------------------------

CLOUDS = np.random.default_rng(0).normal(size=(3, 50, 3)) * [5, 5, 0.1]
CLOUDS = CLOUDS.astype(np.float32).astype(np.float64)
TURNS = Rotation.from_euler("zyx", [[0, 0, 0], [40, 5, -3], [100, -4, 6]], degrees=True)
PLACES = np.array([[0.0, 0, 0], [5, 1, 0.2], [9, 4, 0.5]])


def matrix(k: int) -> str:
    rows = np.column_stack([TURNS[k].as_matrix(), PLACES[k]])
    return "".join(" ".join(map(repr, row)) + "\n" for row in [*rows.tolist(), [0.0, 0, 0, 1]])


@pytest.fixture
def hdl(tmp_path: Path) -> Path:
    vertices = "EDGE_SE3:QUAT 7 8 0\n"
    for k, points in enumerate(CLOUDS):
        folder = tmp_path / "hdl" / f"{k:06d}"
        folder.mkdir(parents=True)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        assert o3d.io.write_point_cloud(str(folder / "cloud.pcd"), cloud)
        wrong = matrix((k + 1) % 3)  # before the graph was solved
        (folder / "data").write_text(f"stamp 17 {k}\nestimate\n{wrong}odom\n{wrong}id {k + 7}\n")
        row = " ".join(map(repr, [*PLACES[k].tolist(), *TURNS[k].as_quat().tolist()]))
        vertices += f"VERTEX_SE3:QUAT {k + 7} {row}\n"
    (tmp_path / "hdl" / "graph.g2o").write_text(vertices)
    return tmp_path / "hdl"


def assert_placed(dataset: Dataset) -> None:
    assert [submap.id for submap in dataset.submaps] == ["000000", "000001", "000002"]
    for k, submap in enumerate(dataset.submaps):
        assert submap.pose_true is None
        world = submap.pose_odometry.apply(submap.points)
        np.testing.assert_allclose(world, TURNS[k].apply(CLOUDS[k]) + PLACES[k], atol=1e-5)


def test_keyframes_of_hdl_graph_slam(hdl: Path) -> None:
    assert_placed(load_dataset(hdl))
    recording = open_recording(hdl)
    np.testing.assert_allclose(recording.body.translation, PLACES)
    assert recording.truth is None
    (hdl / "000001" / "data").unlink()
    dataset = load_dataset(hdl)
    assert dataset.submaps[1].pose_odometry is None
    assert "000001: has no pose in graph.g2o; it is taken as level" in dataset.notes
    assert "000001: has no pose in graph.g2o and was left out" in open_recording(hdl).notes
    rows = (hdl / "graph.g2o").read_text()
    (hdl / "graph.g2o").write_text(rows.replace("VERTEX_SE3:QUAT 7 ", "VERTEX_SE3:QUAT 7 1 "))
    assert_refused(lambda: load_dataset(hdl), "graph.g2o, line 2: VERTEX_SE3:QUAT needs a number")
    (hdl / "graph.g2o").unlink()
    first = load_dataset(hdl).submaps[0].pose_odometry
    np.testing.assert_allclose(first.translation, PLACES[1])


def test_submaps_of_glim(tmp_path: Path) -> None:
    for k, points in enumerate(CLOUDS):
        folder = tmp_path / f"{k:06d}"
        folder.mkdir()
        points.astype("<f4").tofile(folder / "points_compact.bin")
        text = f"id: {k}\nT_world_origin: \n{matrix(k)}T_origin_endpoint_L: \n{matrix(0)}"
        (folder / "data.txt").write_text(text)
    (tmp_path / "values.bin").write_bytes(bytes(48))
    assert_placed(load_dataset(tmp_path))
    np.testing.assert_allclose(open_recording(tmp_path).body.translation, PLACES)
    (tmp_path / "000001" / "data.txt").write_text("T_world_origin:\n1 0 0\n")
    assert_refused(lambda: load_dataset(tmp_path), "data.txt: T_world_origin: must be four rows")
