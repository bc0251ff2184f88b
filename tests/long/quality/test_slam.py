"""How good maps become on real terrain, and how large they may be.

It takes minutes, and needs the real datasets.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection import DetectionResult, PipelineParams, detect_loop_closures
from gpgrad_core.io.folder import load_dataset, outline_dataset
from gpgrad_core.io.records.closures import (
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
)
from gpgrad_core.run.threads import num_workers
from gpgrad_core.se2 import SE2
from gpgrad_core.slam import (
    build_pose_graph,
    join_datasets,
    measure_errors,
    optimise_pose_graph,
    solve_datasets,
    trajectory_error,
)
from gpgrad_core.types import Dataset, LoopClosure, Submap
from tests.core.slam.simulated import simulate
from tests.end_to_end.process import ROOT, environment
from tests.support.ground import Ground

SETS = ("marsyard2021", "sthelens", "apollo15")
Found = Callable[[str], tuple[LoopClosure, ...]]


@pytest.fixture(scope="module")
def found(real_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Found:
    """Closures of a set; detected once, and kept as users keep them."""
    folder = tmp_path_factory.mktemp("closures")

    def detect(name: str) -> tuple[LoopClosure, ...]:
        path = folder / f"{name}.json"
        if not path.exists():
            dataset = load_dataset(real_data / name)
            with ThreadPoolExecutor(num_workers()) as executor:
                result = detect_loop_closures(dataset, executor=executor)
            write_closures(path, report_closures(dataset, result, PipelineParams()))
        return restore_closures(read_closures(path))

    return detect


@pytest.mark.parametrize("name", SETS)
def test_the_drift_is_gone(name: str, real_data: Path, found: Found) -> None:
    solution = solve_datasets(join_datasets([outline_dataset(real_data / name)]), found(name))
    judged = measure_errors(solution)
    before, after = judged.trajectories[name]
    first, last = judged.overlaps
    assert first.median is not None
    assert last.median is not None
    assert last.high is not None
    say(
        f"{name}: {len(solution.result.loops)} closures, {len(solution.result.refused)} refused; "
        f"error {told(before.absolute, after.absolute)}, as it is "
        f"{told(before.absolute_unaligned, after.absolute_unaligned)}, a step "
        f"{told(before.relative, after.relative)}; heights differ by "
        f"{told(first.median, last.median)} (95 %: {100 * last.high:.1f} cm)"
    )
    assert after.absolute <= 0.25 * before.absolute
    assert after.absolute_unaligned <= 0.25 * before.absolute_unaligned
    assert last.median <= 0.05


@pytest.mark.parametrize("name", SETS)
def test_one_wrong_closure_in_five_does_no_harm(name: str, real_data: Path, found: Found) -> None:
    dataset = load_dataset(real_data / name)
    true, right = dataset.true_poses, [one for one in found(name) if one.accepted]

    def error(closures: list[LoopClosure]) -> tuple[float, int]:
        result = optimise_pose_graph(build_pose_graph(dataset, closures))
        return trajectory_error(true, result.poses).absolute, len(result.refused)

    clean, _ = error(right)
    lines: list[float] = []
    for seed in range(10):
        wrong = make_up(dataset, right, round(len(right) / 4), np.random.default_rng(seed))
        mixed, refused = error([*right, *wrong])
        lines.append(mixed / clean)
        say(
            f"{name}, seed {seed}: {len(wrong)} wrong, {refused} refused: {mixed / clean:.3f} times"
        )
    assert max(lines) <= 1.3


def make_up(
    dataset: Dataset, right: list[LoopClosure], count: int, rng: np.random.Generator
) -> list[LoopClosure]:
    """Wrong closures between random submaps, as sure of themselves as the right ones are."""
    taken = {(one.query_id, one.database_id) for one in right}
    wrong: list[LoopClosure] = []
    while len(wrong) < count:
        a, b = sorted(int(k) for k in rng.choice(len(dataset.submaps), 2, replace=False))
        pair = dataset.submaps[b].id, dataset.submaps[a].id
        if pair in taken:
            continue
        taken.add(pair)
        model = right[int(rng.integers(len(right)))].registration
        motion = SE2(*map(float, [*rng.uniform(-6, 6, 2), rng.uniform(-pi, pi)]))
        registration = replace(model, T_database_query=motion, z_offset=float(rng.normal(0, 0.3)))
        wrong.append(LoopClosure(*pair, registration, accepted=True, reason="made up"))
    return wrong


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_a_thousand_submaps_are_solved_in_seconds(share: float) -> None:
    traverse = simulate(1000, row=25, wrong=share)
    graph = build_pose_graph(traverse.dataset, traverse.closures)
    start, busy = time.perf_counter(), time.process_time()
    result = optimise_pose_graph(graph)
    seconds, busy = time.perf_counter() - start, time.process_time() - busy
    true = traverse.true_poses
    before, after = (trajectory_error(true, p).absolute for p in (graph.poses, result.poses))
    say(
        f"1,000 submaps, {len(graph.loops)} closures, {len(traverse.wrong)} of them wrong: "
        f"{seconds:.1f} s ({busy:.1f} s of processor), {len(result.refused)} refused, "
        f"{before:.2f} m -> {after:.2f} m"
    )
    assert busy < (5.0 if share == 0 else 10.0)  # wrong closures make matrices less sparse
    assert after < 0.05 * before


def test_memory_does_not_grow_with_the_submaps(tmp_path: Path) -> None:
    """As much ground again, seen as often: the same memory but for a few bytes a submap.

    The smaller one is wide enough for its middle to be seen by as many submaps as the larger's.
    """
    counts = (120, 240)
    peaks = [peak_memory(tmp_path, count) for count in counts]
    more = (counts[1] - counts[0]) * 30_000 * 24 / 1e6
    say(
        f"peak memory: {counts[0]} submaps {peaks[0]:.0f} MB, {counts[1]} submaps "
        f"{peaks[1]:.0f} MB ({more:.0f} MB more of points)"
    )
    assert peaks[1] < peaks[0] + 0.25 * more


COARSE = (
    *("--map.length-scale", "0.6", "--map.noise-std", "0.02"),  # the points have none
    *("--merged.resolution", "0.2", "--merged.voxel", "0.2"),
)


def peak_memory(folder: Path, count: int) -> float:
    """Of `gpgrad slam` on so many submaps with their closures [MB]."""
    ground, rng = Ground.random(5, std=0.3), np.random.default_rng(0)
    traverse = simulate(count, row=15)
    directory = folder / f"{count}"
    (directory / "submaps").mkdir(parents=True)
    submaps: list[Submap] = []
    for submap in traverse.dataset.submaps:
        assert submap.pose_true is not None
        xy = rng.uniform(-3, 3, (30_000, 2)) + submap.pose_true.translation[:2]
        points = submap.pose_true.inverse().apply(np.column_stack([xy, ground.height(xy)]))
        np.save(directory / "submaps" / f"{submap.id}.npy", points)
        submaps.append(submap)
    poses = {k: s.pose_odometry for k, s in enumerate(submaps)}
    rows = [
        f"{k} {' '.join(map(str, p.translation))} {' '.join(map(str, p.quaternion))}"
        for k, p in poses.items()
        if p is not None
    ]
    (directory / "poses_odom.txt").write_text("\n".join(rows) + "\n")
    result = DetectionResult(traverse.closures, {})
    write_closures(
        directory / "c.json", report_closures(traverse.dataset, result, PipelineParams())
    )
    code = (
        "import resource, sys; from app.cli import run; code = run(sys.argv[1:]); "
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss); sys.exit(code)"
    )
    arguments = ["slam", directory, "--out", directory / "out", "--closures", directory / "c.json"]
    finished = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments), *COARSE],
        capture_output=True,
        text=True,
        check=False,
        env=environment(),
        cwd=ROOT,
    )
    assert finished.returncode == 0, finished.stderr
    return int(finished.stdout.splitlines()[-1]) / 1e3


def told(before: float, after: float) -> str:
    return f"{before:.3f} m -> {after:.3f} m ({after / before:.1%})"


def say(line: str) -> None:
    print(f"\n{line}", end="")
