"""What registers pairs of submaps, and what runs it side by side over any executor.

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
from typing import Any, ClassVar, Generic, TypeAlias, TypeVar

from gpgrad_core.detection.shortlist import Candidates, check_candidates
from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.memo import array_bytes
from gpgrad_core.run.parallel import num_side_by_side, side_by_side
from gpgrad_core.types import Features, LoopDetector, Pair, Registration, Submap, SubmapSource

R = TypeVar("R")
M = TypeVar("M")
"""What features are extracted from: a map or a prepared cloud."""
E = TypeVar("E")
"""What is extracted of a submap: all that a comparison needs of it."""


class StagedDetector(Generic[M, E]):
    """A `LoopDetector` in stages, so that the work on a single submap is done once.

    Most detectors override ``extract`` and ``compare``. What else can be overridden tells what a
    detector can do: one with ``keypoints`` can be searched by a shortlist. For an executor of
    processes the detector, what it extracts and what it registers must be picklable.
    """

    is_staged: ClassVar[bool] = True
    """Whether there is work on single submaps."""

    def __call__(self, query: Submap, database: Submap) -> Registration:
        """Register the query to the database."""
        return self.compare(self.extract(self.infer(query)), self.extract(self.infer(database)))

    def infer(self, submap: Submap, progress: Progress = silent) -> M:
        """Make what features are extracted from; without an override that is the submap itself."""
        progress(1.0)
        return submap  # type: ignore[return-value] - M is Submap then

    def infer_source(self, source: SubmapSource, progress: Progress = silent) -> M:
        """As ``infer``, for a submap that may not need to be loaded."""
        return self.infer(source.load(), progress)

    def extract(self, inferred: M, progress: Progress = silent) -> E:
        """Extract what the comparison needs of one submap; without an override, all of it."""
        progress(1.0)
        return inferred  # type: ignore[return-value] - E is M then

    def gather(self, extracted: list[E]) -> list[E]:
        """Add to each extracted submap, in their order, what it needs to know of earlier ones."""
        return extracted

    def compare(self, query: E, database: E) -> Registration:
        """Register two extracted submaps."""
        raise NotImplementedError

    def keypoints(self, extracted: E) -> Features:
        """The keypoints by which a shortlist finds the pairs that are worth comparing."""
        raise NotImplementedError

    def hyperparameters(self, extracted: E) -> Hyperparameters | None:
        """The hyperparameters fitted to this submap; None if each submap has the same."""
        del extracted

    def key(self, extracted: E) -> str:
        """A key that only the same points and parameters have; empty if nothing is stored."""
        del extracted
        return ""

    def keep(self, make: Callable[[], R], *inputs: object) -> R:
        """Return ``make()``; from the store, if there is one that has it of the same."""
        del inputs
        return make()

    @property
    def has_keypoints(self) -> bool:
        """Whether a shortlist can choose pairs for it."""
        return type(self).keypoints is not StagedDetector.keypoints

    @property
    def is_ordered(self) -> bool:
        """Whether a registration depends on all earlier submaps, as with a bag of words."""
        return type(self).gather is not StagedDetector.gather


AnyDetector: TypeAlias = StagedDetector[Any, Any]


class _Plain(StagedDetector[SubmapSource, SubmapSource]):
    """A callable without stages: submaps are loaded where they are compared."""

    is_staged: ClassVar[bool] = False

    def __init__(self, register: LoopDetector) -> None:
        self.register = register

    def infer_source(self, source: SubmapSource, progress: Progress = silent) -> SubmapSource:
        progress(1.0)
        return source

    def compare(self, query: SubmapSource, database: SubmapSource) -> Registration:
        return self.register(query.load(), database.load())


def as_detector(detector: LoopDetector) -> AnyDetector:
    """Wrap any callable that registers pairs as a `StagedDetector`."""
    return detector if isinstance(detector, StagedDetector) else _Plain(detector)


def check_searchable(candidates: Candidates, detector: LoopDetector | None) -> None:
    """Raise InputError if a detector (None: the pipeline) cannot choose so many candidates."""
    check_candidates(candidates)
    if isinstance(candidates, str) or detector is None or as_detector(detector).has_keypoints:
        return
    raise InputError(
        f"the detector has no keypoints by which the best {candidates:,} candidates could be "
        "chosen; compare all"
    )


_Block: TypeAlias = tuple[tuple[Pair, ...], dict[int, Callable[[], object]]]
"""Some pairs, and what was extracted of each of their submaps."""
MAP_SHARE = 0.8
"""Part of the progress of a submap that its map takes."""
BLOCKS_A_WORKER = 12
"""Pairs are compared in many square blocks, so that no worker waits long for the last one, and few
submaps are sent to another process."""
MOST_SIDE = 100
"""Largest number of submaps on either side of a block."""
MOST_PAIRS_A_BLOCK = 500
"""Largest number of chosen pairs in a block."""


class Extracted:
    """What was extracted of each submap, by its index; beyond a limit, in a temporary folder."""

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
    """Run the stages of single submaps; the second result has the seconds of each stage."""
    start, workers = perf_counter(), executor if detector.is_staged else None
    done = side_by_side(partial(_run_stages, detector), list(submaps), workers, progress)
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
    blocks: list[_Block] = [
        (pairs, {k: _Lazy(extracted, k) for pair in pairs for k in pair})
        for row in rows
        for pairs in row
    ]
    left, results = deque(len(row) for row in rows), list[tuple[Pair, Registration]]()

    def collect(block: list[tuple[Pair, Registration]]) -> None:
        results.extend(block)
        left[0] -= 1
        if left[0] == 0:
            left.popleft()
            for pair, registration in sorted(results, key=lambda result: result[0]):
                take(pair, registration)
            results.clear()

    side_by_side(partial(_register_block, detector.compare), blocks, executor, progress, collect)


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


def _run_stages(
    detector: StagedDetector[M, E], job: SubmapSource, progress: Progress
) -> tuple[E, float, float]:
    """Load a submap and run its stages; also gives the seconds for the map, and in all."""
    start = perf_counter()
    inferred = detector.infer_source(job, part(progress, 0.0, MAP_SHARE))
    until_map = perf_counter() - start
    extracted = detector.extract(inferred, part(progress, MAP_SHARE, 1.0))
    return extracted, until_map, perf_counter() - start


@dataclass(frozen=True, eq=False)
class _Lazy:
    """What was extracted of a submap: read when its turn comes, or when it is sent."""

    extracted: Extracted
    index: int

    def __call__(self) -> object:
        return self.extracted.get(self.index)

    def __reduce__(self) -> tuple[type[partial[object]], tuple[Callable[[object], object], object]]:
        return partial, (_itself, self())


def _itself(thing: object) -> object:
    return thing


def _register_block(
    register: Callable[[Any, Any], Registration], job: _Block, progress: Progress
) -> list[tuple[Pair, Registration]]:
    pairs, extracted = job
    results: list[tuple[Pair, Registration]] = []
    for query, database in pairs:
        results.append(((query, database), register(extracted[query](), extracted[database]())))
        progress(len(results) / len(pairs))
    return results
