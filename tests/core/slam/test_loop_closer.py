"""Submap by submap the same comes out as all at once."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import detect_loop_closures
from gpgrad_core.errors import InputError
from gpgrad_core.run import Cancelled
from gpgrad_core.slam import Drive, LoopCloser, build_pose_graph, optimise_pose_graph, verdicts_at
from gpgrad_core.types import LoopClosure
from tests.core.slam.simulated import Oracle, simulate
from tests.support.cancelling import cancelling


@pytest.mark.parametrize(
    ("agreeing", "in_memory"),
    [(False, 10**9), (False, 30_000), (True, 10**9)],
    ids=["", "little memory", "pairs that say something of each other"],
)
def test_each_moment_is_what_all_submaps_so_far_give_at_once(
    agreeing: bool, in_memory: int
) -> None:
    traverse = simulate(15, row=5, wrong=0.1)
    submaps, oracle = traverse.dataset.submaps, Oracle.of(traverse, agreeing=agreeing)
    with Drive(detector=oracle, bytes_in_memory=in_memory) as drive:
        for k, submap in enumerate(submaps):
            assert len(drive.add(submap).closures) == k
        online, closures = drive.result, drive.closures
    for moment in (drive.moments[7], drive.moments[-1]):
        so_far = replace(traverse.dataset, submaps=submaps[: moment.number + 1])
        together = detect_loop_closures(so_far, detector=oracle).closures
        batch = optimise_pose_graph(build_pose_graph(so_far, together))
        told = verdicts_at(drive.moments[: moment.number + 1])
        assert {c.pair: c.accepted for c in told.values()} == {c.pair: c.accepted for c in together}
        assert list(moment.poses) == list(batch.poses)
        np.testing.assert_array_equal(moment.places, batch.history[-1])
        assert set(moment.left_out) == {fit.edge.pair for fit in batch.refused}
    assert list(map(verdict, closures)) == list(map(verdict, together))
    assert any(closure.accepted for closure in closures)
    np.testing.assert_array_equal(online.history, batch.history)
    assert [fit.weight for fit in online.edges] == [fit.weight for fit in batch.edges]
    assert any(moment.turned for moment in drive.moments) == agreeing  # later pairs had a say
    supports = [c.context.support for c in closures if c.context is not None]
    assert (min(supports, default=0) < 0 < max(supports, default=0)) == agreeing


def verdict(closure: LoopClosure) -> tuple[object, ...]:
    return closure.pair, closure.accepted, closure.reason, closure.context


def test_poses_are_corrected_as_soon_as_a_loop_closes_and_odometry_leads_until_then() -> None:
    traverse = simulate(24, row=6)
    closes = min(int(closure.query_id) for closure in traverse.closures)
    with LoopCloser(detector=Oracle.of(traverse)) as closer:
        for k, submap in enumerate(traverse.dataset.submaps):
            step = closer.add(submap)
            own, solved = submap.pose_odometry.translation, step.poses[submap.id].translation
            if k < closes:
                assert not step.accepted
                np.testing.assert_allclose(solved, own, atol=1e-9)
    true = submap.pose_true.translation
    assert np.linalg.norm(solved - true) < 0.5 * np.linalg.norm(own - true)


def test_a_search_radius_spares_the_far_ones() -> None:
    traverse = simulate(24, row=6)
    oracle = Oracle.of(traverse)
    with LoopCloser(detector=oracle, search_radius=9.0) as closer:
        for submap in traverse.dataset.submaps:
            closer.add(submap)
        found = {closure.pair for closure in closer.closures if closure.accepted}
    assert found == set(oracle.known)
    assert len(oracle.compared) < 0.7 * 24 * 23 / 2


def test_a_second_traverse_is_joined_by_its_closures() -> None:
    traverse = simulate(24, row=6)
    submaps = traverse.dataset.submaps
    with LoopCloser(detector=Oracle.of(traverse)) as closer:
        for k, submap in enumerate(submaps):
            own = submap.pose_odometry
            if k >= 12:  # in a frame of its own
                own = submaps[12].pose_odometry.inverse() @ own
            closer.add(replace(submap, pose_odometry=own), starts_traverse=k == 12)
        poses = closer.result.poses
    for name, pose in poses.items():
        assert np.linalg.norm(pose.translation - traverse.true_poses[name].translation) < 1.0


def test_what_cannot_be_added_is_refused_and_what_is_cancelled_is_not_added() -> None:
    traverse = simulate(4, row=2)
    first, second, *_ = traverse.dataset.submaps
    with LoopCloser(detector=Oracle.of(traverse)) as closer:
        closer.add(first)
        with pytest.raises(InputError, match="0000 was already added"):
            closer.add(first)
        with pytest.raises(InputError, match="0001 has no odometry"):
            closer.add(replace(second, pose_odometry=None))
        with pytest.raises(Cancelled):
            closer.add(second, cancelling())
        assert list(closer.add(second).poses) == ["0000", "0001"]
