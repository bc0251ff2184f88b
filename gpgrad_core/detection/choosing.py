"""Which pairs are worth comparing, by a shortlist of keypoints or by poses; and looking at."""

import hashlib
import pickle
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Generic, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection.engine import E, M, StagedDetector
from gpgrad_core.detection.shortlist import (
    Candidate,
    Candidates,
    Shortlist,
    ShortlistState,
    num_candidates,
)
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.parallel import JobFunction, side_by_side
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, Features, LoopClosure, PairOfIds, Submap

CellNumbers: TypeAlias = Int[NDArray[np.int64], "_count"]
NEAREST = 400
"""Number of pairs, the closest for their size, whose overlap is measured."""
FEW_POINTS = 3000
"""Number of points of a submap that tell its ground."""
CELLS_ACROSS = 24
"""A submap's width in cells by which the ground is told."""
AROUND = 2.0
"""A revisit has a way between its submaps longer than so many times the distance at which their
surfaces part."""
MOST_EXTRACTED = 60
"""Largest number of submaps that are searched without poses: each costs a map."""


LARGE = ("global_vectors", "descriptors", "positions")
"""The arrays that are not read but mapped."""
REST = "rest.pickle"


class CandidateSearch(Generic[M, E]):
    """Finds the candidates of submaps by a shortlist, in their order."""

    def __init__(self, detector: StagedDetector[M, E], candidates: Candidates, seed: int) -> None:
        self._detector, self._seed = detector, seed
        self._candidates: Candidates = candidates
        self._promising = candidates == "automatic"
        self._shortlist = Shortlist(seed)
        self._waiting: list[tuple[str, E]] = []  # not on the shortlist yet
        self._key = ""  # of all submaps so far

    def find(
        self, extracted: E, among: Collection[str] | None, num_earlier: int
    ) -> tuple[Candidate, ...] | None:
        """Find the candidates of the next submap; None if it is compared with all."""
        count = num_candidates(self._candidates, num_earlier)
        if count == num_earlier:
            return None
        find = partial(self._find, extracted, count, among)
        return find() if among is not None else self._stored(find, extracted, count)

    def add(self, name: str, extracted: E) -> None:
        self._wait(name, extracted)
        self._add_waiting()

    def find_all(
        self,
        names: Sequence[str],
        extracted: Sequence[E],
        executor: Executor | None,
        progress: Progress,
    ) -> dict[str, tuple[Candidate, ...]]:
        """Find the candidates of all submaps; only processes speed it up."""
        candidates: dict[str, tuple[Candidate, ...]] = {}
        together: list[tuple[str, E, str]] = []
        for k, (name, submap) in enumerate(zip(names, extracted, strict=True)):
            if (
                num_candidates(self._candidates, k) < k
                and self._shortlist.has_learned
                and isinstance(executor, ProcessPoolExecutor)
            ):
                together.append((name, submap, self._key))
            elif (best := self.find(submap, None, k)) is not None:
                candidates[name] = best
                progress((k + 1) / len(names))
            self._wait(name, submap)
        begun = 1 - len(together) / max(1, len(names))
        if together:
            candidates |= self._find_together(
                together, len(names), executor, part(progress, begun, 1.0)
            )
        return candidates

    def _find(
        self, extracted: E, count: int, among: Collection[str] | None
    ) -> tuple[Candidate, ...]:
        self._add_waiting()
        keypoints = self._detector.keypoints(extracted)
        return self._shortlist.candidates(keypoints, count, among, promising=self._promising)

    def _find_together(
        self,
        searches: list[tuple[str, E, str]],
        num_submaps: int,
        executor: Executor | None,
        progress: Progress,
    ) -> dict[str, tuple[Candidate, ...]]:
        self._add_waiting()
        left, candidates = deque(searches), dict[str, tuple[Candidate, ...]]()
        count = num_candidates(self._candidates, num_submaps)  # the same for all of them

        def take(best: tuple[Candidate, ...]) -> None:
            name, extracted, earlier = left.popleft()
            candidates[name] = self._stored(lambda: best, extracted, count, earlier)

        with TemporaryFolder("gpgrad-shortlist-") as folder:
            find: JobFunction[str, tuple[Candidate, ...]] = partial(self._find_alone, count)
            try:
                find = SharedShortlist.of(
                    self._shortlist, Path(folder), count, promising=self._promising
                )
                self._shortlist = Shortlist(self._seed)  # the folder has it now
            except OSError:  # too little room for it: slower, the same
                executor = None
            side_by_side(find, [name for name, *_ in searches], executor, progress, take)
        return candidates

    def _find_alone(self, count: int, name: str, progress: Progress) -> tuple[Candidate, ...]:
        candidates = self._shortlist.candidates_before(name, count, promising=self._promising)
        progress(1.0)
        return candidates

    def _stored(
        self,
        find: Callable[[], tuple[Candidate, ...]],
        extracted: E,
        count: int,
        earlier: str | None = None,
    ) -> tuple[Candidate, ...]:
        key, earlier = self._detector.key(extracted), self._key if earlier is None else earlier
        inputs = "shortlist", earlier, key, count, self._promising, self._seed
        return self._detector.keep(find, *inputs)

    def _wait(self, name: str, extracted: E) -> None:
        key = self._detector.key(extracted)
        self._key = hashlib.sha256(f"{self._key}\n{name}\n{key}".encode()).hexdigest()
        self._waiting.append((name, extracted))

    def _add_waiting(self) -> None:
        for name, waiting in self._waiting:
            self._shortlist.add(name, self._detector.keypoints(waiting))
        self._waiting = []


@dataclass(frozen=True)
class SharedShortlist:
    """Finds the candidates of a submap in any process; its jobs are ids of submaps."""

    folder: Path  # folder of this machine that nobody else can write, as the rest is a pickle
    count: int  # largest number of candidates
    promising: bool  # whether those that promise no more than chance are left out

    @classmethod
    def of(
        cls, shortlist: Shortlist, folder: Path, count: int, *, promising: bool
    ) -> "SharedShortlist":
        """Write a shortlist into an empty folder, which must stay while it is used."""
        rest = dict(vars(shortlist.state))
        for name in LARGE:
            np.save(folder / f"{name}.npy", rest.pop(name))
        (folder / REST).write_bytes(pickle.dumps(rest))
        return cls(folder, count, promising)

    def __call__(self, id: str, progress: Progress) -> tuple[Candidate, ...]:
        shortlist = _mapped(self.folder)
        candidates = shortlist.candidates_before(id, self.count, promising=self.promising)
        progress(1.0)
        return candidates


@lru_cache(maxsize=1)
def _mapped(folder: Path) -> Shortlist:
    fields: dict[str, Any] = pickle.loads((folder / REST).read_bytes())
    for name in LARGE:
        fields[name] = np.asarray(np.load(folder / f"{name}.npy", mmap_mode="r"))
    return Shortlist.restored(ShortlistState(**fields))


def likely(closures: Iterable[LoopClosure]) -> list[LoopClosure]:
    """Sort compared pairs: the accepted ones come first, and of those the highest score."""
    return sorted(closures, key=lambda one: (not one.accepted, -one.registration.score))


def odometry_or_true_pose(submap: Submap) -> Pose | None:
    """A submap's pose by odometry, or else the true one; None if neither is known."""
    return submap.pose_odometry or submap.pose_true


def closest_pair(dataset: Dataset, of: str | None = None) -> PairOfIds | None:
    """Find the closest pair of submaps that do not follow each other; None of few known poses."""
    submaps = dataset.submaps
    positions = np.full((len(submaps), 2), np.nan)
    for row, submap in enumerate(submaps):
        pose = odometry_or_true_pose(submap)
        if pose is not None:
            positions[row] = pose.apply(submap.centre[None])[0, :2]
    best, closest = np.inf, None
    for query in range(2, len(submaps)):
        # As far as infinity from what has no pose.
        distances = np.linalg.norm(positions[: query - 1] - positions[query], axis=1)
        distances = np.where(np.isnan(distances), np.inf, distances)
        if of is not None and submaps[query].id != of:
            distances[[submap.id != of for submap in submaps[: query - 1]]] = np.inf
        nearest = int(distances.argmin())
        if distances[nearest] < best:
            best, closest = distances[nearest], (submaps[query].id, submaps[nearest].id)
    return closest


def overlapping_pairs(dataset: Dataset, count: int) -> tuple[PairOfIds, ...]:
    """List pairs whose surfaces overlap most, by odometry or else the truth; likeliest first."""
    poses = [odometry_or_true_pose(submap) for submap in dataset.submaps]
    rows = [row for row, pose in enumerate(poses) if pose is not None]
    if len(rows) < 2:
        return ()
    grounds: list[Float[Array, "p 2"]] = []
    for row in rows:
        pose, submap = poses[row], dataset.submaps[row]
        assert pose is not None
        some = submap.points[:: max(1, submap.num_points // FEW_POINTS)]
        grounds.append(pose.apply(some)[:, :2])
    lows = np.array([ground.min(axis=0) for ground in grounds])
    highs = np.array([ground.max(axis=0) for ground in grounds])
    middles, reach = (lows + highs) / 2, np.linalg.norm(highs - lows, axis=1) / 2
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middles, axis=0), axis=1))])
    cell = float(np.median(2 * reach)) / CELLS_ACROSS
    cells: dict[int, CellNumbers] = {}

    def ground_cells(k: int) -> CellNumbers:
        if k not in cells:
            column, row = np.floor(grounds[k] / cell).astype(np.int64).T
            cells[k] = np.unique((row << 32) + column)
        return cells[k]

    likely: list[tuple[bool, float, int, int]] = []
    for query, database in _nearest(middles, reach):
        first, second = ground_cells(query), ground_cells(database)
        common = len(np.intersect1d(first, second, assume_unique=True))
        if common:
            around = way[query] - way[database] > AROUND * (reach[query] + reach[database])
            overlap = common / min(len(first), len(second))
            likely.append((bool(around), overlap, query, database))
    likely.sort(key=lambda pair: (not pair[0], -pair[1], pair[2], pair[3]))
    names = [dataset.submaps[row].id for row in rows]
    return tuple((names[query], names[database]) for _, _, query, database in likely[:count])


def _nearest(middles: Float[Array, "n 2"], reach: Float[Array, "n"]) -> list[tuple[int, int]]:
    """List the pairs (query, earlier database) that are closest for their size; no neighbours."""
    nearest: list[tuple[float, int, int]] = []
    for query in range(2, len(middles)):
        apart = np.linalg.norm(middles[: query - 1] - middles[query], axis=1)
        relative = apart / np.maximum(reach[: query - 1] + reach[query], 1e-9)
        near = np.flatnonzero(relative < 1.0)
        nearest += [(float(relative[k]), query, int(k)) for k in near]
    return [(query, database) for _, query, database in sorted(nearest)[:NEAREST]]


def voted_pairs(
    dataset: Dataset, count: int, extract: Callable[[Submap], Features], progress: Progress = silent
) -> tuple[PairOfIds, ...]:
    """List pairs whose keypoints agree most: for each submap its best earlier one, no neighbour."""
    every = max(1, -(-len(dataset.submaps) // MOST_EXTRACTED))
    submaps = dataset.submaps[::every]
    apart = 2 if every == 1 else 1
    shortlist = Shortlist()
    voted: list[tuple[int, int, PairOfIds]] = []
    for k, submap in enumerate(submaps):
        features = extract(submap)
        earlier = [before.id for before in submaps[: max(0, k + 1 - apart)]]
        if earlier:
            best = shortlist.candidates(features, 1, among=earlier)[0]
            voted.append((-best.votes, k, (submap.id, best.id)))
        shortlist.add(submap.id, features)
        progress((k + 1) / len(submaps))
    return tuple(pair for _, _, pair in sorted(voted)[:count])
