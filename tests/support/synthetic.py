"""A small terrain of known shape, and results for it that need no inference."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from app.viewer.features.pairs.model import PairsRun
from app.viewer.session.state import ViewState, open_dataset
from gpgrad_core.arrays import Array
from gpgrad_core.detection import PairResult, Pairs, PipelineParams, with_numbers_of
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.evaluation import measure_pairs
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run import Progress, silent
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    Grid,
    LoopClosure,
    Matches,
    Refusal,
    Registration,
    Submap,
)

T_DATABASE_QUERY = SE2(1.0, -0.5, np.pi / 2)

NUMBERS = with_numbers_of(PipelineParams(map=MapParams(resolution=0.12)), PipelineParams())
"""The defaults with coarse maps, which are quick, and with numbers that need no fit."""


def height(xy: Array) -> Array:
    """Compute the height of the terrain at world positions [m]."""
    x, y = xy[:, 0], xy[:, 1]
    return (
        0.3 * np.sin(1.3 * x)
        + 0.2 * np.cos(1.7 * y + 0.5)
        + 0.15 * np.sin(2.9 * x + 2.1 * y)
        + 0.1 * np.cos(4.3 * x - 3.7 * y)
    )


def slope(xy: Array) -> Array:
    """Compute the slope (dz/dx, dz/dy) of `height` [m/m]."""
    x, y = xy[:, 0], xy[:, 1]
    a, b = np.cos(2.9 * x + 2.1 * y), np.sin(4.3 * x - 3.7 * y)
    return np.column_stack(
        [
            0.39 * np.cos(1.3 * x) + 0.435 * a - 0.43 * b,
            -0.34 * np.sin(1.7 * y + 0.5) + 0.315 * a + 0.37 * b,
        ]
    )


@cache  # its arrays are read-only, and many modules ask for the same ones
def make_submap(
    submap_id: str, T_world_submap: SE2, num_points: int = 1500, side: float = 5.0
) -> Submap:
    """Sample the terrain around a pose; heights are those of the world, because z is aligned."""
    rng = np.random.default_rng(int(submap_id))
    local = rng.uniform(-side / 2, side / 2, (num_points, 2))
    z = height(T_world_submap.apply(local)) + rng.normal(0, 0.01, num_points)
    half = T_world_submap.yaw / 2
    pose = Pose(
        np.array([T_world_submap.x, T_world_submap.y, 0.0]),
        np.array([0.0, 0.0, np.sin(half), np.cos(half)]),
    )
    return Submap.from_points(np.column_stack([local, z]), submap_id, pose_odometry=pose)


def make_dataset(num_points: int = 1500, name: str = "hills") -> Dataset:
    """Make four submaps on a way out and back; 003 revisits 000, rotated by a quarter turn."""
    poses = (
        SE2(0.0, 0.0, 0.0),
        SE2(6.0, 0.0, 0.3),
        SE2(12.0, 3.0, 1.0),
        T_DATABASE_QUERY,
    )
    submaps = tuple(
        make_submap(f"{number:03d}", pose, num_points) for number, pose in enumerate(poses)
    )
    return Dataset(name, submaps, description="Smooth hills of known shape.")


def make_map(submap: Submap, resolution: float = 0.1) -> GradientMap:
    """Make the true map of a submap; its variance grows towards the edge."""
    assert submap.pose_odometry is not None
    pose = submap.pose_odometry.planar
    grid = Grid.covering(submap.points[:, :2], resolution)
    world = pose.apply(grid.positions)
    rim = np.abs(grid.positions).max(axis=1) / 2.5
    local_slope = pose.inverse().rotate(slope(world))
    return GradientMap(
        grid,
        height(world).reshape(grid.shape),
        (0.3 * rim**2).reshape(grid.shape) ** 2,
        local_slope.reshape(*grid.shape, 2),
        signal_std=0.3,
        length_scale=0.3,
    )


def make_result(state: ViewState, num_inliers: int = 12, num_outliers: int = 5) -> PairResult:
    """Make a result without inference: true maps, the true motion, inliers and outliers."""
    query_map, database_map = make_map(state.query), make_map(state.database)
    rng = np.random.default_rng(0)
    count = num_inliers + num_outliers
    query_xy = rng.uniform(-1.2, 1.2, (count, 2))
    database_xy = T_DATABASE_QUERY.apply(query_xy)
    database_xy[num_inliers:] += 1.0
    inliers = np.arange(count) < num_inliers
    registration = Registration(T_DATABASE_QUERY, inliers, 0.5, 12.5, 0.93, 4.2)
    needed = state.params.closure.min_inliers
    accepted = num_inliers >= needed
    closure = LoopClosure(
        state.query_id,
        state.database_id,
        registration,
        accepted,
        f"{num_inliers} inliers {'>=' if accepted else '<'} {needed}",
        refusal=None
        if accepted
        else Refusal("few inliers", {"count": num_inliers, "least": needed}),
    )
    pairs = np.column_stack([np.arange(count), np.arange(count)])
    matches = Matches(pairs, np.ones(count), query_xy, database_xy)
    return PairResult(
        query_map,
        database_map,
        make_features(query_xy),
        make_features(database_xy),
        matches,
        registration,
        closure,
    )


PAIR_SCORES = {
    ("001", "000"): 4.0,
    ("002", "000"): 2.0,
    ("002", "001"): 3.0,
    ("003", "000"): 5.0,
    ("003", "001"): 1.0,
    ("003", "002"): 0.25,
}


MISPLACED = ("003", "001")
"""The pair of `make_compared` whose motion is a metre off."""


def closures_alone(run: PairsRun) -> tuple[LoopClosure, ...]:
    """Give all pairs, each judged alone."""
    assert run.table is not None
    return tuple(run.table.judge(ClosureParams(others="off")))


def make_compared() -> PairsRun:
    """Make a run that has all pairs of `make_dataset`, with made-up scores."""
    dataset = make_dataset()
    true = tuple(replace(submap, pose_true=submap.pose_odometry) for submap in dataset.submaps)
    dataset = replace(dataset, submaps=true)
    places = {submap.id: submap.pose_odometry for submap in dataset.submaps}

    def motion(query: str, database: str) -> SE2:
        of_query, of_database = places[query], places[database]
        assert of_query is not None
        assert of_database is not None
        true_motion = of_database.planar.inverse() @ of_query.planar
        return true_motion @ SE2(1.0, 0.0, 0.0) if (query, database) == MISPLACED else true_motion

    registered = {
        pair: Registration(motion(*pair), np.arange(20) < 4 * score, 0.5, 10, 0.9, score)
        for pair, score in PAIR_SCORES.items()
    }
    pairs = Pairs.of(dataset.submaps, registered, NUMBERS)
    pairs.seconds = {"maps": 1.0, "features": 1.0, "pairs": 1.0, "total": 3.0}
    state = open_dataset(dataset, NUMBERS)
    return PairsRun(state, "all", registered, measure_pairs(dataset), pairs, has_ended=True)


def make_features(positions: Array) -> Features:
    """Make keypoints at positions, and one more that has no association."""
    more = np.vstack([positions, [[0.0, 0.0]]])
    count = len(more)
    return Features(
        more, np.ones(count), np.ones(count), np.zeros(count), np.zeros((count, 4), np.float32)
    )


class FakePipeline:
    """A replacement for `register_pair`, as slow or as broken as a test wants."""

    def __init__(self, make: Callable[[ViewState], PairResult] = make_result) -> None:
        self.make = make
        self.calls: list[PipelineParams] = []
        self.kept: dict[object, PairResult] = {}
        self.error: Exception | None = None

    def __call__(
        self,
        query: Submap,
        database: Submap,
        params: PipelineParams,
        memo: object,  # noqa: ARG002
        progress: Progress = silent,
        helper: object = None,  # noqa: ARG002
        method: str = "gradient",  # noqa: ARG002
    ) -> PairResult:
        self.calls.append(params)
        progress(0.5)
        if self.error is not None:
            raise self.error
        key = (query.id, database.id, params)
        if key not in self.kept:
            dataset = Dataset("fake", (query, database))
            self.kept[key] = self.make(ViewState(dataset, query.id, database.id, params))
        return self.kept[key]


def needing(min_inliers: int) -> PipelineParams:
    """Make the default params with another threshold on inliers."""
    return replace(NUMBERS, closure=ClosureParams(min_inliers=min_inliers))
