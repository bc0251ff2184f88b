"""The graph finds the truth, wrong closures or not."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpgrad_core.errors import InputError
from gpgrad_core.run import Cancelled
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import GraphParams, SolverParams, build_pose_graph, optimise_pose_graph
from gpgrad_core.slam.optimise import measure_pose_covariances
from gpgrad_core.types import Dataset
from tests.core.slam.simulated import STEP, Traverse, closure, simulate, with_odometry


def error(traverse: Traverse, poses: dict[str, Pose]) -> float:
    """Of the places, with the first held where it is [m]."""
    found = np.array([pose.translation for pose in poses.values()])
    return float(np.sqrt(((found - traverse.true_xyz) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("seed", range(2))
def test_closures_take_the_drift_out_and_wrong_ones_lose(seed: int) -> None:
    traverse = simulate(60, seed, wrong=0.2)
    right = [c for c in traverse.closures if c.pair not in traverse.wrong]
    assert len(traverse.wrong) == round(0.25 * len(right))
    graph = build_pose_graph(traverse.dataset, right)
    clean, mixed = optimise_pose_graph(graph), optimise_pose_graph(traverse.graph())
    assert list(clean.poses) == list(graph.poses)
    first = next(iter(graph.poses))
    held, start = clean.poses[first].translation, graph.poses[first].translation
    np.testing.assert_allclose(held, start, atol=1e-3)
    assert error(traverse, graph.poses) > 1.0
    assert error(traverse, clean.poses) < 0.2 * error(traverse, graph.poses)
    assert error(traverse, mixed.poses) <= 1.3 * error(traverse, clean.poses)
    assert not clean.refused
    assert {fit.edge.pair for fit in mixed.refused} >= traverse.wrong
    for fit in mixed.refused:
        assert fit.weight == 0
        assert fit.chi_square > SolverParams().max_chi_square


def test_chi_square_is_the_error_over_its_covariance() -> None:
    result = optimise_pose_graph(simulate(40).graph())
    for fit in result.edges:
        edge = fit.edge
        left = edge.T_start_end.inverse() @ result.poses[edge.start].inverse()
        left = left @ result.poses[edge.end]
        turn = Rotation.from_quat(left.quaternion).as_rotvec()
        # GTSAM's error is the logarithm in SE(3): the same up to the square of the turn.
        small = np.array([*left.translation, *turn])
        expected = small @ np.linalg.solve(edge.covariance, small)
        assert fit.chi_square == pytest.approx(expected, rel=0.05, abs=0.05)


@pytest.mark.parametrize(("errors", "kept"), [(4.0, True), (6.0, False)])
def test_a_sure_closure_is_kept_if_odometry_may_have_erred_as_much(
    errors: float, kept: bool
) -> None:
    traverse, params = simulate(3), GraphParams(heading_drift=0.05)
    _, start, end = traverse.true_poses.values()
    turn = Pose.from_planar(SE2(0.0, 0.0, errors * (0.002 + 0.05 * np.sqrt(STEP))))
    first, second, third = traverse.dataset.submaps
    moved = replace(second, pose_odometry=start), replace(third, pose_odometry=end @ turn)
    dataset = replace(traverse.dataset, submaps=(first, *moved))
    T_start_end = start.inverse() @ end
    found = closure("0002", "0001", T_start_end.planar, float(T_start_end.translation[2]))
    sure = replace(found.registration, covariance=np.diag([0.01, 0.01, 0.002]) ** 2)
    graph = build_pose_graph(dataset, [replace(found, registration=sure)], params)
    (fit,) = optimise_pose_graph(graph).loops
    assert (fit.weight == 1) == kept


def climbing(dataset: Dataset, rate: float) -> Dataset:
    """Add a climb to odometry, as a share of the way."""
    poses = [submap.pose_odometry for submap in dataset.submaps if submap.pose_odometry]
    places = np.array([pose.translation for pose in poses])
    steps = np.diff(places, axis=0, prepend=places[:1])
    heights = iter(rate * np.cumsum(np.linalg.norm(steps, axis=1)))
    return with_odometry(
        dataset,
        lambda pose: Pose(pose.translation + np.array([0.0, 0.0, next(heights)]), pose.quaternion),
    )


@pytest.mark.parametrize("rate", [0.1, -0.15])
@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_odometry_that_climbs_is_doubted_rather_than_all_closures(
    rate: float, wrong: float
) -> None:
    traverse = simulate(40, wrong=wrong)
    dataset = climbing(traverse.dataset, rate)
    graph = build_pose_graph(dataset, traverse.closures)
    result = optimise_pose_graph(graph)
    assert {fit.edge.pair for fit in result.refused} == traverse.wrong
    assert result.height_doubted
    level = optimise_pose_graph(traverse.graph())
    assert level.height_drift is None
    assert error(traverse, graph.poses) > 10
    assert error(traverse, result.poses) < error(traverse, level.poses) + 0.2
    # It is the result that the flag gives which the note names.
    assert f"--graph.height-drift {result.height_drift:g}" in result.height_note
    stated = GraphParams(height_drift=result.height_drift)
    certain = build_pose_graph(dataset, traverse.closures, stated)
    by_hand = optimise_pose_graph(certain)
    assert by_hand.height_drift is None
    assert error(traverse, result.poses) == pytest.approx(error(traverse, by_hand.poses), abs=0.01)
    # Its poses are as uncertain as this odometry leaves them.
    heights, stated_heights = (
        measure_pose_covariances(*solved)[1:, 2, 2]
        for solved in ((graph, result), (certain, by_hand))
    )
    np.testing.assert_allclose(heights, stated_heights, rtol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_closures_of_random_heights_do_not_outweigh_odometry(seed: int) -> None:
    """Right in plan, wrong in height: they do not agree with each other."""
    traverse, rng = simulate(10, seed, row=5), np.random.default_rng(seed)
    wrong = [
        replace(c, registration=replace(c.registration, z_offset=float(rng.normal(0, 1.5))))
        for c in traverse.closures
    ]
    graph = build_pose_graph(traverse.dataset, wrong)
    assert not optimise_pose_graph(graph).height_doubted


def test_too_few_closures_only_name_the_number() -> None:
    traverse = simulate(60, 1, row=30)
    long = [c for c in traverse.closures if int(c.query_id) - int(c.database_id) > 50][:3]
    graph = build_pose_graph(climbing(traverse.dataset, 0.1), long)
    result = optimise_pose_graph(graph)
    assert len(result.refused) == 3
    assert not result.height_doubted
    assert f"--graph.height-drift {result.height_drift:g}" in result.height_note
    stated = GraphParams(height_drift=result.height_drift)
    given = build_pose_graph(climbing(traverse.dataset, 0.1), long, stated)
    assert not optimise_pose_graph(given).refused


def test_no_closures_no_change() -> None:
    graph = build_pose_graph(simulate(5, row=5).dataset, ())
    result = optimise_pose_graph(graph)
    assert result.poses == graph.poses
    assert result.history.shape == (1, 5, 7)
    assert result.at(0.5).keys() == graph.poses.keys()


def test_a_closure_that_is_vouched_for_is_kept() -> None:
    traverse = simulate(60, wrong=0.02)
    result = optimise_pose_graph(traverse.graph(trusted=traverse.wrong))
    weights = {fit.edge.pair: fit.weight for fit in result.loops}
    assert {weights[pair] for pair in traverse.wrong} == {1}


def test_gravity_holds_roll_and_pitch() -> None:
    traverse = simulate(60)
    tilted = [
        replace(c, registration=replace(c.registration, z_offset=c.registration.z_offset + 0.2))
        for c in traverse.closures
    ]
    result = optimise_pose_graph(build_pose_graph(traverse.dataset, tilted))
    for pose in result.poses.values():
        assert np.arccos(min(pose.rotation[2, 2], 1.0)) < 0.02


def test_the_way_leads_from_before_to_after_at_an_even_pace() -> None:
    graph = simulate(40).graph()
    result = optimise_pose_graph(graph)
    for share, expected in ((0.0, graph.poses), (1.0, result.poses)):
        for name, pose in result.at(share).items():
            np.testing.assert_allclose(pose.translation, expected[name].translation, atol=1e-9)
            np.testing.assert_allclose(pose.rotation, expected[name].rotation, atol=1e-9)
    places = [
        np.array([pose.translation for pose in result.at(share).values()])
        for share in np.linspace(0, 1, 21)
    ]
    steps = [np.sqrt(((b - a) ** 2).sum(1).mean()) for a, b in pairwise(places)]
    assert max(steps) < 1.5 * np.median(steps)


def test_the_frame_of_the_world_does_not_matter() -> None:
    traverse = simulate(40)
    far = Pose(np.array([500.0, -200.0, 30.0]), np.array([0.0, 0.0, np.sin(1.0), np.cos(1.0)]))
    moved = with_odometry(traverse.dataset, lambda pose: far @ pose)
    here, there = (
        optimise_pose_graph(build_pose_graph(dataset, traverse.closures)).poses
        for dataset in (traverse.dataset, moved)
    )
    for name, pose in here.items():
        np.testing.assert_allclose((far @ pose).translation, there[name].translation, atol=1e-3)


def test_it_can_be_cancelled() -> None:
    said: list[float] = []

    def hook(fraction: float) -> None:
        said.append(fraction)
        if len(said) == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        optimise_pose_graph(simulate(40).graph(), progress=hook)
    assert 0 < said[0] < said[1] < 1


def test_without_gtsam_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "gtsam", None)
    with pytest.raises(InputError, match="pose graphs need GTSAM"):
        optimise_pose_graph(simulate(20).graph())


def test_covariances_of_some_poses_are_those_of_all() -> None:
    graph = simulate(30, row=6, wrong=0.1).graph()
    result = optimise_pose_graph(graph)
    assert result.refused
    names = list(graph.poses)
    some = [29, 0, 13, 17]
    measured = measure_pose_covariances(graph, result, [names[k] for k in some])
    whole = measure_pose_covariances(graph, result)[some]
    scale = np.abs(whole).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(measured / scale, whole / scale, atol=1e-9)
