# ruff: noqa: T201 - what was measured is printed
"""A simulated hour, fed live at ten times real time: how late a closure is shown, and memory.

``python -m tests.long.benchmarks.bench_live`` simulates a ring of 30 submaps, and drives it ten
times: each time other points of it are seen, with noise, and odometry drifts on. A robot of its own
process sends the 300 submaps to a viewer, one every 1.2 seconds. It prints

- the time from a submap being complete to its closures being drawn and told, 95th percentile;
- the memory of the viewer at the end, against that after 50 submaps;
- whether the drive, computed anew of its record, is the same, and ends as `gpgrad slam` does.
"""

import argparse
import json
import multiprocessing
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

import gpgrad_core as gg
from app.viewer.session.following import MEMORY, Following
from app.viewer.viewer import Viewer
from gpgrad_core.detection import MapDetector
from gpgrad_core.live.server import Server
from gpgrad_core.run.memo import Memo
from gpgrad_core.simulation.demo import loop_params
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.slam import Drive, Moment, read_run

RING, SCAN_SHARE, NOISE = 30, 0.7, 0.005
EARLY = 50


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.long.benchmarks.bench_live")
    parser.add_argument("--submaps", type=int, default=300)
    parser.add_argument("--every", type=float, default=1.2, help="seconds between submaps")
    parser.add_argument("--no-replay", action="store_true", help="do not compute the drive anew")
    parser.add_argument("--feed", nargs=2, metavar=("ADDRESS", "FOLDER"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.feed:
        feed(*asked.feed, asked.every)
        return
    with tempfile.TemporaryDirectory(prefix="live-") as name:
        folder = Path(name)
        making = multiprocessing.get_context("spawn").Process(
            target=make_laps, args=(folder, asked.submaps)
        )  # a process of its own, so that its memory is not the viewer's
        making.start()
        making.join()
        record = folder / "run.gpgrad"
        measure(folder, record, asked.submaps, asked.every)
        if not asked.no_replay:
            replay(record)


def make_laps(folder: Path, count: int) -> None:
    """Write the submaps of all laps."""
    params = replace(loop_params(), num_submaps=RING)
    ring = simulate_dataset(params).submaps
    rng = np.random.default_rng(0)
    for k in range(count):
        submap = ring[k % RING]
        points = submap.points[rng.random(submap.num_points) < SCAN_SHARE]
        points = points + rng.normal(0, NOISE, points.shape)
        assert submap.pose_true is not None
        drift = gg.Pose.from_planar(gg.SE2(0.004 * k, 0.003 * k, 0.0005 * k))
        pose = drift @ submap.pose_true
        np.savez(
            folder / f"{k:04d}.npz",
            points=points.astype(np.float32),
            pose=[*pose.translation, *pose.quaternion],
        )


def feed(address: str, folder: str, every: float) -> None:
    """Be the robot: print when each submap was complete, and when its track was told."""
    told: dict[str, float] = {}

    def hear(_: object) -> None:
        now = time.time()
        for name in live.track:
            told.setdefault(name, now)

    complete: dict[str, float] = {}
    with gg.Live(address, on_corrected=hear, patience=300.0) as live:
        files = sorted(Path(folder).glob("*.npz"))
        begun = time.time()
        for k, file in enumerate(files):
            with np.load(file) as held:
                points, numbers = held["points"], held["pose"]
            time.sleep(max(0.0, begun + k * every - time.time()))
            complete[file.stem] = time.time()
            live.add(points, gg.Pose(numbers[:3], numbers[3:]), id=file.stem, wait=False)
        while len(told) < len(files):
            time.sleep(0.1)
    print(json.dumps({"complete": complete, "told": told}))


def measure(folder: Path, record: Path, count: int, every: float) -> None:
    server = Server(port=0)
    following = Following(server, gg.PipelineParams(), print, record=record)
    viewer = Viewer(following.open, port=0, memory=MEMORY)
    robot = subprocess.Popen(
        [
            *(sys.executable, "-m", "tests.long.benchmarks.bench_live", "--every", f"{every}"),
            *("--feed", f"localhost:{server.port}", str(folder)),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    drawn: dict[int, float] = {}
    memory: dict[int, int] = {}
    process, done = psutil.Process(), threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            sessions = viewer.sessions
            if not sessions:
                continue
            number = len(sessions[0].timeline.moments)
            if number not in drawn and sessions[0].world.is_drawn(0.0):
                now = time.time()
                for earlier in range(number, 0, -1):  # of several at once, all are drawn
                    if earlier in drawn:
                        break
                    drawn[earlier] = now
            if number not in memory:
                memory[number] = sum(
                    p.memory_info().rss
                    for p in (process, *process.children(recursive=True))
                    if p.pid != robot.pid
                )

    watching = threading.Thread(target=watch)
    watching.start()
    said, _ = robot.communicate()
    drive, patience = following.drive, time.monotonic() + 60.0
    assert drive is not None
    while not drive.is_settled and time.monotonic() < patience:
        time.sleep(0.5)
    time.sleep(2.0)
    done.set()
    watching.join()
    viewer.close()
    following.close()
    times = json.loads(said.splitlines()[-1])
    moments = drive.moments
    names = [moment.submap_id for moment in moments]
    closing = [
        k
        for k, moment in enumerate(moments)
        if any(c.database_id != names[k - 1] for c in moment.accepted)
    ]
    for what, ended in (
        ("told to the robot", {k: times["told"][names[k]] for k in range(count)}),
        ("drawn", {k: drawn.get(k + 1, np.inf) for k in range(count)}),
    ):
        if not closing:
            print("no submap closes a loop; drive more than one lap")
            break
        late = np.array([ended[k] - times["complete"][names[k]] for k in closing])
        print(
            f"{len(closing)} of {count} submaps close loops; from complete to {what}: median "
            f"{np.median(late):.2f} s, 95th percentile {np.percentile(late, 95):.2f} s"
        )
    early, end = memory[min(EARLY, max(memory))], memory[max(memory)]
    print(
        f"memory after {EARLY} submaps {early / 1e6:.0f} MB, at the end {end / 1e6:.0f} MB: "
        f"{end / early:.2f} times"
    )
    used = process.cpu_times()
    print(
        f"{following.counts.spelled()}; {(used.user + used.system) / count:.2f} s of a processor "
        f"each, at a load of {psutil.getloadavg()[0]:.0f} on {psutil.cpu_count()} processors"
    )


def replay(record: Path) -> None:
    run = read_run(record)
    settings = run.settings
    memo = Memo(200_000_000)
    with Drive(
        settings.params,
        settings.graph,
        settings.solver,
        detector=MapDetector(settings.params, memo),
        candidates=settings.candidates,
        incremental=settings.incremental,
    ) as drive:
        for submap in run.submaps:
            drive.add(submap)
        drive.settle()
        same = [
            is_same(one, moment) for one, moment in zip(drive.moments, run.moments, strict=True)
        ]
        graph = gg.build_pose_graph(run.dataset, drive.closures, settings.graph)
        whole = gg.optimise_pose_graph(graph, settings.solver)
        ends = np.array_equal(run.moments[-1].places, whole.history[-1])
    print(f"computed anew of the record: {sum(same)} of {len(same)} moments are identical")
    print(f"the record ends {'as' if ends else 'NOT as'} gpgrad slam does")


def is_same(first: Moment, second: Moment) -> bool:
    def verdicts(moment: Moment) -> list[tuple[str, str, bool, float]]:
        return [
            (c.query_id, c.database_id, c.accepted, c.registration.score) for c in moment.closures
        ]

    return bool(np.array_equal(first.places, second.places)) and verdicts(first) == verdicts(second)


if __name__ == "__main__":
    main()
