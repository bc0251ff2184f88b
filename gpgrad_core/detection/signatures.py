"""Few numbers in place of a submap's keypoints: a global vector, and voters.

The global vector is that of Tolias et al., *To aggregate or not to aggregate*, ICCV 2013, with a
linear selectivity: a VLAD (Jégou et al., CVPR 2010) in which each word that a submap has counts the
same, so that frequent keypoints do not drown rare ones. Axes and words are learned from the first
submaps of a dataset, without poses or truth.

Votes are associations whose distances from each other agree. A motion of the plane keeps the
distances between points, so this needs no motion, no search and no map.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Floats, Indices, Singles
from gpgrad_core.types import read_only

NUM_AXES = 24
"""Numbers of a short descriptor."""
NUM_WORDS = 256
"""Words of the vocabulary."""
ROUNDS = 10
"""Rounds of the k-means clustering that finds the words."""
MOST_SAMPLES = 20_000
"""Largest number of descriptors that axes and words are learned from."""


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """What a submap's keypoints are described by."""

    mean: Float[Singles, "d"]  # mean of the descriptors (d,)
    # directions of their largest variance (d, c), divided by one common length so that the
    # coordinates are about 1
    axes: Float[Singles, "d c"]
    words: Float[Singles, "w c"]  # words in the coordinates along the axes (w, c)

    def __post_init__(self) -> None:
        for array in (self.mean, self.axes, self.words):
            read_only(array)

    def shorten(self, vectors: Float[Singles, "k d"]) -> Float[Singles, "k c"]:
        """The coordinates of descriptors along the axes."""
        return np.asarray((vectors - self.mean) @ self.axes, np.float32)

    def aggregate(self, short: Float[Singles, "k c"]) -> Float[Singles, "v"]:
        """Make the global vector of a submap; its length is 1, or 0 without keypoints."""
        nearest = nearest_words(short, self.words)
        sums = np.zeros_like(self.words)
        np.add.at(sums, nearest, short - self.words[nearest])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
        length = max(float(np.linalg.norm(sums)), 1e-12)
        return (sums / length).ravel().astype(np.float32)


def learn_vocabulary(vectors: Float[Singles, "n d"], seed: int) -> Vocabulary:
    """Learn axes and words from the descriptors of some submaps."""
    random = np.random.default_rng(seed)
    chosen = np.sort(random.permutation(len(vectors))[:MOST_SAMPLES])
    samples = vectors[chosen].astype(np.float64)
    mean = samples.mean(axis=0)
    centred = samples - mean
    variances, directions = np.linalg.eigh(centred.T @ centred / len(samples))
    largest = np.argsort(-variances, kind="stable")[:NUM_AXES]
    length = np.sqrt(max(float(variances[largest[0]]), 1e-30))
    axes = (directions[:, largest] / length).astype(np.float32)
    short = (centred @ axes).astype(np.float32)
    return Vocabulary(mean.astype(np.float32), axes, _cluster(short, random))


def nearest_words(short: Float[Singles, "k c"], words: Float[Singles, "w c"]) -> Int[Indices, "k"]:
    """Find the nearest word of each descriptor."""
    return np.argmax(short @ words.T - 0.5 * np.einsum("ij,ij->i", words, words), axis=1)


def _cluster(samples: Float[Singles, "n c"], random: np.random.Generator) -> Float[Singles, "w c"]:
    """Find words by k-means; a word that loses all its samples stays where it is."""
    words = samples[np.sort(random.permutation(len(samples))[:NUM_WORDS])]
    for _ in range(ROUNDS):
        nearest = nearest_words(samples, words)
        counts = np.bincount(nearest, minlength=len(words))
        sums = np.zeros(words.shape)
        np.add.at(sums, nearest, samples)
        used = counts > 0
        words[used] = (sums[used] / counts[used, None]).astype(np.float32)
    return words


MOST_ASSOCIATIONS = 96
"""Only so many associations of the most similar descriptors vote."""
NEAREST = 2.0
"""Associations closer to each other than this do not vote for each other: any two would agree
[tolerances]."""
TOGETHER = 4
"""Number of submaps whose votes are counted in one go."""


@dataclass(frozen=True, eq=False)
class Voters:
    """The strongest keypoints of a submap."""

    # their descriptors (m, c), in half precision if they are short
    descriptors: Float[Floats, "m c"]
    positions: Float[Singles, "m 2"]  # their positions (m, 2) [m]
    tolerance: float  # difference up to which two distances agree [m]

    def __post_init__(self) -> None:
        read_only(self.descriptors)
        read_only(self.positions)

    @cached_property
    def half_norms(self) -> Float[Singles, "m"]:
        vectors = self.descriptors.astype(np.float32)
        return np.asarray(-0.5 * np.einsum("ij,ij->i", vectors, vectors), np.float32)


def count_votes(query: Voters, others: list[Voters]) -> list[int]:
    """Count the votes for each of some earlier submaps.

    Keypoints are associated if each is the nearest of the other. Two associations agree if their
    keypoints are as far apart in one submap as in the other. The votes are those of the pair of
    agreeing associations with which most others agree: it fixes the motion, but for a reflection.
    """
    left = _augmented(query, first=True)
    return [
        votes
        for first in range(0, len(others), TOGETHER)
        for votes in _count_together(query, left, others[first : first + TOGETHER])
    ]


def _augmented(voters: Voters, *, first: bool) -> Float[Singles, "m e"]:
    """Add two columns, so that a product of two such rows is minus half their squared distance."""
    count, length = voters.descriptors.shape
    rows = np.empty((count, length + 2), np.float32)
    rows[:, :length] = voters.descriptors
    rows[:, length + first], rows[:, length + 1 - first] = voters.half_norms, 1.0
    return rows


def _count_together(query: Voters, left: Float[Singles, "m e"], others: list[Voters]) -> list[int]:
    # What is not a number agrees with nothing.
    places = np.full((2, len(others), MOST_ASSOCIATIONS, 2), np.nan, np.float32)
    for k, other in enumerate(others):
        here, there = _associate(left, other)
        places[0, k, : len(here)] = query.positions[here]
        places[1, k, : len(there)] = other.positions[there]
    tolerances = np.array([max(query.tolerance, other.tolerance) for other in others])
    tolerance, least = np.array([tolerances, NEAREST * tolerances], np.float32)[..., None, None]
    apart, differing = _distances(places)
    differing -= apart
    agree = np.abs(differing, out=differing) <= tolerance
    agree &= apart >= least
    graph = agree.astype(np.float32)
    # Entry (k, l) counts the associations that agree with both k and l.
    common = graph @ graph
    common *= graph
    most = common.max(axis=(1, 2), initial=0.0).astype(int)
    return np.where(agree.any(axis=(1, 2)), 2 + most, 0).tolist()


def _associate(
    left: Float[Singles, "m e"], other: Voters
) -> tuple[Int[Indices, "k"], Int[Indices, "k"]]:
    """Find the most similar of the keypoints that are the nearest of each other, of both sides."""
    if len(left) == 0 or len(other.descriptors) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    nearness = left @ _augmented(other, first=False).T
    nearest = nearness.argmax(axis=1)
    reached = nearness[np.arange(len(left)), nearest]
    # The largest value of each column takes a third of the time of where it is.
    mutual = np.flatnonzero(reached == nearness.max(axis=0)[nearest])
    if len(mutual) > MOST_ASSOCIATIONS:
        order = np.argsort(-reached[mutual], kind="stable")
        mutual = mutual[order[:MOST_ASSOCIATIONS]]
    return mutual, nearest[mutual]


def _distances(positions: Float[Singles, "*some m 2"]) -> Float[Singles, "*some m m"]:
    x, y = positions[..., 0], positions[..., 1]
    along, across = x[..., :, None] - x[..., None, :], y[..., :, None] - y[..., None, :]
    along *= along
    across *= across
    along += across
    return np.sqrt(along, out=along)
