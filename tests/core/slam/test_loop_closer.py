"""Submap by submap the same comes out as all at once."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from gpgrad_core.detection import StagedDetector, detect_loop_closures
from gpgrad_core.errors import InputError
from gpgrad_core.run import Cancelled, Progress, silent
from gpgrad_core.slam import LoopCloser, build_pose_graph, optimise_pose_graph
from gpgrad_core.types import Agreement, Registration, Submap
from tests.core.slam.simulated import Traverse, simulate

NOTHING = Registration(None, np.zeros(0, bool), np.inf, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Oracle(StagedDetector[Any, Any]):
    """A detector that knows what there is to be found, and counts what it is asked."""

    known: dict[tuple[str, str], Registration]
    compared: list[tuple[str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, traverse: Traverse) -> "Oracle":
        return cls({closure.pair: closure.registration for closure in traverse.closures})

    def agreeing(self) -> "Oracle":
        """Let the pairs say something of each other."""
        for k, (pair, registration) in enumerate(self.known.items()):
            agreement = Agreement(0.01, 0.01 + 0.001 * (k % 5), 0.15)
            found = replace(registration, score=2.0 + k % 3, scale=0.3, agreement=agreement)
            self.known[pair] = found
        return self

    def infer(self, submap: Submap, progress: Progress = silent) -> tuple[str, np.ndarray]:
        progress(1.0)
        return submap.id, np.zeros(1000)

    def compare(
        self, query: tuple[str, np.ndarray], database: tuple[str, np.ndarray]
    ) -> Registration:
        self.compared.append((query[0], database[0]))
        return self.known.get((query[0], database[0]), NOTHING)


@pytest.mark.parametrize("in_memory", [10**9, 30_000])
def test_the_same_as_all_at_once(in_memory: int) -> None:
    traverse = simulate(15, row=5, wrong=0.1)
    together = detect_loop_closures(traverse.dataset, detector=Oracle.of(traverse))
    batch = optimise_pose_graph(build_pose_graph(traverse.dataset, together.closures))
    with LoopCloser(detector=Oracle.of(traverse), bytes_in_memory=in_memory) as closer:
        for k, submap in enumerate(traverse.dataset.submaps):
            step = closer.add(submap)
            assert list(step.poses) == [one.id for one in traverse.dataset.submaps[: k + 1]]
            assert len(step.closures) == k
        online = closer.result
        closures = closer.closures
    assert [(c.pair, c.accepted) for c in closures] == [
        (c.pair, c.accepted) for c in together.closures
    ]
    assert any(closure.accepted for closure in closures)
    np.testing.assert_array_equal(online.history, batch.history)
    assert [fit.weight for fit in online.edges] == [fit.weight for fit in batch.edges]


def test_the_other_pairs_say_the_same_as_all_at_once() -> None:
    traverse = simulate(15, row=5, wrong=0.1)
    oracle = Oracle.of(traverse).agreeing()
    together = detect_loop_closures(traverse.dataset, detector=oracle).closures
    with LoopCloser(detector=Oracle(oracle.known)) as closer:
        early = [closure for s in traverse.dataset.submaps for closure in closer.add(s).closures]
        closures = closer.closures
    last, whole, first = (
        [(c.pair, c.accepted, c.reason, c.context) for c in some]
        for some in (closures, together, early)
    )
    assert last == whole
    supports = [c.context.support for c in closures if c.context is not None]
    assert min(supports) < 0 < max(supports)
    assert last != first  # later pairs had a say


def test_poses_are_corrected_as_soon_as_a_loop_closes() -> None:
    traverse = simulate(24, row=6)
    true = traverse.true_poses
    with LoopCloser(detector=Oracle.of(traverse)) as closer:
        for submap in traverse.dataset.submaps:
            step = closer.add(submap)
    last = submap.id
    drifted = np.linalg.norm(submap.pose_odometry.translation - true[last].translation)
    corrected = np.linalg.norm(step.poses[last].translation - true[last].translation)
    assert corrected < 0.5 * drifted


def test_until_then_odometry_leads_on() -> None:
    traverse = simulate(5, row=5)
    with LoopCloser(detector=Oracle({})) as closer:
        for submap in traverse.dataset.submaps:
            step = closer.add(submap)
            np.testing.assert_allclose(
                step.poses[submap.id].translation, submap.pose_odometry.translation, atol=1e-9
            )
        assert not step.accepted


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

    def cancel(_: float) -> None:
        raise Cancelled

    with LoopCloser(detector=Oracle.of(traverse)) as closer:
        closer.add(first)
        with pytest.raises(InputError, match="0000 was already added"):
            closer.add(first)
        with pytest.raises(InputError, match="0001 has no odometry"):
            closer.add(replace(second, pose_odometry=None))
        with pytest.raises(Cancelled):
            closer.add(second, cancel)
        assert list(closer.add(second).poses) == ["0000", "0001"]
