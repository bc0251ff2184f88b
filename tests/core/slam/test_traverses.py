"""Traverses with no common frame come into one map by the closures between them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import Outline
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import JoinedDatasets, join_datasets, solve_datasets, trajectory_error
from gpgrad_core.types import Dataset, LoopClosure, Submap
from tests.core.slam.simulated import Traverse, simulate

FRAME = Pose.from_planar(SE2(300.0, -50.0, 2.0), 12.0)


def outline(name: str, submaps: Sequence[Submap]) -> Outline:
    files = tuple(Path(f"{submap.id}.ply") for submap in submaps)
    extents = {k: submap.extent for k, submap in enumerate(submaps)}
    return Outline(Dataset(name, tuple(submaps)), files, extents=extents)


def split(traverse: Traverse, at: int = 20) -> tuple[JoinedDatasets, tuple[LoopClosure, ...]]:
    """Cut a traverse in two, the second in another frame, with its closures renamed."""
    submaps = traverse.dataset.submaps
    second = [replace(s, pose_odometry=FRAME @ s.pose_odometry) for s in submaps[at:]]
    outlines = [outline("monday", submaps[:at]), outline("tuesday", second)]
    names = {s.id: f"{'monday' if k < at else 'tuesday'}:{s.id}" for k, s in enumerate(submaps)}
    closures = tuple(
        replace(c, query_id=names[c.query_id], database_id=names[c.database_id])
        for c in traverse.closures
    )
    return join_datasets(outlines), closures


@pytest.mark.parametrize("wrong", [0.0, 0.3])
def test_two_sessions_come_into_one_map(wrong: float) -> None:
    traverse = simulate(40, row=10, wrong=wrong)
    joined, closures = split(traverse)
    solution = solve_datasets(joined, closures)
    renamed = dict(zip(solution.result.poses, traverse.true_poses.values(), strict=True))
    assert trajectory_error(renamed, solution.result.poses).absolute < 0.4
    assert len(solution.result.refused) >= len(traverse.wrong)
    between = [c for c in closures if c.query_id.split(":")[0] != c.database_id.split(":")[0]]
    support = solution.placed.support["tuesday:0020"]
    assert 0.5 * (1 - wrong) * len(between) <= support <= len(between)
    for pose in solution.placed.graph.poses.values():
        assert pose.rotation[2, 2] == pytest.approx(1.0, abs=1e-6)  # level


def test_a_session_that_nothing_joins_is_refused_by_name() -> None:
    joined, closures = split(simulate(40, row=10))
    within = [c for c in closures if c.query_id.split(":")[0] == c.database_id.split(":")[0]]
    with pytest.raises(InputError, match="tuesday: no loop closure joins it to monday"):
        solve_datasets(joined, within)


def test_sessions_of_one_name_are_told_apart() -> None:
    outlines = [outline("yard", simulate(2, row=2).dataset.submaps)] * 2
    joined = join_datasets(outlines)
    assert list(joined.traverses) == ["yard", "yard-2"]
    assert joined.starts == ("yard-2:0000",)
    assert joined.numbers["yard-2:0001"] == 1
    alone = join_datasets(outlines[:1])
    assert list(alone.numbers) == ["0000", "0001"]
    assert alone.starts == ()
    with pytest.raises(InputError, match="one dataset or more"):
        join_datasets([])
