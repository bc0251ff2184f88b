"""Pairs of submaps through a detector, side by side over any executor."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import ceil, sqrt
from time import perf_counter
from typing import Any, Generic, Protocol, TypeAlias, TypeVar, runtime_checkable

from gpgrad_core.run.parallel import Work, run_jobs
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.threads import at_most_workers, num_workers, single_threaded_blas
from gpgrad_core.types import Features, LoopDetector, Registration, Submap

J = TypeVar("J")
R = TypeVar("R")
Pair: TypeAlias = tuple[int, int]
"""Indices (query, database) of two submaps; the database is the earlier one."""

Compare: TypeAlias = Callable[[Any, Any], Registration]
Choose: TypeAlias = Callable[[list[Any], Progress], list[Pair]]
"""Chooses the pairs to compare by what was extracted of each submap."""

CHOICE_SHARE = 0.1
"""Part of the progress that choosing the pairs takes."""
STAGES = {"maps": (0.0, 0.4), "features": (0.4, 0.5), "pairs": (0.5, 1.0)}
"""Part of the progress that each stage takes."""
BLOCKS_A_WORKER = 12
"""Pairs are compared in blocks. There are many blocks, so that no worker waits long for the last
one, and they are square, so that few submaps are sent to another process for many pairs."""
MOST_PAIRS_A_BLOCK = 500
"""If pairs were chosen, a block has no more of them, because each may need other submaps."""


@runtime_checkable
class StagedDetector(Protocol):
    """A `LoopDetector` whose work on single submaps is done first, once for each submap.

    Calling it with two submaps does ``infer`` and then ``extract`` for each of them, followed by
    ``compare``; a detector that derives from this class inherits that. For an executor of processes
    the detector and the results of its stages must be picklable.
    """

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        return self.compare(self.extract(self.infer(query)), self.extract(self.infer(database)))

    def infer(self, submap: Submap, progress: Progress = silent) -> Any:
        """Make what features are extracted from: a map or a prepared cloud."""
        ...

    def extract(self, made: Any, progress: Progress = silent) -> Any:
        """Extract what the comparison needs of one submap."""
        ...

    def compare(self, query: Any, database: Any) -> Registration:
        """Register two extracted submaps."""
        ...


@runtime_checkable
class OrderedDetector(StagedDetector, Protocol):
    """A `StagedDetector` that learns from the submaps in their order, as a bag of words does."""

    def gather(self, extracted: list[Any]) -> list[Any]:
        """Add to each extracted submap what it needs to know of the earlier ones."""
        ...


@runtime_checkable
class SearchableDetector(StagedDetector, Protocol):
    """A `StagedDetector` with keypoints, by which a shortlist finds the pairs worth comparing."""

    def keypoints(self, extracted: Any) -> Features:
        """Give the keypoints of an extracted submap."""
        ...


def compare_all(
    submaps: Sequence[Submap],
    detector: LoopDetector,
    executor: Executor | None = None,
    progress: Progress = silent,
    choose: Choose | None = None,
) -> tuple[list[tuple[Pair, Registration]], dict[str, float]]:
    """Register every submap to all earlier ones, or to those that are chosen.

    The result does not depend on the executor or the number of threads. BLAS runs on one thread,
    because its sums would depend on their number.

    Args:
        submaps: The submaps in order.
        detector: Any detector; with a `StagedDetector` each submap is prepared only once.
        executor: Threads or processes; None does everything in this thread.
        progress: Called from this thread; may raise Cancelled.
        choose: Chooses the pairs; None compares all. It needs a `StagedDetector`.

    Returns:
        The registrations, sorted by query and then by database, and the seconds of each stage.
    """
    extracted, seconds = list(submaps), dict.fromkeys(STAGES, 0.0)
    compare: Compare = detector
    start = perf_counter()
    if isinstance(detector, StagedDetector):
        compare = detector.compare
        for name, stage in (("maps", detector.infer), ("features", detector.extract)):
            extracted = side_by_side(stage, extracted, executor, part(progress, *STAGES[name]))
            if name == "features" and isinstance(detector, OrderedDetector):
                extracted = detector.gather(extracted)
            seconds[name], start = perf_counter() - start, perf_counter()
    first, last = STAGES["pairs"]
    if choose is None:
        together = _blocks(len(extracted), executor)
    else:
        chosen = choose(extracted, part(progress, first, first + CHOICE_SHARE))
        together = _chosen_blocks(chosen, executor)
        first += CHOICE_SHARE
        seconds["shortlist"], start = perf_counter() - start, perf_counter()
    blocks = [_Block.of(extracted, pairs) for pairs in together]
    found = side_by_side(_ComparedBlock(compare), blocks, executor, part(progress, first, last))
    seconds["pairs"] = perf_counter() - start
    seconds["total"] = sum(seconds.values())
    return sorted(
        (result for block in found for result in block), key=lambda result: result[0]
    ), seconds


def side_by_side(
    work: Work[J, R], jobs: list[J], executor: Executor | None, progress: Progress
) -> list[R]:
    """Do all jobs like `run_jobs`, with results that do not depend on the executor."""
    # A single job may use all cores; jobs side by side share them.
    beside = 1 if executor is None else max(1, len(jobs))
    return run_jobs(_Sharing(work, max(1, num_workers() // beside)), jobs, executor, progress)


@dataclass(frozen=True, eq=False)
class _Sharing(Generic[J, R]):
    """Work that uses only its share of the cores."""

    work: Work[J, R]
    threads: int

    def __call__(self, job: J, progress: Progress) -> R:
        with at_most_workers(self.threads), single_threaded_blas():
            return self.work(job, progress)


@dataclass(frozen=True, eq=False)
class _Block:
    """Some pairs, and what was extracted of each of their submaps."""

    pairs: tuple[Pair, ...]
    extracted: dict[int, Any]

    @classmethod
    def of(cls, extracted: list[Any], pairs: tuple[Pair, ...]) -> "_Block":
        return cls(pairs, {k: extracted[k] for pair in pairs for k in pair})


@dataclass(frozen=True, eq=False)
class _ComparedBlock:
    compare: Compare

    def __call__(self, job: _Block, progress: Progress) -> list[tuple[Pair, Registration]]:
        found: list[tuple[Pair, Registration]] = []
        for query, database in job.pairs:
            registration = self.compare(job.extracted[query], job.extracted[database])
            found.append(((query, database), registration))
            progress(len(found) / len(job.pairs))
        return found


def _blocks(count: int, executor: Executor | None) -> list[tuple[Pair, ...]]:
    """Divide the pairs of all submaps into square blocks of neighbours."""
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


def _chosen_blocks(pairs: list[Pair], executor: Executor | None) -> list[tuple[Pair, ...]]:
    """Divide chosen pairs into blocks of neighbouring queries, which often share candidates."""
    pairs = sorted(pairs)
    workers = 1 if executor is None else num_workers()
    size = min(MOST_PAIRS_A_BLOCK, max(1, ceil(len(pairs) / (BLOCKS_A_WORKER * workers))))
    return [tuple(pairs[start : start + size]) for start in range(0, len(pairs), size)]
