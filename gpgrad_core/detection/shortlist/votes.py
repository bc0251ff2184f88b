"""Votes for a pair of submaps: associations whose distances from each other agree.

This is the weakest geometric check that tells places apart: a motion of the plane keeps the
distances between points. It needs no motion, no search and no map.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import read_only

MOST_ASSOCIATIONS = 96
"""Only so many associations of the most similar descriptors vote."""
NEAREST = 2.0
"""Associations closer to each other than this do not vote for each other, because any two of them
would agree [tolerances]."""

Vectors = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Voters:
    """The strongest keypoints of a submap.

    Attributes:
        descriptors: Their descriptors (m, c), in half precision if they are short.
        positions: Their positions (m, 2) [m].
        tolerance: Difference up to which two distances agree [m].
    """

    descriptors: Float[NDArray[np.floating], "m c"]
    positions: Float[Vectors, "m 2"]
    tolerance: float

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        read_only(self.descriptors)
        read_only(self.positions)


def count_votes(query: Voters, others: list[Voters]) -> list[int]:
    """Count the votes for each of some earlier submaps.

    Keypoints are associated if each is the nearest of the other. Two associations agree if their
    two keypoints are as far apart in one submap as in the other. The votes are those of the pair
    of agreeing associations with which most others agree: these two fix the motion, but for a
    reflection.

    Args:
        query: The strongest keypoints of the new submap.
        others: Those of the earlier submaps, with descriptors of the same kind.

    Returns:
        The votes for each earlier submap.
    """
    left = _augmented(query.descriptors, first=True)
    return [_votes(query, left, other) for other in others]


def _augmented(
    descriptors: Float[NDArray[np.floating], "m c"], *, first: bool
) -> Float[Vectors, "m e"]:
    """Add two columns, so that a product of two such rows is minus half their squared distance."""
    vectors = descriptors.astype(np.float32)
    norms = -0.5 * np.einsum("ij,ij->i", vectors, vectors)[:, None]
    ones = np.ones_like(norms)
    return np.hstack([vectors, ones, norms] if first else [vectors, norms, ones])


def _votes(query: Voters, left: Float[Vectors, "m e"], other: Voters) -> int:
    if len(left) == 0 or len(other.descriptors) == 0:
        return 0
    nearness = left @ _augmented(other.descriptors, first=False).T
    nearest = nearness.argmax(axis=1)
    reached = nearness[np.arange(len(left)), nearest]
    # The largest value of each column takes a third of the time of where it is.
    kept = np.flatnonzero(reached == nearness.max(axis=0)[nearest])
    if len(kept) > MOST_ASSOCIATIONS:
        order = np.argsort(-reached[kept], kind="stable")
        kept = kept[order[:MOST_ASSOCIATIONS]]
    tolerance = max(query.tolerance, other.tolerance)
    here, there = query.positions[kept], other.positions[nearest[kept]]
    apart = _distances(here)
    agree = np.abs(apart - _distances(there)) <= tolerance
    agree &= apart >= NEAREST * tolerance
    graph = agree.astype(np.float32)
    if not agree.any():
        return 0
    # Entry (k, l) counts the associations that agree with both k and l.
    common = graph @ graph
    return 2 + int(np.max(common * graph))


def _distances(positions: Float[Vectors, "m 2"]) -> Float[Vectors, "m m"]:
    x, y = positions[:, 0], positions[:, 1]
    along, across = x[:, None] - x, y[:, None] - y
    return np.sqrt(along * along + across * across)
