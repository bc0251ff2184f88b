"""Votes for a pair of submaps: associations whose distances from each other agree.

A motion of the plane keeps the distances between points, so this check needs no motion, no search
and no map.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.types import read_only

MOST_ASSOCIATIONS = 96
"""Only so many associations of the most similar descriptors vote."""
NEAREST = 2.0
"""Associations closer to each other than this do not vote for each other, because any two would
agree [tolerances]."""
TOGETHER = 4
"""So many submaps' votes are counted in one go: threads wait for each other in many small steps."""

Vectors = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Voters:
    """The strongest keypoints of a submap."""

    # their descriptors (m, c), in half precision if they are short
    descriptors: Float[NDArray[np.floating], "m c"]
    positions: Float[Vectors, "m 2"]  # their positions (m, 2) [m]
    tolerance: float  # difference up to which two distances agree [m]

    def __post_init__(self) -> None:
        read_only(self.descriptors)
        read_only(self.positions)

    @cached_property
    def half_norms(self) -> Float[Vectors, "m"]:
        """Minus half the squared length of each descriptor (m,)."""
        vectors = self.descriptors.astype(np.float32)
        return np.asarray(-0.5 * np.einsum("ij,ij->i", vectors, vectors), np.float32)


def count_votes(query: Voters, others: list[Voters]) -> list[int]:
    """Count the votes for each of some earlier submaps.

    Keypoints are associated if each is the nearest of the other. Two associations agree if their
    keypoints are as far apart in one submap as in the other. The votes are those of the pair of
    agreeing associations with which most others agree: it fixes the motion, but for a reflection.
    """
    left = _augmented(query, first=True)
    return [
        votes
        for first in range(0, len(others), TOGETHER)
        for votes in _count_together(query, left, others[first : first + TOGETHER])
    ]


def _augmented(voters: Voters, *, first: bool) -> Float[Vectors, "m e"]:
    """Add two columns, so that a product of two such rows is minus half their squared distance."""
    count, length = voters.descriptors.shape
    rows = np.empty((count, length + 2), np.float32)
    rows[:, :length] = voters.descriptors
    rows[:, length + first], rows[:, length + 1 - first] = voters.half_norms, 1.0
    return rows


def _count_together(query: Voters, left: Float[Vectors, "m e"], others: list[Voters]) -> list[int]:
    # What is not a number agrees with nothing.
    places = np.full((2, len(others), MOST_ASSOCIATIONS, 2), np.nan, np.float32)
    for k, other in enumerate(others):
        here, there = _associate(left, other)
        places[0, k, : len(here)] = query.positions[here]
        places[1, k, : len(there)] = other.positions[there]
    tolerances = np.array([max(query.tolerance, other.tolerance) for other in others])
    tolerance, least = np.array([tolerances, NEAREST * tolerances], np.float32)[..., None, None]
    apart, differing = _distances(places)
    differing -= apart
    agree = np.abs(differing, out=differing) <= tolerance
    agree &= apart >= least
    graph = agree.astype(np.float32)
    # Entry (k, l) counts the associations that agree with both k and l.
    common = graph @ graph
    common *= graph
    most = common.max(axis=(1, 2), initial=0.0).astype(int)
    return np.where(agree.any(axis=(1, 2)), 2 + most, 0).tolist()


def _associate(
    left: Float[Vectors, "m e"], other: Voters
) -> tuple[Int[NDArray[np.intp], "k"], Int[NDArray[np.intp], "k"]]:
    """Find the most similar of the keypoints that are the nearest of each other, of both sides."""
    if len(left) == 0 or len(other.descriptors) == 0:
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    nearness = left @ _augmented(other, first=False).T
    nearest = nearness.argmax(axis=1)
    reached = nearness[np.arange(len(left)), nearest]
    # The largest value of each column takes a third of the time of where it is.
    kept = np.flatnonzero(reached == nearness.max(axis=0)[nearest])
    if len(kept) > MOST_ASSOCIATIONS:
        order = np.argsort(-reached[kept], kind="stable")
        kept = kept[order[:MOST_ASSOCIATIONS]]
    return kept, nearest[kept]


def _distances(positions: Float[Vectors, "*some m 2"]) -> Float[Vectors, "*some m m"]:
    x, y = positions[..., 0], positions[..., 1]
    along, across = x[..., :, None] - x[..., None, :], y[..., :, None] - y[..., None, :]
    along *= along
    across *= across
    along += across
    return np.sqrt(along, out=along)
