"""SURF, the paper's choice, on turned ground beside SIFT."""

import numpy as np

from tests.core.features.maps import right_matches

GROUNDS = list(range(2, 14))


def test_surf_is_right_at_least_as_often_as_sift_at_37_degrees() -> None:
    right = {name: right_matches(name, 37, GROUNDS) for name in ("surf", "sift", "slope")}
    for name, found in right.items():
        print(f"\n{name}: {100 * np.mean(found):.2f} % of {len(found)}")
    assert np.mean(right["surf"]) >= 0.95
    assert np.mean(right["surf"]) >= np.mean(right["sift"])
