"""Every pair of submaps through a detector, side by side over any executor."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import ceil, sqrt
from time import perf_counter
from typing import Any, Generic, Protocol, TypeAlias, TypeVar, runtime_checkable

from gpgrad_core.run.parallel import Work, run_jobs
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.threads import at_most_workers, num_workers, single_threaded_blas
from gpgrad_core.types import LoopDetector, Registration, Submap

J = TypeVar("J")
R = TypeVar("R")
Pair: TypeAlias = tuple[int, int]
"""Indices (query, database) of two submaps; the database is the earlier one."""

Compare: TypeAlias = Callable[[Any, Any], Registration]

STAGES = {"maps": (0.0, 0.4), "features": (0.4, 0.5), "pairs": (0.5, 1.0)}
"""Stretch of the progress that each stage takes up."""
BLOCKS_A_WORKER = 12
"""Pairs are shared out in blocks: many, so that no worker waits long for the last one; and
square, so that a worker in another process is sent few submaps for many pairs."""


@runtime_checkable
class StagedDetector(Protocol):
    """A `LoopDetector` whose work on single submaps can be done ahead, once each.

    ``compare(view(query), view(database))`` is what calling it with both submaps gives, where
    ``view`` is ``infer`` and then ``extract``. For an executor of processes the detector and
    what the stages return must be picklable.
    """

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        ...

    def infer(self, submap: Submap, progress: Progress = silent) -> Any:
        """Make what features are drawn from: a map, or a prepared cloud."""
        ...

    def extract(self, made: Any, progress: Progress = silent) -> Any:
        """Make all that the comparison needs of one submap."""
        ...

    def compare(self, query: Any, database: Any) -> Registration:
        """Register two extracted submaps."""
        ...


@runtime_checkable
class OrderedDetector(StagedDetector, Protocol):
    """A `StagedDetector` that learns from all submaps in order, such as a growing vocabulary."""

    def gather(self, views: list[Any]) -> list[Any]:
        """Tell each extracted submap what is to be known of those before it."""
        ...


def compare_all(
    submaps: Sequence[Submap],
    detector: LoopDetector,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> tuple[list[tuple[Pair, Registration]], dict[str, float]]:
    """Register every submap to all earlier ones.

    The answer does not depend on the executor or the number of threads: BLAS, whose sums do,
    is held to one.

    Args:
        submaps: In order.
        detector: Any; of a `StagedDetector` each submap is prepared once.
        executor: Threads or processes; None does all in this thread.
        progress: Called from this thread; may raise Cancelled.

    Returns:
        The registrations, by query and then by database, and the seconds of each stage.
    """
    views, seconds = list(submaps), dict.fromkeys(STAGES, 0.0)
    compare: Compare = detector
    start = perf_counter()
    if isinstance(detector, StagedDetector):
        compare = detector.compare
        for name, stage in (("maps", detector.infer), ("features", detector.extract)):
            views = side_by_side(stage, views, executor, part(progress, *STAGES[name]))
            if name == "features" and isinstance(detector, OrderedDetector):
                views = detector.gather(views)
            seconds[name], start = perf_counter() - start, perf_counter()
    blocks = [_Block.of(views, pairs) for pairs in _blocks(len(views), executor)]
    found = side_by_side(
        _ComparedBlock(compare), blocks, executor, part(progress, *STAGES["pairs"])
    )
    seconds["pairs"] = perf_counter() - start
    seconds["total"] = sum(seconds.values())
    return sorted(
        (result for block in found for result in block), key=lambda result: result[0]
    ), seconds


def side_by_side(
    work: Work[J, R], jobs: list[J], executor: Executor | None, progress: Progress
) -> list[R]:
    """Do all jobs as `run_jobs` does, with an answer that does not depend on the executor."""
    # Alone, a job may use all cores by itself; beside others it takes its share.
    beside = 1 if executor is None else max(1, len(jobs))
    return run_jobs(_Sharing(work, max(1, num_workers() // beside)), jobs, executor, progress)


@dataclass(frozen=True, eq=False)
class _Sharing(Generic[J, R]):
    """Work that leaves the other cores to its neighbours."""

    work: Work[J, R]
    threads: int

    def __call__(self, job: J, progress: Progress) -> R:
        with at_most_workers(self.threads), single_threaded_blas():
            return self.work(job, progress)


@dataclass(frozen=True, eq=False)
class _Block:
    """Some pairs, with what must be known of their submaps, each once."""

    pairs: tuple[Pair, ...]
    views: dict[int, Any]

    @classmethod
    def of(cls, views: list[Any], pairs: tuple[Pair, ...]) -> "_Block":
        return cls(pairs, {k: views[k] for pair in pairs for k in pair})


@dataclass(frozen=True, eq=False)
class _ComparedBlock:
    compare: Compare

    def __call__(self, job: _Block, progress: Progress) -> list[tuple[Pair, Registration]]:
        found: list[tuple[Pair, Registration]] = []
        for query, database in job.pairs:
            found.append(((query, database), self.compare(job.views[query], job.views[database])))
            progress(len(found) / len(job.pairs))
        return found


def _blocks(count: int, executor: Executor | None) -> list[tuple[Pair, ...]]:
    """Cut all pairs of so many submaps into squares of neighbours."""
    num_pairs = count * (count - 1) // 2
    workers = 1 if executor is None else num_workers()
    side = max(1, ceil(sqrt(num_pairs / (BLOCKS_A_WORKER * workers))))
    starts = range(0, count, side)
    blocks = [
        tuple(
            (i, j)
            for i in range(query, min(query + side, count))
            for j in range(database, min(database + side, i))
        )
        for query in starts
        for database in starts
        if database <= query
    ]
    return [block for block in blocks if block]
