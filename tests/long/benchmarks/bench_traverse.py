# ruff: noqa: T201 - a command that prints tables
"""A long simulated traverse through `detect`: ``python -m tests.long.benchmarks.bench_traverse``.

It makes the traverse (`gpgrad simulate --route roaming`), compares its submaps as `gpgrad detect`
does, and prints times, memory, precision and recall. With ``--kills 2`` it runs the command itself
as well, kills it twice on the way, and compares the file with that of a run that was left alone.
"""

import json
import math
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tyro
from scipy.spatial import cKDTree

from gpgrad_core.detection import (
    MapDetector,
    Pairs,
    PipelineParams,
    resolve_parameters,
    with_store,
)
from gpgrad_core.detection.consistency import own_registration
from gpgrad_core.detection.shortlist import Candidates, read_candidates
from gpgrad_core.evaluation.rules import MAX_OFFSET, MAX_TURN
from gpgrad_core.io.folder import open_dataset, outline_dataset
from gpgrad_core.io.records.closures import (
    ClosureWriter,
    read_closures,
    report_closures,
    restore_closures,
)
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import Dataset, LoopClosure, SubmapSource

STAGES = {"maps and keypoints": (0.0, 0.5), "shortlist": (0.5, 0.6), "pairs": (0.6, 1.0)}
"""The part of the progress that each stage takes; see `detection.pairs`."""
NEIGHBOURS = 3
"""Submaps whose numbers differ by no more than this are no revisit."""
LOOK_EVERY = 20.0
"""Seconds between two looks at the memory; each takes half a second of a core in the end."""
WINDOW = 0.2
"""Share of the submaps so far over which a time is averaged."""
GPGRAD = (sys.executable, "-m", "app")


@dataclass(frozen=True)
class Bench:
    """Arguments.

    Attributes:
        submaps: Number of submaps.
        points: Points of a submap.
        early: Number of a submap near which times are compared with those at the end.
        folder: Where the traverse and the results are kept.
        candidates: With how many earlier submaps each is compared.
        kills: How often another run is killed before it may end.
        simulate_only: Whether to make the traverse only.
        judge_only: Whether to judge what was compared before anew, without comparing.
        plot: Where to draw times and memory over the number of submaps.
    """

    submaps: int = 1_000
    points: int = 5_000
    early: int = 1_000
    folder: Path = Path("build/bench_traverse")
    candidates: str = "automatic"
    kills: int = 0
    simulate_only: bool = False
    judge_only: bool = False
    plot: Path | None = None


@dataclass
class Watch:
    """What is seen of a run while it goes on.

    Attributes:
        progress: Fractions done, with the time of each [s].
        memory: Memory of the process and its children, with the time of each [s, bytes].
        num_compared: With how many earlier submaps each was compared, which is known at the end.
    """

    progress: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    memory: list[tuple[float, int]] = field(default_factory=list[tuple[float, int]])
    num_compared: list[int] = field(default_factory=list[int])

    def __call__(self, fraction: float) -> None:
        """Note the progress."""
        self.progress.append((time.monotonic(), fraction))

    @contextmanager
    def watching(self) -> Generator[None]:
        """Look at the memory now and then; to count 2 GB takes a quarter of a second."""
        ended, own = threading.Event(), psutil.Process()

        def look() -> None:
            while not ended.wait(LOOK_EVERY):
                family = [own, *own.children(recursive=True)]
                self.memory.append((time.monotonic(), sum(map(_unique, family))))

        thread = threading.Thread(target=look)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def when(self, stage: str, numbers: Any, count: int) -> Any:
        """Tell when a stage was done with so many submaps of all [s]."""
        low, high = STAGES[stage]
        shares = np.asarray(numbers) / count
        if stage == "pairs":
            compared = np.cumsum([0, *self.num_compared])
            shares = np.interp(numbers, np.arange(count + 1), compared / compared[-1])
        times, fractions = np.array(self.progress).T
        return np.interp(low + shares * (high - low), fractions, times)

    def seconds_at(self, stage: str, number: int, count: int) -> float:
        """Compute the time that a stage took for a submap, of those before a number [s]."""
        window = max(round(WINDOW * number), 1)
        first, last = self.when(stage, [number - window, number], count)
        return float(last - first) / window


def _unique(process: psutil.Process) -> int:
    """Read the memory that a process shares with no other [bytes]."""
    try:
        return int(process.memory_full_info().uss)
    except psutil.Error:
        return 0


def main() -> None:
    """Measure."""
    bench = tyro.cli(Bench)
    bench.folder.mkdir(parents=True, exist_ok=True)
    data = bench.folder / f"traverse_{bench.submaps}"
    if not data.exists():
        start = time.monotonic()
        route = ("--route", "roaming", "--num-submaps", bench.submaps, "--max-points", bench.points)
        _run("simulate", data, *route)
        print(f"simulated {bench.submaps:,} submaps in {time.monotonic() - start:.0f} s")
    if bench.simulate_only:
        return
    out = bench.folder / f"closures_{bench.submaps}.json"
    if bench.judge_only:
        _tell_quality(*_judge(data, out))
        return
    with tempfile.TemporaryDirectory(dir=bench.folder) as cache:
        watch, closures = Watch(), list[LoopClosure]()
        candidates = read_candidates(bench.candidates)
        start = time.monotonic()
        with watch.watching():
            detected = _detect(data, out, candidates, Store(Path(cache)), watch, closures)
        dataset, sources, counted = detected
        print(f"compared {counted:,} pairs in {time.monotonic() - start:.0f} s")
        _tell_times(watch, bench)
        if bench.plot is not None:
            _draw(watch, bench.submaps, bench.plot)
        _tell_quality(dataset, sources, closures)
    if bench.kills:
        _kill(bench, data, out)


def _detect(
    data: Path,
    out: Path,
    candidates: Candidates,
    store: Store,
    watch: Watch,
    accepted: list[LoopClosure],
) -> tuple[Dataset, tuple[SubmapSource, ...], int]:
    """Do what `gpgrad detect` does, and watch it."""
    outline = outline_dataset(data)
    with workers(num_workers(), len(outline.clouds)) as readers:
        dataset, sources = open_dataset(outline, executor=readers)
    some = [sources[k].load() for k in representative(len(sources))]
    params = resolve_parameters(some, PipelineParams())
    with (
        ClosureWriter(out) as writer,
        workers(num_workers(), len(sources) ** 2) as executor,
    ):

        def take(closure: LoopClosure) -> None:
            writer.add(closure)
            if closure.accepted:
                accepted.append(closure)

        room = store.with_room(2_000_000 * len(sources))
        pairs = Pairs(
            dataset.submaps,
            params,
            with_store(MapDetector(params, Memo()), room),
            candidates=candidates,
        )
        pairs.compare(None, executor, watch, sources=sources, on_verdict=take)
        result = pairs.result()
        watch.num_compared = [
            len(result.shortlists.get(submap.id, range(earlier)))
            for earlier, submap in enumerate(dataset.submaps)
        ]
        report = report_closures(dataset, result, params, sources=sources)
        skipped = math.comb(len(sources), 2) - writer.num_pairs
        writer.write(replace(report, num_pairs_skipped=skipped))
    print("stages: " + ", ".join(f"{name} {spent:.0f} s" for name, spent in result.seconds.items()))
    return dataset, sources, writer.num_pairs


def _judge(
    data: Path, compared: Path
) -> tuple[Dataset, tuple[SubmapSource, ...], list[LoopClosure]]:
    """Judge the pairs of a file of closures together, by the defaults; gives what is accepted."""
    dataset, sources = open_dataset(data)
    closures = restore_closures(read_closures(compared))
    known = {closure.pair: own_registration(closure) for closure in closures}
    closures = Pairs.of(dataset.submaps, known, PipelineParams()).judge()
    return dataset, sources, [one for one in closures if one.accepted]


def _tell_times(watch: Watch, bench: Bench) -> None:
    print(f"| stage | ms a submap at {bench.early:,} | at {bench.submaps:,} |\n|---|---|---|")
    for stage in STAGES:
        cells = [
            f"{1000 * watch.seconds_at(stage, min(at, bench.submaps), bench.submaps):.0f}"
            for at in (bench.early, bench.submaps)
        ]
        print(f"| {stage} | {' | '.join(cells)} |")
    times, memory = np.array(watch.memory).T
    done = np.interp(times, *np.array(watch.progress).T)
    for low, high in STAGES.values():
        part = memory[(done >= low) & (done <= high)]
        print(f"memory while {low:.0%} to {high:.0%}: at most {part.max() / 1e6:.0f} MB")


def _draw(watch: Watch, count: int, path: Path) -> None:
    """Draw the time a submap and the memory over the number of submaps."""
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    edges = np.linspace(0, count, 51)
    times, memory = np.array(watch.memory).T
    for stage in STAGES:
        when = watch.when(stage, edges, count)
        axes[0].stairs(1000 * np.diff(when) / np.diff(edges), edges, label=stage)
        # A short stage may pass between two looks.
        ends = pairwise(zip(when, np.interp(when, times, memory), strict=True))
        most = [
            memory[(times >= first) & (times < last)].max(initial=max(before, after))
            for (first, before), (last, after) in ends
        ]
        axes[1].stairs(np.array(most) / 1e6, edges, label=stage)
    axes[0].set_ylabel("time a submap [ms]")
    axes[1].set_ylabel("memory [MB]")
    axes[1].set_xlabel("submaps done in a stage")
    for one in axes:
        one.set_ylim(bottom=0)
        one.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        one.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _tell_quality(
    dataset: Dataset, sources: tuple[SubmapSource, ...], accepted: list[LoopClosure]
) -> None:
    """Compare what was accepted with the true poses."""
    places = dataset.index
    poses = [submap.pose_true for submap in dataset.submaps]
    # A camera looks ahead: the middle of its ground is not where the rover stood.
    middles, radii = zip(*(_disc(source) for source in sources), strict=True)
    radius = float(np.median(radii))
    where = np.array(
        [
            pose.apply(np.array([[*middle, 0.0]]))[0, :2]
            for pose, middle in zip(poses, middles, strict=True)
            if pose is not None
        ]
    )
    right = wrong = apart = 0
    found: set[tuple[int, int]] = set()
    for one in accepted:
        query, database = places[one.query_id], places[one.database_id]
        of_query, of_database = poses[query], poses[database]
        motion = one.registration.T_database_query
        assert of_query is not None
        assert of_database is not None
        assert motion is not None
        true = of_database.planar.inverse() @ of_query.planar
        error = true.inverse() @ motion
        found.add((query, database))
        if np.hypot(error.x, error.y) <= MAX_OFFSET and abs(error.yaw) <= math.radians(MAX_TURN):
            right += 1
        elif np.linalg.norm(where[query] - where[database]) > 2 * radius:
            apart += 1
        else:
            wrong += 1
    print(f"accepted: {right:,} right, {wrong} with a wrong motion, {apart} far apart")
    pairs = cKDTree(where).query_pairs(2 * radius, output_type="ndarray")
    query, database = pairs.max(axis=1), pairs.min(axis=1)
    revisit = query - database > NEIGHBOURS
    query, database = query[revisit], database[revisit]
    share = _overlap(np.linalg.norm(where[query] - where[database], axis=1) / radius)
    held = np.array([pair in found for pair in zip(query.tolist(), database.tolist(), strict=True)])
    print("| common ground | revisits | found |\n|---|---|---|")
    for low, high in ((0.0, 0.2), (0.2, 0.4), (0.4, 0.6), (0.6, 0.8), (0.8, 1.01)):
        inside = (share >= low) & (share < high)
        if inside.any():
            found_share = held[inside].mean()
            print(f"| {low:.0%} to {min(high, 1):.0%} | {inside.sum():,} | {found_share:.3f} |")


def _disc(source: SubmapSource) -> tuple[Any, float]:
    """Measure a submap's ground: its middle (2,), and the radius around it [m]."""
    points = source.load().points[:, :2]
    middle = np.median(points, axis=0)
    return middle, float(np.percentile(np.linalg.norm(points - middle, axis=1), 95))


def _overlap(distance: Any) -> Any:
    """Compute the share of a disc of radius 1 that another one covers at some distance."""
    half = np.clip(distance / 2, 0, 1)
    return 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))


def _kill(bench: Bench, data: Path, out: Path) -> None:
    """Kill a run some times on the way, and compare what it makes in the end."""
    again = bench.folder / "killed.json"
    again.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory(dir=bench.folder) as cache:
        command = [*GPGRAD, "detect", str(data), "--out", str(again), "--cache", cache]
        command += ["--candidates", bench.candidates]
        for _ in range(bench.kills):
            run = subprocess.Popen(command, stderr=subprocess.DEVNULL)
            wait = random.uniform(15, 0.06 * bench.submaps)
            try:
                run.wait(wait)
            except subprocess.TimeoutExpired:
                run.send_signal(signal.SIGKILL)
                run.wait()
                print(f"killed after {wait:.0f} s; a file was left: {again.exists()}")
        start = time.monotonic()
        subprocess.run(command, check=True)
        print(f"the last run took {time.monotonic() - start:.0f} s")
        start = time.monotonic()
        again.rename(bench.folder / "first.json")
        for flags in (("--closure.min-score", "5"), ("--registration.inlier-radius", "0.4")):
            start = time.monotonic()
            subprocess.run([*command, *flags, "--overwrite"], check=True)
            print(f"again with {' '.join(flags)}: {time.monotonic() - start:.0f} s")
    contents = [json.loads(path.read_text()) for path in (out, bench.folder / "first.json")]
    for content in contents:
        content.pop("seconds")
    print(f"the same content: {contents[0] == contents[1]}")


def _run(*arguments: object) -> None:
    subprocess.run([*GPGRAD, *map(str, arguments)], check=True)


if __name__ == "__main__":
    main()
