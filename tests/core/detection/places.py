"""Keypoints of places made by hand: no terrain, no maps, so that hundreds take a moment."""

from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import pytest

from gpgrad_core.types import Features

WIDTH = 20
LEARN_FROM = 16
MANY = 40


@contextmanager
def learning_early() -> Generator[None]:
    """Let a shortlist learn its vocabulary from few submaps, which takes less time."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "shortlist.LEARN_FROM": LEARN_FROM,
            "shortlist.FEWEST_DESCRIPTORS": 800,
            "shortlist.MOST_VOTED": 30,
            "shortlist.WORTH_THREADS": 20,
            "signatures.NUM_WORDS": 32,
        }.items():
            patch.setattr(f"gpgrad_core.detection.{name}", value)
        yield


def features(
    seed: int, count: int = 60, *, noise: float = 0.0, turned: float = 0.0, shifted: float = 0.0
) -> Features:
    """Keypoints of the place ``seed``, seen from elsewhere."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0, 12, (count, 2))
    descriptors = rng.normal(0, np.linspace(2, 0.2, WIDTH), (count, WIDTH))
    responses = rng.uniform(1, 2, count)
    if noise:
        again = np.random.default_rng(seed + 10_000)
        descriptors = descriptors + again.normal(0, noise, descriptors.shape)
        positions = positions + again.normal(0, noise / 10, positions.shape)
        order = again.permutation(count)
        positions, descriptors, responses = positions[order], descriptors[order], responses[order]
    c, s = np.cos(turned), np.sin(turned)
    positions = positions @ np.array([[c, s], [-s, c]]) + shifted
    return Features(
        positions, np.full(count, 0.3), responses, np.zeros(count), descriptors.astype(np.float32)
    )


def nothing() -> Features:
    return features(0, 0)
