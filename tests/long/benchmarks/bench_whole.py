# ruff: noqa: T201 - a command that prints a table
"""Both systems as a whole, on the same scans: ``poe bench-whole``.

``gpgrad simulate --scans`` makes recordings, and each system makes a trajectory of each one, in a
process of its own:

- **gpgrad** is `gpgrad build` and `gpgrad slam` with their defaults. It makes no odometry, so it is
  given one: that of the recording, or that of KISS-ICP. The second gives both systems the same,
  the scans and nothing else but the tilt of the first pose.
- **KISS-SLAM** makes its odometry (KISS-ICP) and its loop closures from the scans. Its lengths are
  made for cars, so three setups of them are tried (see `tests.long.benchmarks.whole.kiss`), and for
  each recording the table has the one with the smallest error, which nobody could choose without
  the truth. Its odometry before the loop closures is the row KISS-ICP, the best of the same three.

Nobody gets the truth otherwise. All are judged by the sensor's positions at all scans: root mean
square of their distances from the true ones, once after the rigid motion in space that fits best
and once from the same start. Seconds contain the start of Python.

It needs the extra `peers`; without KISS-SLAM only gpgrad is judged. Recordings are kept in
``--folder``. ``--quick`` runs all of it on one short recording, to see that it works.
"""

import importlib.util
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from tests.long.benchmarks.peers.tables import markdown
from tests.long.benchmarks.whole import judge
from tests.long.benchmarks.whole.judge import Score
from tests.long.benchmarks.whole.kiss import SETUPS
from tests.long.benchmarks.whole.recordings import DRIVES, QUICK, Drive
from tests.long.benchmarks.whole.running import gpgrad, run_module


@dataclass(frozen=True)
class Options:
    """Both systems as a whole, on the same scans."""

    folder: Path = Path("build/bench_whole")
    """Where recordings are kept."""
    only: tuple[str, ...] = ()
    """Names of the recordings to run, such as "LiDAR, rocks". None: all."""
    terrain: Path | None = None
    """GeoTIFF of an elevation model to drive over, as for gpgrad simulate."""
    cap: float = 900.0
    """Most seconds that KISS-SLAM may take with one setup; the table names those left out."""
    quick: bool = False
    """One short recording, to see that all of it works; its figures mean nothing."""


@dataclass(frozen=True)
class Line:
    """A row of the table: what a system made of a recording.

    Attributes:
        system: Its name, and what it was given.
        score: How far it is from the truth; None if it failed.
        closures: Number of loop closures; None if it has none.
        seconds: What it took; None for odometry that is given.
        failure: Why it failed.
    """

    system: str
    score: Score | None
    closures: int | None = None
    seconds: float | None = None
    failure: str = ""


def main(options: Options) -> int:
    """Measure and print."""
    drives = QUICK if options.quick else DRIVES
    unknown = set(options.only) - {drive.name for drive in drives}
    if unknown:
        print(f"no recording {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    options.folder.mkdir(parents=True, exist_ok=True)
    has_rival = importlib.util.find_spec("kiss_slam") is not None
    if not has_rival:
        print("KISS-SLAM is not installed: pip install 'gpgrad[peers]'", file=sys.stderr)
    rows: list[list[str]] = []
    for drive in drives:
        if options.only and drive.name not in options.only:
            continue
        recording = drive.record(options.folder, options.terrain)
        with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
            for line in run_all(drive, recording, Path(scratch), options, has_rival=has_rival):
                rows.append([drive.name, *describe(line)])
                print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    head = ["recording", "system", "best fit", "from the start", "loop closures", "time"]
    print(markdown(head, rows))
    return 0


def run_all(
    drive: Drive, recording: Path, scratch: Path, options: Options, *, has_rival: bool
) -> Iterator[Line]:
    """Run every system on a recording."""
    true = judge.poses_at_scans(recording, recording / "poses_gt.txt")
    given = judge.poses_at_scans(recording, recording / "poses.txt")
    yield Line("odometry of the recording", judge.score(true, given))
    yield run_ours("gpgrad, on that odometry", recording, recording / "poses.txt", scratch / "own")
    if not has_rival:
        return
    tried = run_rival(drive, recording, scratch, options.cap)
    alone, folder = best_of(tried, "KISS-ICP")
    yield alone
    if alone.score is not None:
        upright = scratch / "upright.txt"
        judge.write_upright(recording, folder / "odometry.txt", upright)
        yield run_ours("gpgrad, on KISS-ICP", recording, upright, scratch / "theirs")
    yield best_of(tried, "KISS-SLAM")[0]


def run_ours(name: str, recording: Path, poses: Path, folder: Path) -> Line:
    """Build submaps with an odometry, and correct it."""
    true = judge.poses_at_scans(recording, recording / "poses_gt.txt")
    dataset, out = folder / "dataset", folder / "map"
    folder.mkdir()
    try:
        spent = gpgrad("build", str(recording), "--out", str(dataset), "--poses", str(poses))
        spent += gpgrad("slam", str(dataset), "--out", str(out), "--no-merge", "--cache", "none")
    except RuntimeError as error:
        return Line(name, None, failure=str(error))
    found = judge.poses_of_submaps(dataset, out / "poses_corrected.txt")
    return Line(name, judge.score(true, found), judge.count_closures(out), spent)


def run_rival(drive: Drive, recording: Path, scratch: Path, cap: float) -> list[tuple[Line, Path]]:
    """Run KISS-SLAM with each setup; gives two rows of each, and the folder of its trajectories."""
    true = judge.poses_at_scans(recording, recording / "poses_gt.txt")
    tried: list[tuple[Line, Path]] = []
    for setup in SETUPS:
        out = scratch / setup
        flags = ("--setup", setup, "--max-range", f"{drive.max_range:g}")
        arguments = ("--recording", str(recording), "--out", str(out), *flags)
        failure, spent, closures = "", None, None
        try:
            spent = run_module("tests.long.benchmarks.whole.kiss", *arguments, cap=cap)
            closures = json.loads((out / "found.json").read_text())["closures"]
        except RuntimeError as error:
            failure = str(error)
        for system, name in (("KISS-ICP", "odometry.txt"), ("KISS-SLAM", "trajectory.txt")):
            title = f"{system} ({setup})"
            score = None
            if not failure:
                score = judge.score(true, judge.poses_at_scans(recording, out / name))
            whole = system == "KISS-SLAM"
            line = Line(title, score, closures if whole else None, spent if whole else None)
            tried.append((replace(line, failure=failure), out))
            print("  tried:", " | ".join(describe(tried[-1][0])), file=sys.stderr, flush=True)
    return tried


def best_of(tried: list[tuple[Line, Path]], system: str) -> tuple[Line, Path]:
    """Take the row of a system with the smallest error; it names the setups that failed."""
    rows = [one for one in tried if one[0].system.startswith(system)]
    best, folder = min(rows, key=lambda one: one[0].score.fitted if one[0].score else float("inf"))
    failed = [f"; {row.system}: {row.failure}" for row, _ in rows if row.failure and row != best]
    return replace(best, system=best.system + "".join(failed)), folder


def describe(line: Line) -> list[str]:
    """Spell a row without its recording."""
    if line.score is None:
        return [line.system, f"failed: {line.failure}", "-", "-", "-"]
    lost = " (lost)" if line.score.lost else ""
    partly = "" if line.score.share > 0.999 else f" ({line.score.share:.0%} of the scans)"
    return [
        line.system,
        f"{line.score.fitted:.3f} m{lost}{partly}",
        f"{line.score.from_start:.3f} m",
        "-" if line.closures is None else str(line.closures),
        "-" if line.seconds is None else f"{line.seconds:.0f} s",
    ]


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
