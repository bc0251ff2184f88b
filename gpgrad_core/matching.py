"""Associations between two sets of keypoints, by brute force (the paper's Sec. V)."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import Doc

from gpgrad_core.arrays import Indices, Singles
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.types import Descriptors, Features, Matches, as_vectors

MOST_DISTANCES = 16_000_000
"""Largest number of distances that are held at once; 64 MB."""


@dataclass(frozen=True)
class MatchParams:
    """Which nearest neighbours count as associations."""

    ratio: Annotated[
        float,
        Bounds(0.1, 1.0, 0.01),
        Doc(
            "An association is kept if its distance is at most this share of the distance to the "
            "second nearest keypoint. 1 keeps all."
        ),
    ] = 1.0
    mutual: Annotated[
        bool, Doc("Keep an association only if each keypoint is the nearest of the other.")
    ] = True

    def __post_init__(self) -> None:
        check_bounds(self)


def match_features(
    query: Features, database: Features, params: MatchParams | None = None
) -> Matches:
    """Associate each query keypoint with the database keypoint of the nearest descriptor.

    All descriptors are compared by brute force, as in the paper's Sec. V.

    Args:
        query: Keypoints of the query map.
        database: Keypoints of the database map, from the same detector.
        params: Which nearest neighbours count as associations.

    Returns:
        The associations, in the order of the query's keypoints.
    """
    params = params or MatchParams()
    if len(query) == 0 or len(database) == 0:
        pairs, distances = np.zeros((0, 2), np.intp), np.zeros(0)
    else:
        nearest, best, second, back = _nearest(
            query.descriptors, database.descriptors, second_too=params.ratio < 1
        )
        rows = np.arange(len(query))
        accepted = np.ones(len(query), bool)
        if params.mutual:
            accepted &= back[nearest] == rows
        if params.ratio < 1 and len(database) > 1:
            accepted &= np.sqrt(best) <= params.ratio * np.sqrt(second)
        pairs = np.column_stack([rows, nearest])[accepted]
        distances = np.sqrt(best[accepted]).astype(np.float64)
    return Matches(pairs, distances, query.positions[pairs[:, 0]], database.positions[pairs[:, 1]])


def _nearest(
    query: Descriptors, database: Descriptors, *, second_too: bool
) -> tuple[Int[Indices, "q"], Float[Singles, "q"], Float[Singles, "q"], Int[Indices, "d"]]:
    """Find nearest neighbours, some of the query's keypoints at a time.

    It gives for each of the query's keypoints the nearest of the database, its squared distance and
    that of the second nearest; and for each of the database's the nearest of the query.
    """
    nearest, back = np.empty(len(query), np.intp), np.zeros(len(database), np.intp)
    best, second = np.full((2, len(query)), np.inf, np.float32)
    least = np.full(len(database), np.inf, np.float32)
    together = max(1, MOST_DISTANCES // len(database))
    for start in range(0, len(query), together):
        some = slice(start, start + together)
        squared = _squared_distances(query[some], database)
        nearest[some] = squared.argmin(axis=1)
        closest = squared.argmin(axis=0)
        closest_squared = squared[closest, np.arange(len(database))]
        nearer = closest_squared < least
        back[nearer], least[nearer] = start + closest[nearer], closest_squared[nearer]
        best[some] = squared[np.arange(len(squared)), nearest[some]]
        if second_too and len(database) > 1:
            second[some] = np.partition(squared, 1, axis=1)[:, 1]
    # Of equal descriptors, rounding may leave less than nothing.
    return nearest, np.maximum(best, 0), np.maximum(second, 0), back


def _squared_distances(query: Descriptors, database: Descriptors) -> Float[Singles, "q d"]:
    """Squared L2 distances, of bits Hamming's, by one product: faster than OpenCV's matcher."""
    a, b = as_vectors(query), as_vectors(database)
    # |a - b|² = (-2a, |a|², 1)·(b, 1, |b|²): the product adds up all terms, and no pass follows.
    norms_a, norms_b = (np.einsum("ij,ij->i", vectors, vectors)[:, None] for vectors in (a, b))
    left = np.hstack([-2 * a, norms_a, np.ones_like(norms_a)])
    return np.asarray(left @ np.hstack([b, np.ones_like(norms_b), norms_b]).T, np.float32)
