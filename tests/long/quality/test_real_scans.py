"""Real LiDAR returns on natural ground: what stands on it is left out, and every closure is right.

A minute. One scan is split by the parity of its rings into eight submaps that share no return.
"""

from pathlib import Path

import numpy as np
import pytest

import gpgrad_core as gg
from gpgrad_core.detection import resolve_parameters
from gpgrad_core.types import LoopClosure, Submap
from tests.long.quality.test_calibration import squared_error

APART = ("007", "006")
"""The one pair across parity that shares no ground."""


@pytest.mark.parametrize("name", ["marv", "tradr"])
def test_closures_of_real_returns_are_right(name: str, real_data: Path) -> None:
    dataset = gg.load_dataset(real_data / "real_scans" / name)
    used = resolve_parameters(dataset.submaps)
    names = [submap.id for submap in dataset.submaps]
    only = [
        (query, database)
        for i, database in enumerate(names)
        for query in names[i + 1 :]
        if (int(query) + int(database)) % 2
    ]
    closures = gg.detect_loop_closures(dataset, used, only=only).closures
    assert len(closures) == 16
    shared = [c for c in closures if (c.query_id, c.database_id) != APART]
    submaps = {submap.id: submap for submap in dataset.submaps}
    errors, squares = map(np.array, zip(*(_errors(c, submaps) for c in shared), strict=True))
    ground = sum(submap.num_points for submap in dataset.submaps)
    standing = sum(submap.num_standing for submap in dataset.submaps)
    print(
        f"\n{name}: {standing / (ground + standing):.0%} of the points stand on the ground; noise "
        f"{100 * (used.map.noise_std or 0):.1f} cm, length-scale {used.map.length_scale} m; "
        f"{sum(c.accepted for c in shared)} of {len(shared)} accepted, median error "
        f"{100 * np.median(errors):.2f} cm, largest {100 * errors.max():.2f} cm; squared "
        f"Mahalanobis / 3: mean {squares.mean():.2f}; in the 68 % ellipse "
        f"{np.mean(3 * squares < 3.51):.0%}, in the 95 % one {np.mean(3 * squares < 7.81):.0%}"
    )
    assert all(closure.accepted for closure in shared)
    assert not any(c.accepted for c in closures if (c.query_id, c.database_id) == APART)
    assert np.median(errors) <= 0.01
    assert errors.max() <= 0.05
    assert (used.map.noise_std or 1.0) <= 0.03  # with what stands there it is 0.54 m
    assert (used.map.length_scale or 0.0) >= 0.135  # … and 0.09 m
    # One instant has no drift, but nothing says so to a pair; 1 is honest.
    assert 0.2 <= squares.mean() <= 1.2
    again = [Submap.from_points(submap.points, submap.id) for submap in dataset.submaps]
    assert not any(submap.num_standing for submap in again)


def test_bare_terrain_stays_as_it_is(real_data: Path) -> None:
    sets = [gg.demo_path(), *(file.parent for file in sorted(real_data.glob("*/pairs_iou.csv")))]
    assert len(sets) > 1
    for folder in sets:
        for file in sorted((folder / "submaps").iterdir()):
            submap = gg.load_dataset(file).submaps[0]
            assert (file, submap.num_standing) == (file, 0)


def _errors(closure: LoopClosure, submaps: dict[str, Submap]) -> tuple[float, float]:
    """Measure how far the query's middle is off [m], and the squared Mahalanobis error / 3."""
    query, database = submaps[closure.query_id], submaps[closure.database_id]
    registration = closure.registration
    motion = registration.T_database_query
    assert motion is not None
    assert query.pose_true is not None
    assert database.pose_true is not None
    true = database.pose_true.planar.inverse() @ query.pose_true.planar
    middle = query.points[:, :2].mean(axis=0)[None]
    off = float(np.hypot(*(motion.apply(middle) - true.apply(middle))[0]))
    return off, squared_error(registration, true) / 3
