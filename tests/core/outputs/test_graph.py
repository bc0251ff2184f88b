"""A pose graph in g2o's format, read back by a reader of these tests' own."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.errors import InputError
from gpgrad_core.outputs import GraphParams, check_graph, write_graph
from gpgrad_core.pipeline import DetectionResult
from gpgrad_core.types import Dataset

Rows = dict[tuple[int, ...], list[float]]


def matrix(numbers: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(numbers[3:7]).as_matrix()
    T[:3, 3] = numbers[:3]
    return T


def read(path: Path) -> tuple[Rows, Rows]:
    vertices, edges = {}, {}
    for line in path.read_text().splitlines():
        tag, *words = line.split()
        if tag == "VERTEX_SE3:QUAT":
            assert len(words) == 1 + 7
            vertices[(int(words[0]),)] = [float(word) for word in words[1:]]
        else:
            assert tag == "EDGE_SE3:QUAT"
            assert len(words) == 2 + 7 + 21
            edges[int(words[0]), int(words[1])] = [float(word) for word in words[2:]]
    return vertices, edges


def information(numbers: list[float]) -> np.ndarray:
    full = np.zeros((6, 6))
    full[np.triu_indices(6)] = numbers[7:]
    return full


def test_vertices_and_edges(dataset: Dataset, result: DetectionResult, tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    write_graph(path, dataset, result.closures)
    vertices, edges = read(path)
    assert set(vertices) == {(0,), (2,), (4,)}  # the submaps' own numbers
    for submap in dataset.submaps:
        assert submap.pose_odometry is not None
        np.testing.assert_allclose(
            vertices[int(submap.id),],
            [*submap.pose_odometry.translation, *submap.pose_odometry.quaternion],
            atol=1e-8,
        )
    assert set(edges) == {(0, 2), (2, 4), (0, 4)}  # what was refused is not there
    for start, end in [(0, 2), (2, 4)]:
        # Odometry's edges say what its vertices say.
        expected = np.linalg.inv(matrix(vertices[start,])) @ matrix(vertices[end,])
        np.testing.assert_allclose(matrix(edges[start, end]), expected, atol=1e-8)

    closure = matrix(edges[0, 4])
    np.testing.assert_allclose(closure[:3, 3], [5.1, 4.9, 0.1], atol=1e-8)
    assert np.arctan2(closure[1, 0], closure[0, 0]) == pytest.approx(np.pi - 0.01)


def test_information_is_sure_of_what_was_seen(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "graph.g2o"
    params = GraphParams(association_std=0.3, unseen_std=5.0, odometry_yaw_std=0.02)
    write_graph(path, dataset, result.closures, params)
    _, edges = read(path)
    for numbers in edges.values():
        assert np.all(np.linalg.eigvalsh(information(numbers)) > 0)
    closure = np.diag(information(edges[0, 4]))
    assert closure[0] == pytest.approx(9 / 0.3**2)  # nine inliers
    assert closure[2] == pytest.approx(1 / 5.0**2)
    # g2o's error of a turn is the quaternion's vector part: half the angle.
    odometry = np.diag(information(edges[0, 2]))
    assert odometry[5] == pytest.approx(4 / 0.02**2)


def test_names_that_are_not_numbers_are_counted(dataset: Dataset, tmp_path: Path) -> None:
    names = ["crater", "dune", "ridge"]
    renamed = replace(
        dataset,
        submaps=tuple(
            replace(submap, id=name) for submap, name in zip(dataset.submaps, names, strict=True)
        ),
    )
    write_graph(tmp_path / "graph.g2o", renamed, ())
    vertices, edges = read(tmp_path / "graph.g2o")
    assert set(vertices) == {(0,), (1,), (2,)}
    assert set(edges) == {(0, 1), (1, 2)}


def test_without_odometry_there_is_no_graph(dataset: Dataset, tmp_path: Path) -> None:
    lacking = replace(
        dataset, submaps=(dataset.submaps[0], replace(dataset.submaps[1], pose_odometry=None))
    )
    for attempt in (
        lambda: check_graph(lacking),
        lambda: write_graph(tmp_path / "graph.g2o", lacking, ()),
    ):
        with pytest.raises(InputError, match=r"crater: .*submap 002 has none \(1 of 2 lack it\)"):
            attempt()
    assert not list(tmp_path.iterdir())
    check_graph(dataset)
