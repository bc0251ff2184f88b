"""Dumps of SLAM programs: a folder for each keyframe, with its pose beside it or in a graph."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.io.folder import load_dataset
from gpgrad_core.recordings.build import open_recording
from gpgrad_core.types import Dataset
from tests.support.refusal import assert_refused

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
