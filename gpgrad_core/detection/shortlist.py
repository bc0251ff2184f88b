"""The shortlist: which earlier submaps are worth comparing with a new one."""

from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import repeat
from math import ceil
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, Floats, Indices, NDArray, Singles
from gpgrad_core.detection.signatures import Vocabulary, Voters, count_votes, learn_vocabulary
from gpgrad_core.errors import InputError
from gpgrad_core.params import AUTOMATIC
from gpgrad_core.run.threads import num_workers, single_threaded_libraries
from gpgrad_core.types import Features, as_vectors

Candidates: TypeAlias = int | Literal["all", "automatic"]
"""How many earlier submaps a submap is compared with at most."""

ALL_UP_TO = 200
"""With ``automatic``, a submap with up to this many earlier ones is compared with all of them."""
DEFAULT_CANDIDATES = 30
"""With ``automatic``, a submap with more earlier ones is compared with at most this many, that
promise more than chance."""
MOST_CANDIDATES = 1_000_000


@dataclass(frozen=True, slots=True)
class Candidate:
    """An earlier submap that is worth comparing, and what speaks for it.

    Attributes:
        id: Id of the earlier submap.
        votes: Number of associations between the strongest keypoints of both submaps whose
            distances from each other agree. 0 if the associations were not looked at, because too
            many others were more similar.
        similarity: Cosine of the angle between the global vectors of both submaps, in [-1, 1]. 0
            as long as there are too few submaps to make such vectors.
    """

    id: str
    votes: int
    similarity: float


def read_candidates(word: str) -> Candidates:
    """Read the value of ``--candidates``: ``all``, ``automatic`` or a whole number.

    Raises:
        InputError: If it is something else.

    >>> read_candidates("30"), read_candidates("all")
    (30, 'all')
    """
    if word == "all":
        return "all"
    if word == AUTOMATIC:
        return "automatic"
    if not (word.isascii() and word.isdigit() and len(word) < 10):
        raise InputError(f"--candidates must be a whole number, all or automatic, got {word!r}")
    return check_candidates(int(word))


def check_candidates(candidates: Candidates, where: str = "") -> Candidates:
    """Raise InputError unless 1 to a million; `where`, the file that has it, begins the message."""
    if isinstance(candidates, int) and not 1 <= candidates <= MOST_CANDIDATES:
        raise InputError(
            f"{where}{': ' * bool(where)}the candidates must be 1 to {MOST_CANDIDATES:,} submaps, "
            f"got {candidates:,}"
        )
    return candidates


def num_candidates(candidates: Candidates, num_earlier: int) -> int:
    """Count the earlier submaps to compare a submap with at most.

    >>> num_candidates("automatic", 200), num_candidates("automatic", 5000), num_candidates(50, 10)
    (200, 30, 10)
    """
    if candidates == "all" or (candidates == "automatic" and num_earlier <= ALL_UP_TO):
        return num_earlier
    count = DEFAULT_CANDIDATES if candidates == "automatic" else candidates
    return min(count, num_earlier)


LEARN_FROM = 64
"""Number of submaps from which the vocabulary is learned. Until then all submaps vote."""
FEWEST_DESCRIPTORS = 5_000
"""The vocabulary waits until there are so many descriptors."""
MOST_VOTERS = 500
"""Number of keypoints of a submap, the strongest, that are stored."""
MOST_VOTED = 400
"""Number of submaps, the most similar ones, for which votes are counted."""
WORTH_VOTES = 30.0
"""Votes that a similarity of 1 is worth: vectors of pairs that share little are a little alike."""
BY_CHANCE = 1.65
"""Votes of a promising submap, with those for similarity, in the lower quartile of all that have
counted votes."""
FEWEST_PROMISING = 5
"""Number of candidates that count as promising in any case."""
WORTH_THREADS = 50
"""Number of submaps from which on counting takes longer than threads take to start."""

Halves = NDArray[np.float16]
Counts = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ShortlistState:
    """Everything that a shortlist knows, for a file."""

    seed: int  # seed of the random choices
    ids: tuple[str, ...]  # ids of the n submaps in the order in which they were added
    vocabulary: Vocabulary | None  # the vocabulary; None as long as too few submaps were added
    # global vector of each submap (n, v); (n, 0) without a vocabulary
    global_vectors: Float[Singles, "n v"]
    num_descriptors: Int[Counts, "n"]  # number of descriptors that are kept of each submap (n,)
    # these descriptors (p, c), submap by submap: short ones of the voters, or whole ones of all
    # keypoints without a vocabulary
    descriptors: Float[Floats, "p c"]
    num_voters: Int[Counts, "n"]  # number of voters of each submap (n,)
    positions: Float[Singles, "m 2"]  # positions of the voters (m, 2) [m], submap by submap
    tolerances: Float[Array, "n"]  # tolerance of each submap's voters (n,) [m]


class Shortlist:
    """Finds the earlier submaps that are worth comparing with a submap, by their keypoints.

    A submap keeps at most 55 kB here: a global vector and its 500 strongest keypoints. The global
    vectors of all earlier submaps are compared first, which is one product of a matrix with a
    vector. For the most similar ones, votes are counted (`count_votes`), and those with the most
    votes are the candidates. Nothing is learned from poses or from the truth, and the same submaps
    in the same order have the same candidates.

    >>> from gpgrad_core.types import Features
    >>> none = Features(*np.zeros((1, 0, 2)), *np.zeros((3, 0)), np.zeros((0, 98), np.float32))
    >>> shortlist = Shortlist()
    >>> shortlist.add("000", none)
    >>> shortlist.candidates(none, 30)
    (Candidate(id='000', votes=0, similarity=0.0),)
    """

    def __init__(self, seed: int = 0) -> None:
        self._seed = seed
        self._rows: dict[str, int] = {}
        self._voters: list[Voters] = []
        self._vocabulary: Vocabulary | None = None
        self._waiting: list[Float[Floats, "_ d"]] = []  # descriptors, until there is a vocabulary
        self._global = np.zeros((0, 0), np.float32)  # has spare rows at its end

    @classmethod
    def restored(cls, state: ShortlistState) -> "Shortlist":
        shortlist = cls(state.seed)
        shortlist._rows = {id: row for row, id in enumerate(state.ids)}
        if state.vocabulary is not None:
            shortlist._vocabulary, shortlist._global = state.vocabulary, state.global_vectors
        descriptors = np.split(state.descriptors, np.cumsum(state.num_descriptors)[:-1])
        positions = np.split(state.positions, np.cumsum(state.num_voters)[:-1])
        if not state.ids:
            return shortlist
        if state.vocabulary is None:
            shortlist._waiting = descriptors
        shortlist._voters = [
            Voters(described[: len(where)], where, tolerance)
            for described, where, tolerance in zip(
                descriptors, positions, state.tolerances.tolist(), strict=True
            )
        ]
        return shortlist

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the submaps in the order in which they were added."""
        return tuple(self._rows)

    @property
    def has_learned(self) -> bool:
        """Whether there is a vocabulary, which no submap that is added changes any more."""
        return self._vocabulary is not None

    @property
    def seed(self) -> int:
        """Seed of the random choices."""
        return self._seed

    @property
    def state(self) -> ShortlistState:
        """Everything that the shortlist knows."""
        descriptors = self._waiting or [voters.descriptors for voters in self._voters]
        return ShortlistState(
            self._seed,
            self.ids,
            self._vocabulary,
            self._global[: len(self)].copy()
            if self._vocabulary
            else np.zeros((len(self), 0), np.float32),
            np.array([len(voters) for voters in descriptors], np.int64),
            np.concatenate(descriptors or [np.zeros((0, 0), np.float32)]),
            np.array([len(voters.positions) for voters in self._voters], np.int64),
            np.concatenate([np.zeros((0, 2), np.float32), *(v.positions for v in self._voters)]),
            np.array([voters.tolerance for voters in self._voters], np.float64),
        )

    def add(self, id: str, features: Features) -> None:
        """Add a submap.

        Args:
            id: Its id, which must be new.
            features: Its keypoints, from the same detector as those of the others.

        Raises:
            InputError: If the id is not new, or the descriptors have another length than others.
        """
        if id in self._rows:
            raise InputError(f"submap {id} is on the shortlist already; ids must differ")
        vectors, voters = self._described(features)
        self._rows[id] = len(self._rows)
        self._voters.append(voters)
        if self._vocabulary is not None:
            self._shorten(self._rows[id], self._vocabulary, vectors)
            return
        self._waiting.append(vectors)
        enough = sum(len(voters) for voters in self._waiting) >= FEWEST_DESCRIPTORS
        if enough and len(self) >= LEARN_FROM:
            with single_threaded_libraries():  # sums must not depend on the number of threads
                self._vocabulary = learn_vocabulary(np.concatenate(self._waiting), self._seed)
            for row, waiting in enumerate(self._waiting):
                self._shorten(row, self._vocabulary, waiting)
            self._waiting = []

    def candidates(
        self,
        features: Features,
        count: int,
        among: Collection[str] | None = None,
        *,
        promising: bool = False,
    ) -> tuple[Candidate, ...]:
        """Find the submaps that are most likely to show the same place.

        Args:
            features: Keypoints of the submap to compare; it need not have been added.
            count: Largest number of candidates.
            among: Ids of the submaps that may be chosen; None takes all.
            promising: Whether those that promise no more than chance are left out; see `BY_CHANCE`.

        Returns:
            The candidates, the best first: by their votes, with `WORTH_VOTES` more for a similarity
            of 1, and then in the order of adding.

        Raises:
            InputError: If a submap was not added, or the descriptors have another length.
        """
        vectors, voters = self._described(features)
        rows = np.arange(len(self))
        if among is not None:
            rows = np.array(sorted(self._row(id) for id in among), dtype=np.intp)
        vector = np.zeros(0, np.float32)
        with single_threaded_libraries():
            if self._vocabulary is not None:
                short = self._vocabulary.shorten(vectors)
                voters = replace(voters, descriptors=_halved(short[: len(voters.positions)]))
                vector = self._vocabulary.aggregate(short)
            return self._best(voters, vector, rows, len(self), count, promising)

    def candidates_before(
        self, id: str, count: int, *, promising: bool = False
    ) -> tuple[Candidate, ...]:
        """Find the candidates of a submap among those that were added before it.

        They are those that `candidates` found when the submap was about to be added, if the
        vocabulary had been learned by then (`has_learned`).

        Args:
            id: Id of the submap.
            count: Largest number of candidates.
            promising: Whether those that promise no more than chance are left out.

        Raises:
            InputError: If the submap was not added.
        """
        row = self._row(id)
        vector = np.zeros(0, np.float32) if self._vocabulary is None else self._global[row]
        with single_threaded_libraries():
            return self._best(self._voters[row], vector, np.arange(row), row, count, promising)

    def _best(
        self,
        voters: Voters,
        vector: Float[Singles, "v"],
        rows: Int[Indices, "r"],
        end: int,
        count: int,
        promising: bool,
    ) -> tuple[Candidate, ...]:
        similarity, voted = np.zeros(len(rows), np.float32), np.arange(len(rows))
        if self._vocabulary is not None:
            similarity = (self._global[:end] @ vector)[rows]
            voted = np.argsort(-similarity, kind="stable")[: max(MOST_VOTED, count)]
        votes = np.zeros(len(rows), np.intp)
        votes[voted] = _count_side_by_side(voters, [self._voters[rows[k]] for k in voted])
        ids, likeness = self.ids, votes + WORTH_VOTES * similarity
        best = np.lexsort((-votes, -likeness))[:count]
        if promising and len(best):
            least = BY_CHANCE * np.quantile(likeness[voted], 0.25)
            best = best[(likeness[best] >= least) | (np.arange(len(best)) < FEWEST_PROMISING)]
        return tuple(
            Candidate(ids[rows[k]], int(votes[k]), round(float(similarity[k]), 6)) for k in best
        )

    def _row(self, id: str) -> int:
        row = self._rows.get(id)
        if row is None:
            raise InputError(f"submap {id} is not on the shortlist; add it first")
        return row

    def _described(self, features: Features) -> tuple[Float[Singles, "k d"], Voters]:
        """A submap's descriptors, the strongest first, and its voters with whole ones."""
        order = np.argsort(-features.responses, kind="stable")
        vectors = as_vectors(features.descriptors)[order]
        length = self._waiting[0].shape[1] if self._waiting else vectors.shape[1]
        if self._vocabulary is not None:
            length = len(self._vocabulary.mean)
        if vectors.shape[1] != length:
            raise InputError(
                f"descriptors of {vectors.shape[1]} numbers cannot be compared with those of "
                f"{length}; use one detector for all submaps"
            )
        strongest = order[:MOST_VOTERS]
        tolerance = float(np.median(features.scales[strongest])) if len(order) else 0.0
        positions = features.positions[strongest].astype(np.float32)
        return vectors, Voters(vectors[:MOST_VOTERS], positions, tolerance)

    def _shorten(self, row: int, vocabulary: Vocabulary, vectors: Float[Singles, "k d"]) -> None:
        short, voters = vocabulary.shorten(vectors), self._voters[row]
        vector = vocabulary.aggregate(short)
        if row >= len(self._global):
            grown = np.zeros((max(LEARN_FROM, 2 * row), len(vector)), np.float32)
            grown[: len(self._global)] = self._global.reshape(-1, len(vector))
            self._global = grown
        self._global[row] = vector
        self._voters[row] = replace(voters, descriptors=_halved(short[: len(voters.positions)]))


def _count_side_by_side(query: Voters, others: list[Voters]) -> list[int]:
    """Count the votes on all cores; the result does not depend on their number."""
    workers = num_workers()
    if workers == 1 or len(others) < WORTH_THREADS:
        return count_votes(query, others)
    size = ceil(len(others) / workers)
    shares = [others[start : start + size] for start in range(0, len(others), size)]
    with ThreadPoolExecutor(workers, thread_name_prefix="votes") as executor:
        counted = executor.map(count_votes, repeat(query), shares)
        return [votes for share in counted for votes in share]


def _halved(short: Float[Singles, "m c"]) -> Float[Halves, "m c"]:
    """Round to half precision; a coordinate beyond its range becomes the largest one."""
    most = np.finfo(np.float16).max
    return np.clip(short, -most, most).astype(np.float16)
