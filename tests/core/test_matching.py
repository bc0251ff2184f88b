"""Associations against OpenCV's brute-force matcher."""

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.types import Features
from tests.support.laws import examples

seeds = st.integers(0, 2**32 - 1)
counts = st.integers(1, 80)
kinds = st.sampled_from(["bits", "vectors", "whole numbers"])


def random_features(seed: int, num: int, kind: str) -> Features:
    rng = np.random.default_rng(seed)
    if kind == "bits":
        descriptors = rng.integers(0, 256, (num, 61)).astype(np.uint8)
    elif kind == "vectors":
        descriptors = rng.normal(size=(num, 64)).astype(np.float32)
    else:  # as SIFT's are
        descriptors = rng.integers(0, 256, (num, 128)).astype(np.float32)
    positions = rng.uniform(0, 10, (num, 2))
    return Features(positions, np.ones(num), rng.random(num), np.zeros(num), descriptors)


def norm_of(features: Features) -> int:
    return cv2.NORM_HAMMING if features.descriptors.dtype == np.uint8 else cv2.NORM_L2


@examples(50)
@given(seeds, counts, counts, kinds)
def test_mutual_matches_are_opencvs(seed: int, queries: int, others: int, kind: str) -> None:
    query, database = random_features(seed, queries, kind), random_features(seed + 1, others, kind)
    ours = match_features(query, database)
    theirs = cv2.BFMatcher(norm_of(query), crossCheck=True).match(
        query.descriptors, database.descriptors
    )
    expected = {(match.queryIdx, match.trainIdx): match.distance for match in theirs}
    found = dict(zip(map(tuple, ours.pairs.tolist()), ours.distances, strict=True))
    for side in (0, 1):
        assert len(set(ours.pairs[:, side].tolist())) == len(ours)
    if kind == "bits":
        # Distances tie; OpenCV breaks ties its own way. Strictly nearest pairs are found by both.
        assert len(ours) > 0
        for pair in set(found) & set(expected):
            assert found[pair] ** 2 == pytest.approx(expected[pair])
        differ = query.descriptors[:, None] ^ database.descriptors[None]
        apart = np.unpackbits(differ, axis=2).sum(axis=2)
        for i, j in set(found) ^ set(expected):
            row, column = np.sort(apart[i]), np.sort(apart[:, j])
            ties = row[:2].tolist() == [apart[i, j]] * 2 or column[:2].tolist() == [apart[i, j]] * 2
            assert ties
    else:
        assert set(found) == set(expected)
        distances = [found[pair] for pair in expected]
        np.testing.assert_allclose(distances, list(expected.values()), rtol=1e-4)


@examples(30)
@given(seeds, counts, st.integers(2, 80), kinds, st.floats(0.8, 0.99))
def test_the_ratio_is_lowes(seed: int, queries: int, others: int, kind: str, ratio: float) -> None:
    query, database = random_features(seed, queries, kind), random_features(seed + 1, others, kind)
    ours = match_features(query, database, MatchParams(ratio=ratio, mutual=False))
    nearest = cv2.BFMatcher(norm_of(query)).knnMatch(query.descriptors, database.descriptors, k=2)
    # The ratio is of distances; of bits, the distance is the root of Hamming's.
    power = 0.5 if kind == "bits" else 1.0
    expected = {
        best.queryIdx
        for best, next_ in nearest
        if best.distance**power <= ratio * next_.distance**power - 1e-4
    }
    doubtful = {
        best.queryIdx
        for best, next_ in nearest
        if abs(best.distance**power - ratio * next_.distance**power) <= 1e-3
    }
    assert set(ours.pairs[:, 0].tolist()) ^ expected <= doubtful


@given(seeds, st.integers(0, 80), st.integers(0, 80), kinds)
@example(0, 0, 5, "bits")
@example(0, 5, 0, "vectors")
def test_positions_and_distances_are_those_of_the_pairs(
    seed: int, queries: int, others: int, kind: str
) -> None:
    query, database = random_features(seed, queries, kind), random_features(seed + 1, others, kind)
    matches = match_features(query, database, MatchParams(mutual=False))
    assert matches.pairs[:, 0].tolist() == list(range(queries if others else 0))
    assert matches.query_xy.shape == matches.database_xy.shape == (len(matches), 2)
    np.testing.assert_array_equal(matches.query_xy, query.positions[matches.pairs[:, 0]])
    np.testing.assert_array_equal(matches.database_xy, database.positions[matches.pairs[:, 1]])
    assert (matches.distances >= 0).all()


@pytest.mark.parametrize(("queries", "others"), [(0, 0), (0, 5), (5, 0), (5, 1)])
@pytest.mark.parametrize("kind", ["bits", "vectors"])
def test_without_a_second_best_nothing_is_refused(queries: int, others: int, kind: str) -> None:
    query, database = random_features(0, queries, kind), random_features(1, others, kind)
    matches = match_features(query, database, MatchParams(ratio=0.5))
    assert len(matches) == min(queries, others)
