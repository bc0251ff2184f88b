"""Submaps and pairs through a detector, side by side over any executor.

The results do not depend on the executor or the number of threads. BLAS runs on one thread, because
its sums would depend on their number.
"""

import pickle
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from math import ceil, sqrt
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any, Generic, TypeAlias

from gpgrad_core.detection.detector import AnyDetector, E, M, StagedDetector
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.memo import array_bytes
from gpgrad_core.run.parallel import num_side_by_side, side_by_side
from gpgrad_core.run.progress import Progress, part
from gpgrad_core.types import Registration, SubmapSource

Pair: TypeAlias = tuple[int, int]
"""Indices (query, database) of two submaps in their order; the database is the earlier one."""
PairOfIds: TypeAlias = tuple[str, str]
"""Ids of two submaps (query, database); the database is the earlier one."""
MAP_SHARE = 0.8
"""Part of the progress of a submap that its map takes."""
BLOCKS_A_WORKER = 12
"""Pairs are compared in blocks: many, so that no worker waits long for the last one, and square, so
that few submaps are sent to another process for many pairs."""
MOST_SIDE = 100
"""A block has at most this many submaps on either side, as its results are in memory together."""
MOST_PAIRS_A_BLOCK = 500
"""If pairs were chosen, a block has no more of them, because each may need other submaps."""


class Extracted:
    """What was extracted of each submap, by its index.

    Beyond a limit of memory, the least recently used wait in a temporary folder.
    """

    def __init__(self, max_bytes: float) -> None:
        self._max_bytes, self._bytes = max_bytes, 0
        self._held: OrderedDict[int, tuple[Any, int]] = OrderedDict()
        self._folder: TemporaryFolder | None = None
        self._lock = Lock()

    def put(self, index: int, extracted: object) -> None:
        with self._lock:
            self._hold(index, extracted)

    def get(self, index: int) -> Any:
        with self._lock:
            held = self._held.get(index)
            if held is not None:
                self._held.move_to_end(index)
                return held[0]
            extracted = pickle.loads(self._file(index).read_bytes())
            self._hold(index, extracted)
            return extracted

    def drop(self, index: int) -> None:
        with self._lock:
            self._bytes -= self._held.pop(index, (None, 0))[1]
            if self._folder is not None:
                self._file(index).unlink(missing_ok=True)

    def close(self) -> None:
        """Forget all, and remove the folder."""
        with self._lock:
            self._held.clear()
            if self._folder is not None:
                self._folder.cleanup()

    def _hold(self, index: int, extracted: object) -> None:
        size = array_bytes(extracted)
        self._held[index] = extracted, size
        self._bytes += size
        while self._bytes > self._max_bytes and len(self._held) > 1:
            oldest, (evicted, freed) = self._held.popitem(last=False)
            self._bytes -= freed
            file = self._file(oldest)
            if not file.exists():
                file.write_bytes(pickle.dumps(evicted, protocol=pickle.HIGHEST_PROTOCOL))

    def _file(self, index: int) -> Path:
        if self._folder is None:
            self._folder = TemporaryFolder("gpgrad-submaps-")
        return Path(self._folder.name) / f"{index}.pickle"


def extract(
    submaps: Sequence[SubmapSource],
    detector: StagedDetector[M, E],
    executor: Executor | None,
    progress: Progress,
) -> tuple[list[E], dict[str, float]]:
    """Do the stages of single submaps; gives the seconds too, divided as the stages took them."""
    start, workers = perf_counter(), executor if detector.is_staged else None
    done = side_by_side(_Stages(detector), list(submaps), workers, progress)
    took, extracted = perf_counter() - start, [extracted for extracted, *_ in done]
    of_maps, of_all = sum(maps for _, maps, _ in done), sum(whole for *_, whole in done)
    maps = took * of_maps / of_all if of_all else 0.0
    return extracted, {"maps": maps, "features": took - maps}


def compare(
    rows: Sequence[Sequence[tuple[Pair, ...]]],
    extracted: Extracted,
    detector: AnyDetector,
    take: Callable[[Pair, Registration], None],
    executor: Executor | None,
    progress: Progress,
) -> None:
    """Register pairs; those of each row of blocks are handed over in order, once it is complete."""
    ordered = _Ordered([len(row) for row in rows], take)
    blocks = [
        _Block(pairs, {k: _Lazy(extracted, k) for pair in pairs for k in pair})
        for row in rows
        for pairs in row
    ]
    side_by_side(_Compare(detector.compare), blocks, executor, progress, ordered.take)


def square_blocks(count: int, executor: Executor | None) -> list[list[tuple[Pair, ...]]]:
    """Divide the pairs of all submaps into rows of square blocks of neighbours, query by query."""
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


def chosen_blocks(pairs: Sequence[Pair], executor: Executor | None) -> list[list[tuple[Pair, ...]]]:
    """Divide chosen pairs into blocks of neighbouring queries, which often share candidates."""
    pairs = sorted(pairs)
    workers = num_side_by_side(executor)
    size = min(MOST_PAIRS_A_BLOCK, max(1, ceil(len(pairs) / (BLOCKS_A_WORKER * workers))))
    return [[tuple(pairs[start : start + size])] for start in range(0, len(pairs), size)]


@dataclass(frozen=True, eq=False)
class _Stages(Generic[M, E]):
    """Loads a submap and runs its stages; also gives the seconds for the map, and in all.

    The map stays here, because it is many times as large as what is extracted of it.
    """

    detector: StagedDetector[M, E]

    def __call__(self, job: SubmapSource, progress: Progress) -> tuple[E, float, float]:
        start = perf_counter()
        made = self.detector.infer_source(job, part(progress, 0.0, MAP_SHARE))
        until_map = perf_counter() - start
        extracted = self.detector.extract(made, part(progress, MAP_SHARE, 1.0))
        return extracted, until_map, perf_counter() - start


class _Ordered:
    """Hands over the pairs of each row of blocks in their order, as soon as the row is complete."""

    def __init__(self, blocks_a_row: list[int], take: Callable[[Pair, Registration], None]) -> None:
        self._left, self._take = deque(blocks_a_row), take
        self._results: list[tuple[Pair, Registration]] = []

    def take(self, block: list[tuple[Pair, Registration]]) -> None:
        self._results += block
        self._left[0] -= 1
        if self._left[0] == 0:
            self._left.popleft()
            for pair, registration in sorted(self._results, key=lambda result: result[0]):
                self._take(pair, registration)
            self._results = []


@dataclass(frozen=True, eq=False)
class _Lazy:
    """What was extracted of a submap: read when its turn comes, or when it is sent."""

    extracted: Extracted
    index: int

    def __call__(self) -> object:
        return self.extracted.get(self.index)

    def __reduce__(self) -> tuple[type[partial[object]], tuple[Callable[[object], object], object]]:
        """Become the thing itself in another process."""
        return partial, (_itself, self())


def _itself(thing: object) -> object:
    return thing


@dataclass(frozen=True, eq=False)
class _Block:
    """Some pairs, and what was extracted of each of their submaps."""

    pairs: tuple[Pair, ...]
    extracted: dict[int, Callable[[], object]]


@dataclass(frozen=True, eq=False)
class _Compare:
    register: Callable[[Any, Any], Registration]

    def __call__(self, job: _Block, progress: Progress) -> list[tuple[Pair, Registration]]:
        results: list[tuple[Pair, Registration]] = []
        for query, database in job.pairs:
            registration = self.register(job.extracted[query](), job.extracted[database]())
            results.append(((query, database), registration))
            progress(len(results) / len(job.pairs))
        return results
