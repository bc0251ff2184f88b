"""Few numbers in place of many: short descriptors, and one global vector for each submap.

The global vector is that of Tolias et al., *To aggregate or not to aggregate*, ICCV 2013, with a
linear selectivity: a VLAD (Jégou et al., CVPR 2010) in which each word that a submap has counts the
same, so that frequent keypoints do not drown rare ones. Axes and words are learned from the first
submaps of a dataset, without poses or truth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import read_only

NUM_AXES = 24
"""Numbers of a short descriptor."""
NUM_WORDS = 256
"""Words of the vocabulary."""
ROUNDS = 10
"""Rounds of the k-means clustering that finds the words."""
MOST_SAMPLES = 20_000
"""Largest number of descriptors that axes and words are learned from."""

Vectors = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """What a submap's keypoints are described by."""

    mean: Float[Vectors, "d"]  # mean of the descriptors (d,)
    # directions of their largest variance (d, c), divided by one common length so that the
    # coordinates are about 1
    axes: Float[Vectors, "d c"]
    words: Float[Vectors, "w c"]  # words in the coordinates along the axes (w, c)

    def __post_init__(self) -> None:
        for array in (self.mean, self.axes, self.words):
            read_only(array)

    def shorten(self, vectors: Float[Vectors, "k d"]) -> Float[Vectors, "k c"]:
        """Give the coordinates of descriptors along the axes."""
        return np.asarray((vectors - self.mean) @ self.axes, np.float32)

    def aggregate(self, short: Float[Vectors, "k c"]) -> Float[Vectors, "v"]:
        """Make the global vector of a submap; its length is 1, or 0 without keypoints.

        Each word has the direction of the sum of x - word over its nearest descriptors x, or zeros.
        """
        nearest = nearest_words(short, self.words)
        sums = np.zeros_like(self.words)
        np.add.at(sums, nearest, short - self.words[nearest])
        sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)
        length = max(float(np.linalg.norm(sums)), 1e-12)
        return (sums / length).ravel().astype(np.float32)


def learn_vocabulary(vectors: Float[Vectors, "n d"], seed: int) -> Vocabulary:
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


def nearest_words(
    short: Float[Vectors, "k c"], words: Float[Vectors, "w c"]
) -> Int[NDArray[np.intp], "k"]:
    """Find the nearest word of each descriptor."""
    return np.argmax(short @ words.T - 0.5 * np.einsum("ij,ij->i", words, words), axis=1)


def _cluster(samples: Float[Vectors, "n c"], random: np.random.Generator) -> Float[Vectors, "w c"]:
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
