"""A traverse of square submaps whose overlaps can be told by hand."""

import numpy as np

from gpgrad_core.detection import DetectionResult
from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, LoopClosure, Registration, Submap

SIDE = 4.0


def square(step: float = 0.1) -> np.ndarray:
    """Points in the middle of every 10 cm cell of a square about the origin; its corners too."""
    middle = np.arange(-SIDE / 2 + step / 2, SIDE / 2, step)
    x, y = np.meshgrid(middle, middle)
    inner = np.column_stack([x.ravel(), y.ravel()])
    return np.column_stack([inner, 0.1 * inner[:, 0]])


def pose(x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> Pose:
    return Pose.from_planar(SE2(x, y, yaw), z)


PLACES = [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (20.0, 0.0, 0.0), (1.0, 0.0, np.pi), (3.0, 0.0, 0.0)]
"""003 shares three quarters of 000, turned about; 004 half of 003 and a quarter of 000."""

DATASET = Dataset(
    "squares",
    tuple(
        Submap.from_points(square(), f"{k:03d}", pose_true=pose(*place))
        for k, place in enumerate(PLACES)
    ),
)
PAIRS = measure_pairs(DATASET)


def closure(
    query: str,
    database: str,
    score: float = 1.0,
    motion: SE2 | None = None,
    num_inliers: int = 0,
    *,
    accepted: bool = False,
) -> LoopClosure:
    found = Registration(motion, np.ones(num_inliers, bool), 1.0, 1.0, 0.5, score)
    return LoopClosure(query, database, found, accepted, "because")


RIGHT = SE2(1.0, 0.0, np.pi)
"""The true motion of 003 in 000."""


RESULT = DetectionResult(
    (
        closure("001", "000", 0.5),
        closure("002", "000", 2.0, SE2(1.0, 1.0, 1.0), 4),
        closure("002", "001", 0.1),
        closure("003", "000", 9.0, SE2(1.03, 0.04, np.pi - 0.02), 20, accepted=True),
        closure("003", "001", 3.0, SE2(), 6, accepted=True),
        closure("003", "002", 0.2),
        closure("004", "000", 5.0, SE2(3.0, 0.0, 0.0), 9, accepted=True),
        closure("004", "001", 0.3),
        closure("004", "002", 0.3),
        closure("004", "003", 7.0),
    ),
    {"maps": 1.0, "features": 0.5, "pairs": 0.25, "total": 1.75},
)
"""The true pair found a hand's breadth off; a false one below it; a grey one placed right."""


def report(*pairs: LoopClosure, method: str = "other") -> ClosureReport:
    return ClosureReport("squares", method, 0, {}, {}, {}, {}, pairs)
