"""Runs the pipeline over many odd clouds and parameters, each in a process of its own.

``python -m tests.long.quality.any_cloud --sets 2000 [--seed N]`` prints, for each kind of cloud,
how many ended with a result, a refusal, a traceback, or beyond 30 seconds or 2 GB. The seconds are
those of the processor, which do not depend on what else the machine does.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import time
import traceback
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing.connection import Connection

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from gpgrad_core.errors import InputError
from tests.support.clouds import KINDS, draw_params, draw_submaps, run_pipeline

MOST_SECONDS, MOST_BYTES = 30.0, 2 * 1024**3
ENDED_AFTER, ENDED_BEYOND = 90, 6 * 1024**3
"""Where a child is ended: processor time [s], and address space [bytes]."""


@dataclass(frozen=True)
class Outcome:
    """How one set ended."""

    kind: str
    seed: int
    verdict: str
    seconds: float
    num_bytes: int
    said: str


def run_set(kind: str, seed: int, most_points: int) -> tuple[str, str]:
    """Run one set; return its verdict and what was said."""
    rng = np.random.default_rng(seed)
    try:
        params = draw_params(rng)
        with_noise = params.map.noise_model == "file"
        query, database = draw_submaps(kind, rng, most_points, with_noise=with_noise)
        closure = run_pipeline(query, database, params).closure
    except InputError as refusal:
        return "refusal", str(refusal)
    except MemoryError as error:
        return "over", f"no memory: {error}"
    except Exception:
        return "traceback", traceback.format_exc()
    return "result", closure.reason


def _child(answer: Connection, kind: str, seed: int, most_points: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (ENDED_AFTER, ENDED_AFTER + 5))
    resource.setrlimit(resource.RLIMIT_AS, (ENDED_BEYOND, ENDED_BEYOND))
    start = time.process_time()
    verdict, said = run_set(kind, seed, most_points)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    answer.send((verdict, said, time.process_time() - start, peak))


def run_apart(kind: str, seed: int, most_points: int) -> Outcome:
    """Run one set in a process of its own, with limits."""
    mine, theirs = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(
        target=_child, args=(theirs, kind, seed, most_points)
    )
    child.start()
    theirs.close()
    try:
        verdict, said, seconds, peak = mine.recv()
    except EOFError:
        verdict, said, seconds, peak = "over", "ended", float(ENDED_AFTER), 0
    child.join()
    if said == "ended":
        said = f"ended with exit code {child.exitcode}"
    if verdict == "result" and (seconds > MOST_SECONDS or peak > MOST_BYTES):
        verdict = "over"
    return Outcome(kind, seed, verdict, seconds, peak, said)


def main() -> int:
    """Run the sets and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--points", type=int, default=30_000, help="largest number of points")
    parser.add_argument("--kind", choices=list(KINDS), help="this kind of cloud alone")
    parser.add_argument("--at-once", type=int, default=1, help="number of processes")
    parser.add_argument("--all", action="store_true", help="print every set")
    asked = parser.parse_args()
    kinds = [asked.kind] if asked.kind else list(KINDS)
    print(f"seed {asked.seed}")
    sets = [(kinds[k % len(kinds)], asked.seed + k) for k in range(asked.sets)]
    found: list[Outcome] = []
    with ThreadPoolExecutor(asked.at_once) as executor:
        for one in executor.map(lambda at: run_apart(*at, asked.points), sets):
            found.append(one)
            if asked.all or one.verdict in ("traceback", "over"):
                print(
                    f"{one.verdict} {one.kind!r} seed {one.seed}, {one.seconds:.1f} s, "
                    f"{one.num_bytes / 1e6:.0f} MB: {one.said.strip()}",
                    flush=True,
                )
    verdicts = ("result", "refusal", "traceback", "over")
    print(f"{'kind':18}" + "".join(f"{name:>11}" for name in verdicts) + "   most s   most MB")
    for kind in [*kinds, "all"]:
        of_kind = [one for one in found if kind in (one.kind, "all")]
        counts = Counter(one.verdict for one in of_kind)
        slowest = max((one.seconds for one in of_kind), default=0.0)
        largest = max((one.num_bytes for one in of_kind), default=0) / 1e6
        row = "".join(f"{counts[name]:11}" for name in verdicts)
        print(f"{kind:18}{row}{slowest:9.1f}{largest:10.0f}")
    return int(any(one.verdict in ("traceback", "over") for one in found))


if __name__ == "__main__":
    sys.exit(main())
