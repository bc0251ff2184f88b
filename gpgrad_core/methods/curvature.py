"""Finds keypoints of high curvature, for the 3D descriptors (the paper's Sec. VII-C)."""

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.methods.neighbours import neighbours_within


def surface_variation(points: Float[Array, "n 3"], radius: float) -> Float[Array, "n"]:
    """Measure how far each neighbourhood is from flat (Pauly 2002).

    It is the smallest eigenvalue of the neighbourhood's covariance, divided by the sum of all
    three.

    Args:
        points: Points of a cloud (n, 3) [m].
        radius: Radius of a neighbourhood [m].

    Returns:
        The variation of each point (n,) in [0, 1/3]; 0 if it has fewer than five neighbours.
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
    """Choose the points whose curvature is highest in their neighbourhood, the highest first.

    Args:
        points: Points of a thinned cloud (n, 3) [m].
        radius: Radius of the neighbourhoods whose curvature is measured [m].
        spacing: Smallest distance between two keypoints [m].
        most: Largest number of keypoints.

    Returns:
        The indices of the keypoints (k,).
    """
    curvature = surface_variation(points, radius)
    near = neighbours_within(points, points, spacing)
    highest = np.zeros(len(points))
    np.maximum.at(highest, near.query, curvature[near.index])
    peaks = np.flatnonzero((curvature >= highest) & (curvature > 0))
    return peaks[np.argsort(-curvature[peaks], kind="stable")[:most]]
