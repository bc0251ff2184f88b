"""The GP against its peers: ``python -m tests.long.benchmarks.bench_peers --json RAW.json``.

Same points, same grid, same run, each method in a process of its own with all cores. Needs the
extras `dev`, `bench` and `bench-torch`; a peer that is not installed is left out, and the table
says so. Linux only, for the peak memory.

Tables go to standard output, the figure of cost to assets/pictures/gp_peers.png, all figures to
the JSON. ``--parts`` measures some parts anew and takes the others from the JSON; with no name
after it, it draws the tables and the figure once more. On two quiet cores everything takes
about two hours: `table` and `ski` three quarters of an hour each, `points` and `area` as much
together (a quarter of an hour with ``--growth-seconds 20``), `targets` ten minutes. ``--quick``
runs it all in small, in a few minutes, to see that it works.
"""

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from gpgrad_core.run.threads import num_workers
from tests.long.benchmarks.bench_gp import machine
from tests.long.benchmarks.peers import tables
from tests.long.benchmarks.peers.adapters import DENSE
from tests.long.benchmarks.peers.cases import Answer
from tests.long.benchmarks.peers.figure import draw
from tests.long.benchmarks.peers.measure import Run, measure
from tests.long.benchmarks.peers.plan import Part, PartName, full_plan, quick_plan

PICTURE = Path(__file__).resolve().parents[3] / "assets" / "pictures" / "gp_peers.png"
EVERYTHING: tuple[PartName, ...] = ("table", "ski", "points", "area", "targets")


@dataclass(frozen=True)
class Options:
    """The GP against its peers: seconds, memory and error, as tables and a figure."""

    json: Path | None = None
    """Where the raw figures go, and from where parts come that are not measured."""
    picture: Path | None = None
    """Where the figure goes; if not named, assets/pictures/gp_peers.png (with quick, nowhere)."""
    parts: tuple[PartName, ...] = EVERYTHING
    """What to measure."""
    methods: tuple[str, ...] = ()
    """Measure, and keep of the parts measured, these only; the dense form runs besides, for the
    errors. None: all."""
    table_seconds: float = 900.0
    """Most that one solution may take in `table`, `ski` and `targets`."""
    growth_seconds: float = 60.0
    """The same in `points` and `area`, beyond which a method is followed no further."""
    quick: bool = False
    """The same in small, to see that all of it works; its figures mean nothing."""


def main(options: Options) -> int:
    """Measure, write, and print; 1 if a target is missed."""
    share_cores()
    plan = (
        quick_plan() if options.quick else full_plan(options.table_seconds, options.growth_seconds)
    )
    stored = load(options.json)
    for name in options.parts:
        part = plan[name]
        runs = [run.as_dict() for run in measure_part(part, options.methods)]
        stored[name] = {
            "title": part.title,
            "machine": machine(),
            "caps": f"{part.caps.seconds:g} s or {part.caps.megabytes / 1000:g} GB",
            "runs": runs,
        }
        if options.json is not None:  # after each part: the others may take long
            options.json.write_text(json.dumps(stored, indent=1) + "\n")
    met = report(stored)
    picture = options.picture or (None if options.quick else PICTURE)
    if picture is not None and "points" in stored and "area" in stored:
        draw_figure(stored, picture)
    return int(not met and not options.quick)


def share_cores() -> None:
    """Give every library of the processes to come the same cores."""
    for name in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
        os.environ[f"{name}_NUM_THREADS"] = str(num_workers())


def load(path: Path | None) -> dict:
    """Read what was measured before, if there is any."""
    return json.loads(path.read_text()) if path is not None and path.exists() else {}


def measure_part(part: Part, only: tuple[str, ...]) -> list[Run]:
    """Measure each method on each case, the oracle first; a table keeps the methods' order."""
    wanted = [method for method in part.methods if not only or method in (*only, DENSE)]
    gone_over: set[str] = set()
    done: list[Run] = []
    for case in part.cases:
        oracle: Answer | None = None
        for method in sorted(wanted, key=lambda method: method != DENSE):
            spared = part.growing and method in gone_over
            if method == DENSE and part.dense_cases is not None:
                spared = case not in part.dense_cases
            if spared:
                continue
            run, answer = measure(method, case, part.caps, oracle)
            if method == DENSE and answer is not None:
                oracle = answer
            if run.cost is None:
                gone_over.add(method)
            done.append(run)
            took = tables.seconds(run.cost.seconds) if run.cost else run.failure
            print(f"{case.name}: {method}: {took}", file=sys.stderr, flush=True)  # noqa: T201
    return sorted(done, key=lambda run: wanted.index(run.method))


def runs_of(part: dict) -> list[Run]:
    """Read a part's runs."""
    return [Run.from_dict(run) for run in part["runs"]]


def report(stored: dict) -> bool:
    """Print all tables; whether ours reaches everything that was measured."""
    all_met = True
    for name in EVERYTHING:
        if name not in stored:
            continue
        part, runs = stored[name], runs_of(stored[name])
        verdict, met = "", True
        if name in ("points", "area"):
            table = tables.follow_growth(runs, name)
        else:
            table = tables.compare(runs)
            check = tables.check_targets if name == "targets" else tables.check_peers
            verdict, met = check(runs)
        all_met = all_met and met
        note = f"{part['machine']}; one solution up to {part['caps']}"
        print(f"\n## {part['title']}\n\n{note}\n\n{table}\n\n{verdict}")  # noqa: T201
    return all_met


def draw_figure(stored: dict, path: Path) -> None:
    """Draw the cost against points and against area."""
    points, area = stored["points"], stored["area"]
    draw(runs_of(points), runs_of(area), points["machine"], points["caps"], path)


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
