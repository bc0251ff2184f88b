"""The demo that ships is the one that its parameters make, and shows what a demo should."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.simulation.demo import demo_path, simulate_demo
from gpgrad_core.types import Dataset, Submap

MAX_BYTES = 4_000_000


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return load_dataset(demo_path())


@pytest.mark.slow
def test_it_is_made_anew_bit_for_bit(tmp_path: Path) -> None:
    write_dataset(simulate_demo(), tmp_path / "demo")
    shipped = {path.relative_to(demo_path()) for path in demo_path().rglob("*") if path.is_file()}
    made = {p.relative_to(tmp_path / "demo") for p in (tmp_path / "demo").rglob("*") if p.is_file()}
    assert made == shipped
    for path in made:
        same = (tmp_path / "demo" / path).read_bytes() == (demo_path() / path).read_bytes()
        assert same, f"{path} differs from the one that ships"


def test_it_is_small() -> None:
    assert sum(path.stat().st_size for path in demo_path().rglob("*")) <= MAX_BYTES


def box_overlap(a: Submap, b: Submap) -> float:
    """Intersection over union of the boxes in the world, the paper's Eq. (8)."""
    boxes = []
    for submap in (a, b):
        assert submap.pose_true is not None
        xy = submap.pose_true.apply(submap.points)[:, :2]
        boxes.append((xy.min(axis=0), xy.max(axis=0)))
    (low_a, high_a), (low_b, high_b) = boxes
    sides = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    common = float(np.prod(np.clip(sides, 0.0, None)))
    return common / float(np.prod(high_a - low_a) + np.prod(high_b - low_b) - common)


def test_it_has_revisits_from_the_other_side_and_strangers(demo: Dataset) -> None:
    revisits, strangers = 0, 0
    for j, query in enumerate(demo.submaps):
        for database in demo.submaps[: max(0, j - 1)]:
            overlap = box_overlap(query, database)
            assert query.pose_true is not None
            assert database.pose_true is not None
            turn = (database.pose_true.planar.inverse() @ query.pose_true.planar).yaw
            revisits += overlap > 0.3 and abs(turn) > np.radians(120)
            strangers += overlap == 0
    assert revisits >= 5
    assert strangers >= 8


def test_the_pair_shown_first_is_a_revisit(demo: Dataset) -> None:
    query = demo.submap(str(demo.preferred["query"]))
    database = demo.submap(str(demo.preferred["database"]))
    assert box_overlap(query, database) > 0.5
    assert query.pose_true is not None
    assert database.pose_true is not None
    assert query.pose_odometry is not None
    turn = (database.pose_true.planar.inverse() @ query.pose_true.planar).yaw
    assert abs(turn) > np.radians(150)
    drift = query.pose_odometry.translation - query.pose_true.translation
    assert np.linalg.norm(drift) > 0.3
