"""Edges say what was measured, and how surely; g2o's files are read by our reader and by GTSAM."""

from dataclasses import replace
from math import pi
from pathlib import Path

import gtsam
import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import (
    GraphParams,
    build_pose_graph,
    odometry_poses,
    optimise_pose_graph,
    read_graph,
    write_graph,
)
from gpgrad_core.slam.graph import shifted
from gpgrad_core.types import LoopClosure, Registration
from tests.core.slam.simulated import closure, simulate, with_odometry


def test_odometry_edges_say_what_the_poses_say() -> None:
    traverse = simulate(6, row=3)
    graph = build_pose_graph(traverse.dataset, ())
    assert [(edge.start, edge.end) for edge in graph.edges] == [
        (f"{k:04d}", f"{k + 1:04d}") for k in range(5)
    ]
    for edge in graph.edges:
        reached = graph.poses[edge.start] @ edge.T_start_end
        np.testing.assert_allclose(reached.translation, graph.poses[edge.end].translation)
        np.testing.assert_allclose(reached.rotation, graph.poses[edge.end].rotation, atol=1e-12)
        assert edge.trusted
        assert edge.kind == "odometry"


def test_odometry_is_less_sure_the_further_it_went() -> None:
    dataset = with_odometry(
        simulate(3, row=3).dataset, lambda pose: Pose(10 * pose.translation, pose.quaternion)
    )
    params = GraphParams(odometry_std=0.01, odometry_drift=0.02, heading_std=0.001)
    near, far = (
        np.sqrt(np.diag(build_pose_graph(driven, (), params).edges[0].covariance))
        for driven in (simulate(3, row=3).dataset, dataset)
    )
    distance = np.linalg.norm(build_pose_graph(dataset, ()).edges[0].T_start_end.translation)
    assert far[5] == pytest.approx(0.001 + params.heading_drift * np.sqrt(distance))
    # The robot turns about itself, wherever the points lie around it.
    by_turn = far[5] * dataset.submaps[1].extent.spread
    assert far[0] == pytest.approx(np.hypot(0.01 + 0.02 * distance, by_turn))
    assert np.all(far[[0, 1, 2, 5]] > near[[0, 1, 2, 5]])


def test_a_closure_is_lifted_into_space_with_its_covariance() -> None:
    traverse = simulate(4, row=2)
    motion = SE2(1.0, -2.0, pi / 2)
    planar = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.002], [0.0, -0.002, 0.0004]])
    found = Registration(motion, np.ones(9, bool), 1.0, 20.0, 0.9, 5.0, 0.3, planar)
    closing = LoopClosure("0003", "0000", found, accepted=True, reason="")
    (loop,) = build_pose_graph(traverse.dataset, [closing]).loops
    assert (loop.start, loop.end, loop.score) == ("0000", "0003", 5.0)
    np.testing.assert_allclose(loop.T_start_end.translation, [1.0, -2.0, 0.3])
    assert loop.T_start_end.planar.yaw == pytest.approx(pi / 2)
    # The query's x runs along the database's y: so do their variances.
    assert loop.covariance[0, 0] == pytest.approx(0.09)
    assert loop.covariance[1, 1] == pytest.approx(0.04)
    assert loop.covariance[0, 5] == pytest.approx(-0.002)
    assert loop.covariance[0, 1] == pytest.approx(-0.01)
    assert loop.covariance[2, 2] == pytest.approx(GraphParams().closure_height_std ** 2)


def test_a_closure_without_covariance_leans_on_its_inliers_and_not_on_its_height() -> None:
    traverse = simulate(4, row=2)
    found = closure("0003", "0000", SE2(1.0, 0.0, 0.1), 9.9)
    bare = replace(found, registration=replace(found.registration, covariance=None))
    graph = build_pose_graph(traverse.dataset, [bare])
    (loop,) = graph.loops
    std = np.sqrt(np.diag(loop.covariance))
    assert std[0] == pytest.approx(GraphParams().association_std / np.sqrt(50))
    assert std[2] == pytest.approx(GraphParams().unseen_std)
    between = graph.poses["0000"].inverse() @ graph.poses["0003"]
    assert loop.T_start_end.translation[2] == pytest.approx(between.translation[2])


def test_refused_closures_are_no_edges_and_those_vouched_for_are_trusted() -> None:
    traverse = simulate(12, row=4)
    first, second, *rest = traverse.closures
    refused = [replace(closure, accepted=False) for closure in rest]
    some = [first, second, *refused]
    graph = build_pose_graph(traverse.dataset, some, trusted=[second.pair])
    assert [loop.trusted for loop in graph.loops] == [False, True]


def test_strangers_and_submaps_without_odometry_are_refused_by_name() -> None:
    dataset = simulate(3, row=3).dataset
    for accepted in (True, False):
        strange = replace(closure("0042", "0000", SE2(), 0.0), accepted=accepted)
        with pytest.raises(InputError, match=r"rows: a closure names submap '0042'"):
            build_pose_graph(dataset, [strange])
    assert list(odometry_poses(dataset)) == ["0000", "0001", "0002"]
    first, second, third = dataset.submaps
    lacking = replace(dataset, submaps=(first, second, replace(third, pose_odometry=None)))
    with pytest.raises(InputError, match=r"rows: .*submap 0002 has none \(1 of 3 have none\)"):
        odometry_poses(lacking)


def test_what_is_written_reads_back_in(tmp_path: Path) -> None:
    graph = simulate(30).graph()
    path = tmp_path / "graph.g2o"
    write_graph(path, graph)
    again = read_graph(path)
    assert [int(name) for name in again.poses] == [int(name) for name in graph.poses]
    for ours, theirs in zip(graph.poses.values(), again.poses.values(), strict=True):
        np.testing.assert_allclose(ours.translation, theirs.translation, atol=1e-7)
        np.testing.assert_allclose(ours.rotation, theirs.rotation, atol=1e-8)
    assert len(again.loops) == len(graph.loops) > 0
    for ours, theirs in zip(graph.edges, again.edges, strict=True):
        assert (int(ours.start), int(ours.end)) == (int(theirs.start), int(theirs.end))
        assert ours.kind == theirs.kind
        np.testing.assert_allclose(theirs.covariance, ours.covariance, rtol=1e-6, atol=1e-12)


def test_ground_far_from_its_frame_is_written_about_its_centre(tmp_path: Path) -> None:
    near = simulate(30).graph()
    centre = np.array([5e5, 5.2e6, 100.0])
    motions = [edge.T_start_end for edge in near.edges]
    moved = [Pose(one.translation + centre, one.quaternion) for one in motions]
    graph = replace(
        near,
        poses={name: shifted(pose, -centre) for name, pose in near.poses.items()},
        edges=tuple(
            replace(edge, T_start_end=shifted(one, -centre))
            for edge, one in zip(near.edges, moved, strict=True)
        ),
        centres=dict.fromkeys(near.poses, centre),
    )
    write_graph(tmp_path / "graph.g2o", graph)
    again = read_graph(tmp_path / "graph.g2o")
    ours, theirs = (optimise_pose_graph(one) for one in (graph, again))
    for own, other in zip(ours.edges, theirs.edges, strict=True):
        assert other.chi_square == pytest.approx(own.chi_square, rel=1e-3, abs=1e-3)
    there = graph.at_centres(ours.poses).values()
    for pose, other in zip(there, theirs.poses.values(), strict=True):
        np.testing.assert_allclose(other.translation, pose.translation, atol=0.001)


def test_another_tool_finds_the_same_poses(tmp_path: Path) -> None:
    graph = simulate(30).graph()
    path = tmp_path / "graph.g2o"
    write_graph(path, graph)
    read, start = gtsam.readG2o(str(path), True)
    assert read.size() == len(graph.edges)
    factors = gtsam.NonlinearFactorGraph()
    half = np.diag([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
    for k in range(read.size()):
        # GTSAM takes g2o's weights of half angles for weights of angles: put that right.
        factor = read.at(k)
        noise = gtsam.noiseModel.Gaussian.Information(
            half @ factor.noiseModel().information() @ half
        )
        ends = factor.keys()
        factors.add(gtsam.BetweenFactorPose3(ends[0], ends[1], factor.measured(), noise))
    anchor = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
    factors.add(gtsam.PriorFactorPose3(0, start.atPose3(0), anchor))
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    # The file knows no gravity: neither may we, for once.
    ours = optimise_pose_graph(read_graph(path, tilt_std=1e3)).poses
    for key, pose in enumerate(ours.values()):
        np.testing.assert_allclose(pose.translation, theirs.atPose3(key).translation(), atol=1e-3)


def test_names_that_are_not_numbers_are_counted(tmp_path: Path) -> None:
    dataset = simulate(3, row=3).dataset
    names = zip(dataset.submaps, ["crater", "dune", "ridge"], strict=True)
    renamed = tuple(replace(submap, id=name) for submap, name in names)
    graph = build_pose_graph(replace(dataset, submaps=renamed), ())
    write_graph(tmp_path / "graph.g2o", graph)
    graph = read_graph(tmp_path / "graph.g2o")
    assert list(graph.poses) == ["0", "1", "2"]
    assert [(edge.start, edge.end) for edge in graph.edges] == [("0", "1"), ("1", "2")]


VERTICES = "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 5 0 0 0 0 0 1\n"
UNIT = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("VERTEX_SE2 0 1 2 3\n", r"line 1: 'VERTEX_SE2' is not one of"),
        ("VERTEX_SE3:QUAT 0 1 2\n", r"line 1: VERTEX_SE3:QUAT has 8 columns, found 3"),
        ("VERTEX_SE3:QUAT x 0 0 0 0 0 0 1\n", r"line 1: the vertex 'x' is not a whole number"),
        ("VERTEX_SE3:QUAT 0 nan 0 0 0 0 0 1\n", r"line 1: holds a value that is not finite"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 0\n", r"line 1: .* must have length 1, this one has 0"),
        (
            f"{VERTICES}EDGE_SE3:QUAT 0 7 5 0 0 0 0 0 1 {UNIT}\n",
            r"line 3: names vertex 7, which the file does not have",
        ),
        (
            f"{VERTICES}EDGE_SE3:QUAT 0 1 5 0 0 0 0 0 1 {UNIT.replace('1', '0')}\n",
            r"line 3: the information matrix is not positive definite",
        ),
    ],
)
def test_broken_files_are_refused_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_graph(path)


def test_comments_blank_lines_and_fixed_vertices_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "graph.g2o"
    path.write_text(f"# a graph\n\n{VERTICES}FIX 0\nEDGE_SE3:QUAT 0 1 5 0 0 0 0 0 1 {UNIT}\n")
    (edge,) = read_graph(path).edges
    assert edge.kind == "odometry"
    # Twice the half angle: a unit weight on the quaternion is a quarter on the turn.
    np.testing.assert_allclose(np.diag(edge.covariance), [1, 1, 1, 4, 4, 4])
