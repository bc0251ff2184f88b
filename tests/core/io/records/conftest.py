"""A small traverse with one loop closure, and a map, both made by hand."""

import numpy as np
import pytest

from gpgrad_core.detection import DetectionResult
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, GradientMap, Grid, LoopClosure, Registration, Submap

POSES = [
    Pose.from_planar(SE2(*place), z)
    for *place, z in ((0, 0, 0, 0), (5, 0, np.pi / 2, 0.2), (5, 5, np.pi, 0.1))
]


@pytest.fixture
def dataset() -> Dataset:
    rng = np.random.default_rng(0)
    return Dataset(
        "crater",
        tuple(
            Submap.from_points(rng.normal(size=(10, 3)), f"00{2 * index}", pose_odometry=pose)
            for index, pose in enumerate(POSES)
        ),
    )


@pytest.fixture
def result() -> DetectionResult:
    placed = Registration(
        SE2(5.1, 4.9, np.pi - 0.01), np.array([True] * 9 + [False]), 0.123456789012, 20.0, 0.8, 44.0
    )
    lost = Registration(None, np.zeros(0, dtype=bool), float("inf"), 0.0, 0.0, 0.0)
    return DetectionResult(
        closures=(
            LoopClosure("002", "000", lost, accepted=False, reason="no associations"),
            LoopClosure("004", "000", placed, accepted=True, reason="9 inliers >= 8"),
            LoopClosure("004", "002", lost, accepted=False, reason="no associations"),
        ),
        seconds={"maps": 0.12345, "features": 0.0, "pairs": 0.5, "total": 0.62},
    )


@pytest.fixture
def gradient_map() -> GradientMap:
    """Plane z = 0.5 x - 0.25 y of 30 x 20 cells, unseen on its right."""
    grid = Grid((-1.0, 2.0), 0.1, (20, 30))
    x, y = np.meshgrid(grid.x, grid.y)
    slope = np.broadcast_to([0.5, -0.25], (20, 30, 2)).copy()
    variance = np.where(x < 1.0, 0.0001, 0.36)
    return GradientMap(grid, 0.5 * x - 0.25 * y, variance, slope, 0.6, 0.3)
