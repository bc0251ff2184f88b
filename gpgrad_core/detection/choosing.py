"""Which pairs of a dataset are compared: of a list, of a shortlist, or not compared before."""

import hashlib
from collections import deque
from collections.abc import Collection, MutableMapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from gpgrad_core.detection.all_pairs import Choose, Pair, side_by_side
from gpgrad_core.detection.detector import Detector
from gpgrad_core.detection.shortlist import (
    Candidate,
    Candidates,
    SharedShortlist,
    Shortlist,
    num_wanted,
)
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.parallel import Work
from gpgrad_core.run.progress import Progress, part
from gpgrad_core.types import Registration

M = TypeVar("M")
E = TypeVar("E")


class Missing:
    """Chooses the pairs that an earlier run has not registered, and keeps what is registered."""

    def __init__(
        self,
        ids: list[str],
        choose: Choose[Any] | None,
        registered: MutableMapping[tuple[str, str], Registration],
        registrations: dict[Pair, Registration],
    ) -> None:
        """Take what an earlier run has, and where all registrations are put.

        Args:
            ids: Of all submaps, in order.
            choose: Chooses among all pairs; None takes all.
            registered: What is registered, by ids; what comes is put in.
            registrations: The same of the chosen pairs; filled.
        """
        self._ids, self._choose = ids, choose
        self._registered, self._registrations = registered, registrations

    def keep(self, pair: Pair, registration: Registration) -> None:
        """Keep the registration of a pair."""
        self._registrations[pair] = self._registered[self._names(pair)] = registration

    def __call__(self, extracted: Sequence[object], progress: Progress) -> list[Pair]:
        """Choose what is not registered yet."""
        if self._choose is None:
            chosen = [
                (query, earlier) for query in range(len(extracted)) for earlier in range(query)
            ]
        else:
            chosen = self._choose(list(extracted), progress)
        for pair in chosen:
            if self._names(pair) in self._registered:
                self._registrations[pair] = self._registered[self._names(pair)]
        return [pair for pair in chosen if pair not in self._registrations]

    def _names(self, pair: Pair) -> tuple[str, str]:
        return self._ids[pair[0]], self._ids[pair[1]]


class Listed:
    """Chooses the pairs of a list."""

    def __init__(self, ids: list[str], only: Collection[tuple[str, str]]) -> None:
        """Take the ids of all submaps, in order, and of the wanted pairs."""
        places = {name: place for place, name in enumerate(ids)}
        pairs = ((places[a], places[b]) for a, b in only if a in places and b in places)
        self._pairs = sorted({(max(pair), min(pair)) for pair in pairs})

    def __call__(self, _: Sequence[object], progress: Progress) -> list[Pair]:
        """Choose them."""
        progress(1.0)
        return self._pairs


class ByShortlist(Generic[M, E]):
    """Chooses pairs by a shortlist, and keeps why.

    Attributes:
        shortlists: The candidates of each submap that is not compared with all earlier ones.
    """

    def __init__(
        self,
        ids: list[str],
        detector: Detector[M, E],
        candidates: Candidates,
        seed: int,
        executor: Executor | None,
    ) -> None:
        """Begin with no submap.

        Args:
            ids: Of all submaps, in order.
            detector: Gives their keypoints.
            candidates: With how many earlier submaps each is compared.
            seed: Of the shortlist.
            executor: Its processes count votes side by side; others do not help.
        """
        self.shortlists: dict[str, tuple[Candidate, ...]] = {}
        self._ids, self._detector, self._executor = ids, detector, executor
        self._candidates: Candidates = candidates
        self._promising = candidates == "automatic"
        self._shortlist, self._seed = Shortlist(seed), seed
        self._waiting: list[tuple[str, E]] = []  # not on the shortlist yet

    def __call__(self, extracted: Sequence[E], progress: Progress) -> list[Pair]:
        """Choose the pairs; the same, whatever the executor."""
        places = {name: place for place, name in enumerate(self._ids)}
        together: list[tuple[str, tuple[object, ...]]] = []
        pairs: list[Pair] = []
        earlier = ""
        for query, submap in enumerate(extracted):
            name, wanted = self._ids[query], num_wanted(self._candidates, query)
            key = self._detector.key(submap)
            made_from = ("shortlist", earlier, key, wanted, self._promising, self._seed)
            if wanted == query:
                pairs += [(query, database) for database in range(query)]
            elif self._shortlist.has_learned and isinstance(self._executor, ProcessPoolExecutor):
                together.append((name, made_from))
            else:
                find = partial(self._find, submap, wanted)
                self.shortlists[name] = self._detector.keep(find, *made_from)
                progress((query + 1) / len(extracted))
            self._waiting.append((name, submap))
            earlier = _chained(earlier, name, key)
        self._find_together(together, part(progress, 1 - len(together) / len(extracted), 1.0))
        for name, best in self.shortlists.items():
            pairs += [(places[name], places[candidate.id]) for candidate in best]
        return sorted(pairs)

    def _find(self, submap: E, wanted: int) -> tuple[Candidate, ...]:
        self._add_waiting()
        keypoints = self._detector.keypoints(submap)
        return self._shortlist.candidates(keypoints, wanted, promising=self._promising)

    def _find_together(
        self, wanted: list[tuple[str, tuple[object, ...]]], progress: Progress
    ) -> None:
        """Find the candidates of many submaps in several processes: no later submap matters."""
        if not wanted:
            return
        self._add_waiting()
        left = deque(wanted)

        def take(best: tuple[Candidate, ...]) -> None:
            name, made_from = left.popleft()
            self.shortlists[name] = self._detector.keep(lambda: best, *made_from)

        with TemporaryFolder("gpgrad-shortlist-") as folder:
            executor, jobs = self._executor, [name for name, _ in wanted]
            count = num_wanted(self._candidates, len(self._ids))  # the same for all of them
            find: Work[str, tuple[Candidate, ...]] = partial(self._find_alone, count)
            try:
                find = SharedShortlist.of(
                    self._shortlist, Path(folder), count, promising=self._promising
                )
                self._shortlist = Shortlist(self._seed)  # the folder has it now
            except OSError:  # too little room for it: slower, the same
                executor = None
            side_by_side(find, jobs, executor, progress, take)

    def _find_alone(self, count: int, name: str, progress: Progress) -> tuple[Candidate, ...]:
        found = self._shortlist.candidates_before(name, count, promising=self._promising)
        progress(1.0)
        return found

    def _add_waiting(self) -> None:
        for name, waiting in self._waiting:
            self._shortlist.add(name, self._detector.keypoints(waiting))
        self._waiting = []


def _chained(earlier: str, name: str, key: str) -> str:
    """Name a row of submaps by the row without the last of them, and that one."""
    return hashlib.sha256(f"{earlier}\n{name}\n{key}".encode()).hexdigest()
