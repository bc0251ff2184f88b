"""Associations of 3D descriptors."""

import numpy as np

from gpgrad_core.methods.described_clouds import DescribedCloud, mutual_matches


def described(*descriptors: tuple[float, float]) -> DescribedCloud:
    values = np.array(descriptors, np.float32)
    return DescribedCloud(np.zeros((len(values), 3)), values, np.zeros((1, 3)))


def test_a_threshold_drops_associations_of_distant_descriptors() -> None:
    query, database = described((0, 0), (5, 0), (9, 0)), described((5.3, 0.4), (0, 0.1), (5.9, 0))
    assert mutual_matches(query, database).tolist() == [[0, 1], [1, 0]]
    assert mutual_matches(query, database, 0.51).tolist() == [[0, 1], [1, 0]]
    assert mutual_matches(query, database, 0.49).tolist() == [[0, 1]]
