"""Keypoints in regions of high curvature, for the 3D descriptors of the paper's Sec. VII-C."""

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.methods.neighbours import neighbours_within


def surface_variation(points: Float[Array, "n 3"], radius: float) -> Float[Array, "n"]:
    """Measure how far each neighbourhood is from flat, in [0, 1/3]: Pauly 2002.

    The smallest eigenvalue of its covariance over the sum of all three; zero where there are
    fewer than five neighbours.
    """
    near = neighbours_within(points, points, radius)
    offsets = points[near.index] - points[near.query]
    sums = near.sum_up(offsets)
    products = near.sum_up((offsets[:, :, None] * offsets[:, None, :]).reshape(-1, 9))
    counts = np.maximum(near.counts, 1)[:, None]
    mean = sums / counts
    covariance = (products / counts).reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    values = np.linalg.eigvalsh(covariance)
    total = np.maximum(values.sum(axis=1), 1e-12)
    return np.where(near.counts >= 5, np.maximum(values[:, 0], 0) / total, 0.0)


def curved_keypoints(
    points: Float[Array, "n 3"], radius: float, spacing: float, most: int
) -> Int[NDArray[np.intp], "k"]:
    """Choose the points that are more curved than all near them, the most curved first.

    Args:
        points: Of a thinned cloud [m].
        radius: Of the neighbourhoods whose curvature is measured [m].
        spacing: Between two keypoints at least [m].
        most: Keypoints to keep.
    """
    curvature = surface_variation(points, radius)
    near = neighbours_within(points, points, spacing)
    highest = np.zeros(len(points))
    np.maximum.at(highest, near.query, curvature[near.index])
    peaks = np.flatnonzero((curvature >= highest) & (curvature > 0))
    return peaks[np.argsort(-curvature[peaks], kind="stable")[:most]]
