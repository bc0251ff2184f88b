"""Resamples of the submaps, and the intervals they give."""

import numpy as np
import pytest

from gpgrad_core.evaluation import Interval, measure_pairs
from gpgrad_core.evaluation.bootstrap import draw_weights
from gpgrad_core.types import Dataset


def test_a_pair_counts_as_often_as_both_its_submaps_are_drawn(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    weights = draw_weights(pairs, 4000, seed=1)
    assert weights.shape == (4000, len(pairs))
    # E[c_i c_j] = n (n - 1) / n² for two of n counts that add up to n.
    assert weights.mean(axis=0) == pytest.approx(np.full(len(pairs), 0.8), abs=0.06)
    # Where a submap is not drawn, none of its pairs is.
    of_first = pairs.database == 0
    absent = weights[:, of_first].sum(axis=1) == 0
    assert 0.2 < absent.mean() < 0.5  # (1 - 1/5)^5 = 0.33


def test_the_same_seed_draws_the_same(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    first, again, other = (draw_weights(pairs, 10, seed) for seed in (3, 3, 4))
    assert (first == again).all()
    assert (first != other).any()


def test_an_interval_is_the_middle_95_percent() -> None:
    samples = np.r_[np.arange(1001.0), np.nan]
    assert Interval.of(samples) == Interval(25.0, 975.0)
    assert Interval.of(np.array([np.nan])) is None
    assert Interval.of(np.zeros(0)) is None
