"""Associations between two sets of keypoints: brute force, as the paper's Sec. V."""

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds
from gpgrad_core.types import Features, Matches


@dataclass(frozen=True)
class MatchParams:
    """Which nearest descriptors count as associations."""

    ratio: Annotated[
        float,
        Bounds(0.1, 1.0, 0.01),
        Doc("Keep a match if its distance is at most this share of the second best; 1 keeps all."),
    ] = 1.0
    mutual: Annotated[bool, Doc("Keep a match only if each keypoint is the other's nearest.")] = (
        True
    )

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)


def match_features(
    query: Features, database: Features, params: MatchParams | None = None
) -> Matches:
    """Associate each query keypoint with the nearest database descriptor, by brute force.

    Args:
        query: Keypoints of the query map.
        database: Keypoints of the database map, by the same detector.
        params: Which nearest neighbours count.
    """
    params = params or MatchParams()
    pairs, distances = _nearest(query, database, params.ratio)
    if params.mutual and len(pairs):
        back, _ = _nearest(database, query, 1.0)
        home = np.full(len(database), -1)
        home[back[:, 0]] = back[:, 1]
        mutual = home[pairs[:, 1]] == pairs[:, 0]
        pairs, distances = pairs[mutual], distances[mutual]
    return Matches(pairs, distances, query.positions[pairs[:, 0]], database.positions[pairs[:, 1]])


def _nearest(
    query: Features, database: Features, ratio: float
) -> tuple[
    np.ndarray[tuple[int, int], np.dtype[np.intp]], np.ndarray[tuple[int], np.dtype[np.float64]]
]:
    """Pairs (query, nearest in the database), and their descriptors' distances."""
    if len(query) == 0 or len(database) == 0:
        return np.zeros((0, 2), np.intp), np.zeros(0)
    # Strings of bits are compared by Hamming's distance, vectors by L2.
    norm = cv2.NORM_HAMMING if query.descriptors.dtype == np.uint8 else cv2.NORM_L2
    neighbours = 1 if ratio == 1.0 or len(database) == 1 else 2
    found = cv2.BFMatcher(norm).knnMatch(query.descriptors, database.descriptors, k=neighbours)
    best = [
        match[0]
        for match in found
        if len(match) == 1 or match[0].distance <= ratio * match[1].distance
    ]
    pairs = np.array([(m.queryIdx, m.trainIdx) for m in best], np.intp).reshape(-1, 2)
    return pairs, np.array([m.distance for m in best], np.float64)
