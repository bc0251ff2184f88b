"""Start a measured run, end it when it costs too much, and keep what came of it."""

import contextlib
import multiprocessing
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import psutil

from tests.long.benchmarks.peers.adapters import METHODS
from tests.long.benchmarks.peers.cases import Answer, Case, Errors
from tests.long.benchmarks.peers.worker import Cost, serve

POLL = 0.05  # [s]
PATIENCE = 600.0
"""Longest that imports, the small first run and drawing the cloud may take [s]."""


@dataclass(frozen=True)
class Caps:
    """What one solution may cost."""

    seconds: float = 60.0
    megabytes: float = 8000.0


@dataclass(frozen=True)
class Run:
    """One method on one case: what it cost, or why there is nothing to tell."""

    method: str
    case: Case
    cost: Cost | None = None
    errors: Errors | None = None
    fields: str = ""
    failure: str = ""  # "over 60 s", "over 8000 MB", or what the library said

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "method": self.method,
            "case": vars(self.case) | {"num_cells": self.case.num_cells},
            "cost": None if self.cost is None else self.cost.as_dict(),
            "errors": None if self.errors is None else self.errors.as_dict(),
            "fields": self.fields,
            "failure": self.failure,
        }

    @classmethod
    def from_dict(cls, stored: dict) -> "Run":
        """Read what `as_dict` gave."""
        case = {name: value for name, value in stored["case"].items() if name != "num_cells"}
        cost, errors = stored["cost"], stored["errors"]
        if cost is not None:
            cost = Cost(cost["seconds"], tuple(cost["rounds"]), cost["peak_mb"])
        return cls(
            stored["method"],
            Case(**case),
            cost,
            None if errors is None else Errors(**errors),
            stored["fields"],
            stored["failure"],
        )


def measure(
    method: str, case: Case, caps: Caps, oracle: Answer | None = None
) -> tuple[Run, Answer | None]:
    """Run a method in its own process; compare with the oracle's answer where there is one."""
    if not METHODS[method].available:
        return Run(method, case, failure=f"{METHODS[method].needs} is not installed"), None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "answer.npz"
        outcome = _outcome(method, case, caps, path)
        if isinstance(outcome, str):
            return Run(method, case, failure=outcome), None
        answer = Answer.load(path)
    errors = None
    if oracle is not None:
        errors = Errors.between(answer, oracle, case.task().signal_std)
    return Run(method, case, outcome, errors, answer.fields), answer


def _outcome(method: str, case: Case, caps: Caps, path: Path) -> Cost | str:
    """Wait for a run's cost; why there is none, otherwise."""
    with _started(method, case, path) as (process, pipe):
        try:
            outcome = _await(process, pipe, caps, path)
        except (EOFError, psutil.NoSuchProcess):
            return "the process died"
    if isinstance(outcome, Cost) and outcome.peak_mb > caps.megabytes:
        return f"over {caps.megabytes:g} MB"
    return outcome


def _await(process: psutil.Process, pipe: Connection, caps: Caps, path: Path) -> Cost | str:
    """Follow a run until it answers, or is to be ended."""
    if not pipe.poll(PATIENCE):
        return "never began"
    before = pipe.recv()
    if isinstance(before, str):
        return before
    # The first round alone is held to the cap; a few more may follow once it is saved.
    limit = time.monotonic() + caps.seconds
    while not (path.exists() or pipe.poll(POLL)):
        if time.monotonic() > limit:
            return f"over {caps.seconds:g} s"
        if process.memory_info().rss - before > 1e6 * caps.megabytes:
            return f"over {caps.megabytes:g} MB"
    return pipe.recv()


@contextlib.contextmanager
def _started(method: str, case: Case, path: Path) -> Iterator[tuple[psutil.Process, Connection]]:
    """Start a fresh interpreter, and leave none behind."""
    spawning = multiprocessing.get_context("spawn")
    pipe, theirs = spawning.Pipe()
    process = spawning.Process(target=serve, args=(theirs, method, case, path))
    process.start()
    theirs.close()
    try:
        yield psutil.Process(process.pid), pipe
    finally:
        process.kill()
        process.join()
