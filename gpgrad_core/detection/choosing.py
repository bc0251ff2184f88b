"""Which earlier submaps each submap is compared with, if not with all."""

import hashlib
from collections import deque
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Generic

from gpgrad_core.detection.detector import E, M, StagedDetector
from gpgrad_core.detection.shortlist import (
    Candidate,
    Candidates,
    SharedShortlist,
    Shortlist,
    num_wanted,
)
from gpgrad_core.run.folders import TemporaryFolder
from gpgrad_core.run.parallel import Work, side_by_side
from gpgrad_core.run.progress import Progress, part


class CandidateSearch(Generic[M, E]):
    """Finds the candidates of submaps by a shortlist, in their order.

    What a detector's store has of the same submaps in the same order is not searched again.
    """

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
        """Find the candidates of the next submap; None if it is compared with all.

        They are some of ``among``, of which there are ``num_earlier``; None takes all earlier ones.
        """
        wanted = num_wanted(self._candidates, num_earlier)
        if wanted == num_earlier:
            return None
        find = partial(self._find, extracted, wanted, among)
        return find() if among is not None else self._stored(find, extracted, wanted)

    def add(self, name: str, extracted: E) -> None:
        """Take the next submap among those that can be found."""
        self._wait(name, extracted)
        self._add_waiting()

    def find_all(
        self,
        names: Sequence[str],
        extracted: Sequence[E],
        executor: Executor | None,
        progress: Progress,
    ) -> dict[str, tuple[Candidate, ...]]:
        """Find the candidates of all submaps that are not compared with all earlier ones.

        Processes count votes side by side; other executors do not help.
        """
        found: dict[str, tuple[Candidate, ...]] = {}
        together: list[tuple[str, E, str]] = []
        for k, (name, submap) in enumerate(zip(names, extracted, strict=True)):
            if (
                num_wanted(self._candidates, k) < k
                and self._shortlist.has_learned
                and isinstance(executor, ProcessPoolExecutor)
            ):
                together.append((name, submap, self._key))
            elif (best := self.find(submap, None, k)) is not None:
                found[name] = best
                progress((k + 1) / len(names))
            self._wait(name, submap)
        begun = 1 - len(together) / max(1, len(names))
        if together:
            found |= self._find_together(together, len(names), executor, part(progress, begun, 1.0))
        return found

    def _find(
        self, extracted: E, wanted: int, among: Collection[str] | None
    ) -> tuple[Candidate, ...]:
        self._add_waiting()
        keypoints = self._detector.keypoints(extracted)
        return self._shortlist.candidates(keypoints, wanted, among, promising=self._promising)

    def _find_together(
        self,
        wanted: list[tuple[str, E, str]],
        num_submaps: int,
        executor: Executor | None,
        progress: Progress,
    ) -> dict[str, tuple[Candidate, ...]]:
        """Find the candidates of many submaps in several processes: no later submap matters."""
        self._add_waiting()
        left, found = deque(wanted), dict[str, tuple[Candidate, ...]]()
        count = num_wanted(self._candidates, num_submaps)  # the same for all of them

        def take(best: tuple[Candidate, ...]) -> None:
            name, extracted, earlier = left.popleft()
            found[name] = self._stored(lambda: best, extracted, count, earlier)

        with TemporaryFolder("gpgrad-shortlist-") as folder:
            find: Work[str, tuple[Candidate, ...]] = partial(self._find_alone, count)
            try:
                find = SharedShortlist.of(
                    self._shortlist, Path(folder), count, promising=self._promising
                )
                self._shortlist = Shortlist(self._seed)  # the folder has it now
            except OSError:  # too little room for it: slower, the same
                executor = None
            side_by_side(find, [name for name, *_ in wanted], executor, progress, take)
        return found

    def _find_alone(self, count: int, name: str, progress: Progress) -> tuple[Candidate, ...]:
        found = self._shortlist.candidates_before(name, count, promising=self._promising)
        progress(1.0)
        return found

    def _stored(
        self,
        find: Callable[[], tuple[Candidate, ...]],
        extracted: E,
        wanted: int,
        earlier: str | None = None,
    ) -> tuple[Candidate, ...]:
        key, earlier = self._detector.key(extracted), self._key if earlier is None else earlier
        made_from = "shortlist", earlier, key, wanted, self._promising, self._seed
        return self._detector.keep(find, *made_from)

    def _wait(self, name: str, extracted: E) -> None:
        key = self._detector.key(extracted)
        self._key = hashlib.sha256(f"{self._key}\n{name}\n{key}".encode()).hexdigest()
        self._waiting.append((name, extracted))

    def _add_waiting(self) -> None:
        for name, waiting in self._waiting:
            self._shortlist.add(name, self._detector.keypoints(waiting))
        self._waiting = []
