"""Heights where submaps overlap tell of wrong poses."""

from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import measure_consistency
from gpgrad_core.types import Submap
from tests.core.ground import Ground

POSES = {f"{k}": Pose.from_planar(SE2(1.5 * k, 0.0, 0.3 * k)) for k in range(3)}


def submaps() -> list[Submap]:
    rng, ground = np.random.default_rng(0), Ground.random(2)
    clouds = []
    for name, pose in POSES.items():
        xy = rng.uniform(-2, 2, (4000, 2)) + pose.translation[:2]
        points = np.column_stack([xy, ground.height(xy)])
        clouds.append(Submap.from_points(pose.inverse().apply(points), name))
    return clouds


def test_true_poses_leave_next_to_no_difference() -> None:
    found = measure_consistency(iter(submaps()), POSES)
    assert found.count == 3
    assert found.median is not None
    assert found.median < 0.02


def test_a_wrong_height_shows() -> None:
    raised = POSES | {
        "2": replace(POSES["2"], translation=POSES["2"].translation + np.array([0, 0, 0.5]))
    }
    found = measure_consistency(submaps(), raised)
    assert found.median == pytest.approx(0.5, abs=0.02)
    assert found.high is not None
    assert found.high >= found.median


def test_apart_there_is_nothing_to_compare() -> None:
    apart = {name: Pose.from_planar(SE2(50.0 * int(name))) for name in POSES}
    assert measure_consistency(submaps(), apart).median is None
    assert measure_consistency(submaps(), {"0": POSES["0"]}).count == 0
