"""Simulated traverses for the pose graph: poses and closures, without any ground."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gpgrad_core.detection import StagedDetector
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import PoseGraph, build_pose_graph
from gpgrad_core.types import Agreement, Dataset, LoopClosure, Registration, Submap

STEP, ROW_WIDTH, REACH = 5.0, 4.0, 6.0
CLOSURE_STD = np.array([0.05, 0.06, 0.014])
HEIGHT_STD = 0.03


@dataclass(frozen=True, eq=False)
class Traverse:
    """A lawn-mower's path with drift, and what a detector would find on it."""

    dataset: Dataset
    closures: tuple[LoopClosure, ...]  # all accepted
    wrong: frozenset[tuple[str, str]]  # (query, database) of those that are wrong

    @property
    def true_xyz(self) -> np.ndarray:
        return np.array([pose.translation for pose in self.true_poses.values()])

    @property
    def true_poses(self) -> dict[str, Pose]:
        return self.dataset.true_poses

    def graph(self, *params: Any, **named: Any) -> PoseGraph:
        return build_pose_graph(self.dataset, self.closures, *params, **named)


def simulate(
    count: int, seed: int = 0, *, row: int = 10, wrong: float = 0.0, heading_drift: float = 0.012
) -> Traverse:
    """Drive rows side by side; ``wrong`` is the share of the closures that are made up."""
    rng = np.random.default_rng(seed)
    places = np.zeros((count, 3))
    for k in range(count):
        number, column = divmod(k, row)
        back = number % 2 == 1
        x = STEP * (row - 1 - column if back else column)
        places[k] = x, number * ROW_WIDTH, pi if back else 0.0
    places += np.column_stack([rng.normal(0, 0.3, (count, 2)), rng.normal(0, 0.1, count)])
    heights = np.cumsum(rng.normal(0, 0.1, count))
    true = [
        Pose.from_planar(SE2(*map(float, place)), float(height))
        for place, height in zip(places, heights, strict=True)
    ]
    believed = [true[0]]
    for k in range(1, count):
        driven = true[k - 1].inverse() @ true[k]
        distance = float(np.linalg.norm(driven.translation))
        offset = 0.02 * distance * rng.standard_normal(2)
        yaw = heading_drift * np.sqrt(distance) * rng.standard_normal()
        error = Pose.from_planar(SE2(*map(float, offset), float(yaw)), float(rng.normal(0, 0.02)))
        believed.append(believed[-1] @ driven @ error)
    submaps = tuple(
        Submap.from_points(
            points_about_zero(k),
            f"{k:04d}",
            pose_true=at,
            pose_odometry=thought,
            ground=None,
        )
        for k, (at, thought) in enumerate(zip(true, believed, strict=True))
    )
    near = sorted((a, b) for a, b in cKDTree(places[:, :2]).query_pairs(REACH) if b - a > 1)
    closures = [closure_of(submaps, a, b, rng) for a, b in near]
    num_wrong = round(wrong / (1 - wrong) * len(closures))
    made_up: set[tuple[str, str]] = set()
    while len(made_up) < num_wrong:
        a, b = sorted(int(k) for k in rng.choice(count, 2, replace=False))
        far = np.hypot(*(places[a] - places[b])[:2]) > 2 * REACH
        pair = submaps[b].id, submaps[a].id
        if not far or pair in made_up:
            continue
        motion = SE2(*map(float, [*rng.uniform(-5, 5, 2), rng.uniform(-pi, pi)]))
        closures.append(closure(*pair, motion, float(rng.normal(0, 0.3))))
        made_up.add(pair)
    return Traverse(Dataset("rows", submaps), tuple(closures), frozenset(made_up))


def points_about_zero(seed: int) -> np.ndarray:
    """Draw points whose mean is zero, without any rounding."""
    half = np.rint(64 * np.random.default_rng(seed).normal(size=(10, 3))) / 64
    return np.vstack([half, -half])


def closure_of(
    submaps: tuple[Submap, ...], database: int, query: int, rng: np.random.Generator
) -> LoopClosure:
    """The true motion between two submaps, with a registration's errors."""
    T_database_query = submaps[database].pose_true.inverse() @ submaps[query].pose_true
    x, y, yaw = (float(error) for error in CLOSURE_STD * rng.standard_normal(3))
    true = T_database_query.planar
    motion = SE2(true.x + x, true.y + y, true.yaw + yaw)
    height = float(T_database_query.translation[2] + rng.normal(0, HEIGHT_STD))
    return closure(submaps[query].id, submaps[database].id, motion, height)


def closure(query: str, database: str, motion: SE2, height: float) -> LoopClosure:
    registration = Registration(
        motion, np.ones(50, bool), 1.0, 30.0, 0.8, 8.0, height, np.diag(CLOSURE_STD**2)
    )
    return LoopClosure(query, database, registration, accepted=True, reason="simulated")


NOTHING = Registration(None, np.zeros(0, bool), np.inf, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Oracle(StagedDetector[Any, Any]):
    """A detector that knows what there is to be found, and counts what it is asked."""

    known: dict[tuple[str, str], Registration]
    compared: list[tuple[str, str]] = field(default_factory=list)

    @classmethod
    def of(cls, traverse: Traverse, *, agreeing: bool = False) -> "Oracle":
        """Know a traverse's closures, which say something of each other if they are agreeing."""
        known = {closure.pair: closure.registration for closure in traverse.closures}
        if agreeing:
            for k, (pair, found) in enumerate(known.items()):
                agreement = Agreement(0.01, 0.01 + 0.001 * (k % 5), 0.15)
                known[pair] = replace(found, score=2.0 + k % 3, scale=0.3, agreement=agreement)
        return cls(known)

    def infer(self, submap: Submap, progress: Progress = silent) -> tuple[str, np.ndarray]:
        progress(1.0)
        return submap.id, np.zeros(1000)

    def compare(
        self, query: tuple[str, np.ndarray], database: tuple[str, np.ndarray]
    ) -> Registration:
        self.compared.append((query[0], database[0]))
        return self.known.get((query[0], database[0]), NOTHING)


def with_odometry(dataset: Dataset, change: Callable[[Pose], Pose | None]) -> Dataset:
    """Change every odometry pose."""
    submaps = [
        replace(submap, pose_odometry=submap.pose_odometry and change(submap.pose_odometry))
        for submap in dataset.submaps
    ]
    return replace(dataset, submaps=tuple(submaps))
