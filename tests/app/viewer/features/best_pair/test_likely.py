from dataclasses import replace

import numpy as np

from app.viewer.features.best_pair.likely import overlapping_pairs, voted_pairs
from gpgrad_core.arrays import Array
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, Features, Submap
from tests.support.synthetic import make_dataset, make_submap


def test_revisits_come_before_neighbours_and_the_largest_overlap_first() -> None:
    # Out along x and back, a little beside: 005 covers 000 nearly, and 004 covers 001 in part.
    places = ((0, 0), (2, 0), (4, 0), (16, 9), (3, 2), (0.3, 0.1))
    submaps = tuple(
        make_submap(f"{k:03d}", SE2(float(x), float(y), 0.5 * k)) for k, (x, y) in enumerate(places)
    )
    pairs = overlapping_pairs(Dataset("loop", submaps), 9)
    assert pairs[0] == ("005", "000")
    assert ("002", "000") in pairs  # on the way out
    assert pairs.index(("005", "001")) < pairs.index(("002", "000"))
    assert not any("003" in pair for pair in pairs)  # far away
    assert ("001", "000") not in pairs  # neighbours
    assert overlapping_pairs(Dataset("loop", submaps), 1) == pairs[:1]


def test_without_poses_nothing_overlaps() -> None:
    dataset = make_dataset()
    bare = tuple(replace(submap, pose_odometry=None) for submap in dataset.submaps)
    assert overlapping_pairs(Dataset("bare", bare), 5) == ()
    posed = (*bare[:3], dataset.submaps[3])
    assert overlapping_pairs(Dataset("one", posed), 5) == ()


def features(descriptors: Array, positions: Array) -> Features:
    ones = np.ones(len(positions))
    return Features(positions, ones, ones, 0 * ones, descriptors.astype(np.float32))


def test_without_poses_the_keypoints_vote() -> None:
    rng = np.random.default_rng(1)
    seen = {
        name: features(rng.normal(size=(60, 32)), rng.uniform(-3, 3, (60, 2)))
        for name in ("000", "001", "002", "003", "004")
    }
    turned = SE2(1.0, 2.0, 0.7).apply(seen["001"].positions)
    seen["004"] = replace(seen["001"], positions=turned)
    submaps = tuple(Submap.from_points(rng.normal(size=(9, 3)), name) for name in seen)
    told: list[float] = []
    pairs = voted_pairs(Dataset("plain", submaps), 2, lambda submap: seen[submap.id], told.append)
    assert pairs[0] == ("004", "001")
    assert len(pairs) == 2
    assert told[-1] == 1.0
