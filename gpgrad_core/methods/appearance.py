"""Appearance: ORB and a growing binary bag of words, similar to iBoW-LCD (Garcia 2018).

It ranks pairs of submaps with camera images, but gives no motion, and accepts no pair.
"""

from dataclasses import dataclass, field

import numpy as np

from gpgrad_core.detection import PipelineParams, StagedDetector
from gpgrad_core.detection.images import (
    Descriptors,
    ImageFeatures,
    extract_images,
    fit_two_views,
    nearest_words,
)
from gpgrad_core.errors import InputError
from gpgrad_core.methods.rivals import unchecked
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Registration, Submap

MIN_SIMILARITY = 0.3
"""The geometry is checked if the similarity is at least this share of the best candidate's."""


@dataclass(frozen=True, eq=False)
class ImagedSubmap:
    """The image features of a submap, and its similarity to earlier submaps."""

    place: str  # fingerprint of the submap
    images: tuple[ImageFeatures, ...]  # features of its images
    # similarity of each earlier submap in [0, 1], by fingerprint; the most similar has 1
    similarity: dict[str, float] = field(default_factory=dict[str, float])


@dataclass(frozen=True, eq=False)
class AppearanceDetector(StagedDetector[Submap, ImagedSubmap]):
    """A detector whose words come from the earlier submaps."""

    params: PipelineParams  # parameters; only the seed is used
    memo: Memo  # keeps the features of each submap; it is empty at first in another process

    def __call__(self, query: Submap, database: Submap) -> Registration:
        both = self.gather([self.extract(database), self.extract(query)])
        return self.compare(both[1], both[0])

    def extract(self, inferred: Submap, progress: Progress = silent) -> ImagedSubmap:
        imaged = self.memo(see, inferred)
        progress(1.0)
        return imaged

    def gather(self, extracted: list[ImagedSubmap]) -> list[ImagedSubmap]:
        vocabulary = BagOfWords()
        return [ImagedSubmap(s.place, s.images, vocabulary.look_up_and_learn(s)) for s in extracted]

    def compare(self, query: ImagedSubmap, database: ImagedSubmap) -> Registration:
        similarity = query.similarity.get(database.place, 0.0)
        if similarity < MIN_SIMILARITY:
            return unchecked(None, np.zeros(0, bool), similarity)
        counts = [
            epipolar_inliers(a, b, self.params.registration.seed)
            for a in query.images
            for b in database.images
        ]
        most = max(counts)
        return unchecked(None, np.ones(most, bool), similarity + most)


def see(submap: Submap) -> ImagedSubmap:
    """Extract ORB features from all images of a submap; without images it raises InputError."""
    if not submap.images:
        raise InputError(
            f"{submap.id}: appearance needs camera images, and this submap has none: "
            "put them into images/, in a folder named by the submap's number"
        )
    return ImagedSubmap(submap.fingerprint, extract_images(submap.images))


class BagOfWords:
    """The words seen so far, and the submaps that saw them."""

    def __init__(self) -> None:
        self._words: Descriptors = np.zeros((0, 32), np.uint8)
        # for each word, how often each place saw it
        self._counts_by_place: list[dict[str, int]] = []
        self._num_words_at: dict[str, int] = {}

    def look_up_and_learn(self, imaged: ImagedSubmap) -> dict[str, float]:
        """Compute the similarity of each earlier place, then add this place."""
        descriptors = np.concatenate([image.descriptors for image in imaged.images])
        nearest = nearest_words(descriptors, self._words)
        resembled = np.flatnonzero(nearest >= 0)
        scores = dict.fromkeys(self._num_words_at, 0.0)
        for word in nearest[resembled]:
            places = self._counts_by_place[word]
            idf = np.log1p(len(self._num_words_at) / len(places))
            for place, count in places.items():
                scores[place] += count / self._num_words_at[place] * idf
        for descriptor, word in zip(descriptors[resembled], nearest[resembled], strict=True):
            self._words[word] &= descriptor
            self._note(int(word), imaged.place)
        new = np.setdiff1d(np.arange(len(descriptors)), resembled)
        self._words = np.concatenate([self._words, descriptors[new]])
        self._counts_by_place += [{imaged.place: 1} for _ in new]
        self._num_words_at[imaged.place] = max(1, len(descriptors))
        return _stretched(scores)

    def _note(self, word: int, place: str) -> None:
        self._counts_by_place[word][place] = self._counts_by_place[word].get(place, 0) + 1


def _stretched(scores: dict[str, float]) -> dict[str, float]:
    if not scores:
        return {}
    low, high = min(scores.values()), max(scores.values())
    if high <= 0:
        return dict.fromkeys(scores, 0.0)
    low = low if high > low else 0.0  # a single place is the most similar one
    return {place: (score - low) / (high - low) for place, score in scores.items()}


def epipolar_inliers(query: ImageFeatures, database: ImageFeatures, seed: int) -> int:
    """Count the associations between two images that fit one fundamental matrix."""
    nearest = nearest_words(query.descriptors, database.descriptors)
    matched = np.flatnonzero(nearest >= 0)
    agree = fit_two_views(query.pixels[matched], database.pixels[nearest[matched]], seed)
    return int(agree.sum())
