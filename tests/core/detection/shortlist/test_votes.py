"""Associations vote for each other if they are as far apart in both submaps."""

import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection.signatures import Voters, count_votes


def voters(positions: list[tuple[float, float]], names: list[int] | None = None) -> Voters:
    """Keypoints, the descriptor of each of which is its own direction."""
    names = names if names is not None else list(range(len(positions)))
    described: NDArray[np.float32] = np.eye(12, dtype=np.float32)[names]
    return Voters(described, np.array(positions, np.float32).reshape(-1, 2), 0.1)


SQUARE = [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (0.0, 4.0)]


def test_by_hand() -> None:
    turned = [(-y + 7.0, x - 2.0) for x, y in SQUARE]
    one_moved = [*turned[:3], (0.0, 0.0)]
    scattered = [(0.0, 0.0), (1.0, 0.0), (5.0, 5.0), (9.0, 1.0)]
    others = [voters(SQUARE), voters(turned), voters(one_moved), voters(scattered), voters([])]
    assert count_votes(voters(SQUARE), others) == [4, 4, 3, 0, 0]
    assert count_votes(voters([]), others) == [0, 0, 0, 0, 0]


def test_only_the_nearest_of_each_other_are_associated() -> None:
    # Two keypoints of the other submap look alike: only one of them can be associated.
    other = voters([*SQUARE, (9.0, 9.0)], [0, 1, 2, 3, 7])
    assert count_votes(voters(SQUARE), [other]) == [4]
    assert count_votes(voters(SQUARE), [voters(SQUARE, [4, 5, 6, 7])])[0] <= 4


def test_a_distance_may_differ_by_the_tolerance() -> None:
    stretched = [(1.01 * x, 1.01 * y) for x, y in SQUARE]
    too_far = [(1.1 * x, 1.1 * y) for x, y in SQUARE]
    assert count_votes(voters(SQUARE), [voters(stretched), voters(too_far)]) == [4, 0]


def test_associations_at_one_place_do_not_vote_for_each_other() -> None:
    heap = [(0.0, 0.01 * k) for k in range(10)]
    assert count_votes(voters(heap), [voters(heap)]) == [0]
