"""One measured run, in a process of its own: it pays for nothing that another one loaded."""

import gc
import statistics
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import psutil

from tests.long.benchmarks.peers.adapters import METHODS
from tests.long.benchmarks.peers.cases import Answer, Case

WARM_UP = Case(num_points=300, side=2.5, resolution=0.1)
"""Small, but at the same density: whatever is loaded or compiled late is loaded by it."""
ROUNDS = 7
ROUNDS_SECONDS = 20.0
"""Rounds after the first end when this much time is spent; none if the first took half of it."""


@dataclass(frozen=True)
class Cost:
    """What a run took."""

    seconds: float  # median of the rounds; of the first round, where there is no other
    rounds: tuple[float, ...]  # [s], the first one apart where there are others
    peak_mb: float  # most memory held while solving, less what was held before [MB]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def serve(pipe: Connection, method: str, case: Case, answer: Path) -> None:
    """Solve a case and tell the parent: "ready" with the memory held, then a Cost or an error.

    The first round fills caches and is what the memory is taken from; the median is of those
    after it.
    """
    warnings.simplefilter("ignore")  # the libraries' own: nothing that the run could heed
    try:
        solve = METHODS[method].solve
        solve(WARM_UP.task())
        task = case.task()
        gc.collect()
        before = _start_watching_memory()
        pipe.send(before)
        first, solved = _timed(lambda: solve(task))
        peak = _highest_memory() - before
        solved.save(answer)
        del solved
        rounds: list[float] = []
        while len(rounds) < ROUNDS and sum(rounds) + first < ROUNDS_SECONDS / 2:
            rounds.append(_timed(lambda: solve(task))[0])
        rounds = rounds or [first]
        pipe.send(Cost(statistics.median(rounds), tuple(rounds), peak / 1e6))
    except MemoryError:
        pipe.send("out of memory")
    except Exception:  # a peer may fail in any way: the table says how
        pipe.send(traceback.format_exc(limit=-1).strip().splitlines()[-1][:200])


def _timed(action: Callable[[], Answer]) -> tuple[float, Answer]:
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def _start_watching_memory() -> float:
    """Forget the process's highest memory so far; returns the present one [bytes].

    Linux alone can forget it. ``getrusage`` would not do: its highest is inherited from the
    parent process, and imports may already have taken more than the run will.
    """
    Path("/proc/self/clear_refs").write_text("5")
    return float(psutil.Process().memory_info().rss)


def _highest_memory() -> float:
    """Highest resident memory since then [bytes]."""
    status = Path("/proc/self/status").read_text()
    (line,) = [line for line in status.splitlines() if line.startswith("VmHWM")]
    return 1024.0 * int(line.split()[1])
