"""Keypoints of places made by hand: no terrain, no maps, so that hundreds take a moment."""

import numpy as np

from gpgrad_core.types import Features

WIDTH = 20


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
        positions,
        np.full(count, 0.3),
        responses,
        np.zeros(count),
        descriptors.astype(np.float32),
    )


def nothing() -> Features:
    return features(0, 0)
