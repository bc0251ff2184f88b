"""SURF, the paper's choice, on turned ground beside SIFT."""

import numpy as np

from gpgrad_core.features import DetectorParams, FeatureParams, extract_features
from tests.core.features.maps import ground_turned_by, right_matches

GROUNDS = list(range(2, 14))


def turned(detector: str, degrees: float) -> list[bool]:
    """Say of every mutual match between a ground and the same, turned, whether it is right."""
    params, right = FeatureParams(detector=DetectorParams(detector)), list[bool]()
    for seed in GROUNDS:
        query, T_world_query = ground_turned_by(degrees, 0.03, seed)
        database, _ = ground_turned_by(0, 0.03, seed)
        features = [extract_features(made, params) for made in (query, database)]
        right += right_matches(*features, T_world_query, 0.15, 4.5).tolist()
    return right


def test_surf_is_right_at_least_as_often_as_sift_at_37_degrees() -> None:
    right = {name: turned(name, 37) for name in ("surf", "sift", "slope")}
    for name, found in right.items():
        print(f"\n{name}: {100 * np.mean(found):.2f} % of {len(found)}")
    assert np.mean(right["surf"]) >= 0.95
    assert np.mean(right["surf"]) >= np.mean(right["sift"])
