"""Edges say what was measured, and how surely."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import GraphParams, build_pose_graph, odometry_poses
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
    assert far[0] == pytest.approx(0.01 + 0.02 * distance)
    assert far[5] == pytest.approx(0.001 + params.heading_drift * np.sqrt(distance))
    assert np.all(far[[0, 1, 2, 5]] > near[[0, 1, 2, 5]])


def test_a_closure_is_lifted_into_space_with_its_covariance() -> None:
    traverse = simulate(4, row=2)
    motion = SE2(1.0, -2.0, pi / 2)
    planar = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, -0.002], [0.0, -0.002, 0.0004]])
    found = Registration(motion, np.ones(9, bool), 1.0, 20.0, 0.9, 5.0, 0.3, planar)
    graph = build_pose_graph(
        traverse.dataset, [LoopClosure("0003", "0000", found, accepted=True, reason="")]
    )
    (loop,) = graph.loops
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
    graph = build_pose_graph(
        traverse.dataset,
        [first, second, *refused],
        trusted=[(second.query_id, second.database_id)],
    )
    assert [loop.trusted for loop in graph.loops] == [False, True]


@pytest.mark.parametrize("accepted", [True, False])
def test_a_stranger_is_refused_by_name(*, accepted: bool) -> None:
    traverse = simulate(4, row=2)
    strange = replace(closure("0042", "0000", SE2(), 0.0), accepted=accepted)
    with pytest.raises(InputError, match=r"rows: a closure names submap '0042'"):
        build_pose_graph(traverse.dataset, [strange])


def test_without_odometry_there_is_no_graph() -> None:
    dataset = simulate(3, row=3).dataset
    lacking = replace(
        dataset,
        submaps=(*dataset.submaps[:2], replace(dataset.submaps[2], pose_odometry=None)),
    )
    with pytest.raises(InputError, match=r"rows: .*submap 0002 has none \(1 of 3 have none\)"):
        odometry_poses(lacking)
    assert list(odometry_poses(dataset)) == ["0000", "0001", "0002"]
