"""The demo that ships is the one that its parameters make, and shows what a demo should."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.simulation.demo import demo_path, simulate_demo
from gpgrad_core.types import Dataset
from tests.core.simulation.test_roaming import files_of


@pytest.fixture(scope="module")
def demo() -> Dataset:
    return load_dataset(demo_path())


@pytest.mark.slow
def test_it_is_made_anew_bit_for_bit(tmp_path: Path) -> None:
    write_dataset(simulate_demo(), tmp_path / "demo")
    made, shipped = files_of(tmp_path / "demo"), files_of(demo_path())
    assert made.keys() == shipped.keys()
    assert [name for name in made if made[name] != shipped[name]] == []


def test_it_is_small() -> None:
    assert sum(path.stat().st_size for path in demo_path().rglob("*")) <= 4_000_000


def test_it_has_revisits_from_the_other_side_and_strangers(demo: Dataset) -> None:
    pairs = measure_pairs(demo)
    apart = pairs.steps > 1
    turned = np.abs(pairs.relative_yaw) > np.radians(120)
    assert np.sum(apart & turned & (pairs.box_iou > 0.3)) >= 5
    assert np.sum(apart & (pairs.box_iou == 0)) >= 8


def test_the_pair_shown_first_is_a_revisit(demo: Dataset) -> None:
    pairs = measure_pairs(demo)
    query = demo.submap(str(demo.preferred["query"]))
    row = pairs.rows[frozenset((query.id, str(demo.preferred["database"])))]
    assert pairs.box_iou[row] > 0.5
    assert abs(pairs.relative_yaw[row]) > np.radians(150)
    drift = query.pose_odometry.translation - query.pose_true.translation
    assert np.linalg.norm(drift) > 0.3
