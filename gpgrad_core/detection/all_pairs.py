"""Pairs of submaps through a detector, side by side over any executor."""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import ceil, sqrt
from time import perf_counter
from typing import Generic, TypeAlias, TypeVar

from gpgrad_core.detection.detector import AnyDetector, Detector, E, M, R
from gpgrad_core.run.parallel import Work, num_side_by_side, take_in_turn
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.threads import at_most_workers, num_workers, single_threaded_libraries
from gpgrad_core.types import Registration, SubmapSource

J = TypeVar("J")
Pair: TypeAlias = tuple[int, int]
"""Indices (query, database) of two submaps; the database is the earlier one."""
Compare: TypeAlias = Callable[[E, E], Registration]
Choose: TypeAlias = Callable[[list[E], Progress], list[Pair]]
"""Chooses the pairs to compare by what was extracted of each submap."""

CHOICE_SHARE = 0.1
"""Part of the progress that choosing the pairs takes."""
SUBMAPS_SHARE, MAP_SHARE = 0.5, 0.8
"""Part of the progress that maps and keypoints take, and of that the maps."""
PHASES = {
    "making maps and keypoints": SUBMAPS_SHARE,
    "choosing pairs": SUBMAPS_SHARE + CHOICE_SHARE,
    "comparing pairs": 1.0,
}
"""The fraction at which each phase of a run that chooses its pairs ends; within one, work goes on
evenly."""
BLOCKS_A_WORKER = 12
"""Pairs are compared in blocks. There are many blocks, so that no worker waits long for the last
one, and they are square, so that few submaps are sent to another process for many pairs."""
MOST_SIDE = 100
"""A block has at most this many submaps on either side, because its results are kept together."""
MOST_PAIRS_A_BLOCK = 500
"""If pairs were chosen, a block has no more of them, because each may need other submaps."""


def compare_all(
    submaps: Sequence[SubmapSource],
    detector: AnyDetector,
    take: Callable[[Pair, Registration], None],
    executor: Executor | None = None,
    progress: Progress = silent,
    choose: Choose[E] | None = None,
    look: Callable[[list[E]], None] | None = None,
) -> dict[str, float]:
    """Register every submap to all earlier ones, or to those that are chosen.

    The result does not depend on the executor or the number of threads. BLAS runs on one thread,
    because its sums would depend on their number.

    Args:
        submaps: The submaps in order, or where to load them.
        detector: Any detector.
        take: Called from this thread with each pair, ordered by query and then by database.
        executor: Threads or processes; None does everything in this thread.
        progress: Called from this thread; may raise Cancelled.
        choose: Chooses the pairs by what was extracted of each submap, or by their places alone;
            None compares all.
        look: Called with what was extracted of each submap, before the first pair.

    Returns:
        The seconds of each stage.
    """
    seconds: dict[str, float] = {"maps": 0.0, "features": 0.0, "pairs": 0.0}
    until_pairs = part(progress, 0.0, SUBMAPS_SHARE)
    extracted = _extract_all(list(submaps), detector, executor, until_pairs, seconds)
    if look is not None:
        look(extracted)
    _compare(extracted, detector.compare, take, executor, progress, choose, seconds)
    seconds["total"] = sum(seconds.values())
    return seconds


def _compare(
    extracted: list[E],
    compare: Compare[E],
    take: Callable[[Pair, Registration], None],
    executor: Executor | None,
    progress: Progress,
    choose: Choose[E] | None,
    seconds: dict[str, float],
) -> None:
    """Compare all pairs, or the chosen ones, and note the seconds."""
    start = perf_counter()
    first, last = SUBMAPS_SHARE, 1.0
    if choose is None:
        rows = _rows_of_blocks(len(extracted), executor)
    else:
        chosen = choose(extracted, part(progress, first, first + CHOICE_SHARE))
        rows = [[block] for block in _chosen_blocks(chosen, executor)]
        first += CHOICE_SHARE
        seconds["shortlist"], start = perf_counter() - start, perf_counter()
    ordered = _Ordered([len(row) for row in rows], take)
    blocks = [_Block.of(extracted, pairs) for row in rows for pairs in row]
    side_by_side(
        _ComparedBlock(compare), blocks, executor, part(progress, first, last), ordered.take
    )
    seconds["pairs"] = perf_counter() - start


def _extract_all(
    submaps: list[SubmapSource],
    detector: Detector[M, E],
    executor: Executor | None,
    progress: Progress,
    seconds: dict[str, float],
) -> list[E]:
    """Do the stages of single submaps, and divide the time among them as they took it."""
    start = perf_counter()
    workers = executor if detector.is_staged else None
    done = side_by_side(_Extracted(detector), submaps, workers, progress)
    took, extracted = perf_counter() - start, [extracted for extracted, *_ in done]
    of_maps, of_all = sum(maps for _, maps, _ in done), sum(whole for *_, whole in done)
    seconds["maps"] = took * of_maps / of_all if of_all else 0.0
    seconds["features"] = took - seconds["maps"]
    start = perf_counter()
    extracted = detector.gather(extracted)
    seconds["features"] += perf_counter() - start
    return extracted


def side_by_side(
    work: Work[J, R],
    jobs: list[J],
    executor: Executor | None,
    progress: Progress,
    take: Callable[[R], None] | None = None,
) -> list[R]:
    """Do all jobs like `take_in_turn`, with results that do not depend on the executor.

    Returns:
        The results; an empty list if they were handed to ``take``.
    """
    # A single job may use all cores; jobs side by side share them.
    beside = 1 if executor is None else max(1, len(jobs))
    sharing, results = _Sharing(work, max(1, num_workers() // beside)), list[R]()
    take_in_turn(sharing, jobs, results.append if take is None else take, executor, progress)
    return results


@dataclass(frozen=True, eq=False)
class _Extracted(Generic[M, E]):
    """The stages of a single submap, which may have to be loaded.

    It also tells the seconds until the map was made, and those of both. A map is not handed around,
    because it is many times as large as what is extracted of it.
    """

    detector: Detector[M, E]

    def __call__(self, job: SubmapSource, progress: Progress) -> tuple[E, float, float]:
        start = perf_counter()
        to_map = part(progress, 0.0, MAP_SHARE)
        made = self.detector.infer_source(job, to_map)
        until_map = perf_counter() - start
        extracted = self.detector.extract(made, part(progress, MAP_SHARE, 1.0))
        return extracted, until_map, perf_counter() - start


class _Ordered:
    """Hands over the pairs of each row of blocks in their order, as soon as the row is complete."""

    def __init__(self, blocks_a_row: list[int], take: Callable[[Pair, Registration], None]) -> None:
        self._left, self._take = deque(blocks_a_row), take
        self._results: list[tuple[Pair, Registration]] = []

    def take(self, block: list[tuple[Pair, Registration]]) -> None:
        """Take the results of the next block."""
        self._results += block
        self._left[0] -= 1
        if self._left[0] == 0:
            self._left.popleft()
            for pair, registration in sorted(self._results, key=lambda result: result[0]):
                self._take(pair, registration)
            self._results = []


@dataclass(frozen=True, eq=False)
class _Sharing(Generic[J, R]):
    """Work that uses only its share of the cores."""

    work: Work[J, R]
    threads: int

    def __call__(self, job: J, progress: Progress) -> R:
        with at_most_workers(self.threads), single_threaded_libraries():
            return self.work(job, progress)


@dataclass(frozen=True, eq=False)
class _Block(Generic[E]):
    """Some pairs, and what was extracted of each of their submaps."""

    pairs: tuple[Pair, ...]
    extracted: dict[int, E]

    @classmethod
    def of(cls, extracted: list[E], pairs: tuple[Pair, ...]) -> "_Block[E]":
        return cls(pairs, {k: extracted[k] for pair in pairs for k in pair})


@dataclass(frozen=True, eq=False)
class _ComparedBlock(Generic[E]):
    compare: Compare[E]

    def __call__(self, job: _Block[E], progress: Progress) -> list[tuple[Pair, Registration]]:
        results: list[tuple[Pair, Registration]] = []
        for query, database in job.pairs:
            registration = self.compare(job.extracted[query], job.extracted[database])
            results.append(((query, database), registration))
            progress(len(results) / len(job.pairs))
        return results


def _rows_of_blocks(count: int, executor: Executor | None) -> list[list[tuple[Pair, ...]]]:
    """Divide the pairs of all submaps into square blocks of neighbours, query by query."""
    num_pairs = count * (count - 1) // 2
    workers = num_side_by_side(executor)
    side = min(MOST_SIDE, max(1, ceil(sqrt(num_pairs / (BLOCKS_A_WORKER * workers)))))
    rows = [
        [
            tuple(
                (i, j)
                for i in range(query, min(query + side, count))
                for j in range(database, min(database + side, i))
            )
            for database in range(0, query + 1, side)
        ]
        for query in range(0, count, side)
    ]
    return [row for row in ([block for block in row if block] for row in rows) if row]


def _chosen_blocks(pairs: list[Pair], executor: Executor | None) -> list[tuple[Pair, ...]]:
    """Divide chosen pairs into blocks of neighbouring queries, which often share candidates."""
    pairs = sorted(pairs)
    workers = num_side_by_side(executor)
    size = min(MOST_PAIRS_A_BLOCK, max(1, ceil(len(pairs) / (BLOCKS_A_WORKER * workers))))
    return [tuple(pairs[start : start + size]) for start in range(0, len(pairs), size)]
