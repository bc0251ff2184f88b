"""Drives of a kilometre over real elevation, anchored on a model of the same ground.

``python -m tests.long.benchmarks.bench_anchor`` prints what the anchor makes of height and place,
with models of 1, 5 and 20 cells a submap, whose error is stated or not; and what closures make of
the height at a revisit without any anchor. The elevation is that of the Jacksboro fault (USGS),
which comes with matplotlib; a cell of 80 m becomes one of a metre.
"""

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any

import numpy as np
import tyro
from matplotlib.cbook import get_sample_data
from scipy import ndimage

# ruff: noqa: T201
import gpgrad_core as gg
from gpgrad_core.detection import resolve_parameters
from gpgrad_core.detection.shortlist import read_candidates
from gpgrad_core.io.folder import outline_dataset, write_dataset
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.mapping.fitting import representative
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.routes import drive_lanes
from gpgrad_core.simulation.simulate import drift
from gpgrad_core.slam.anchoring import AnchorModel, AnchorParams, anchor_graph
from gpgrad_core.slam.graph import GraphParams, PoseGraph, build_pose_graph
from gpgrad_core.slam.optimise import (
    OptimisedGraph,
    measure_pose_covariances,
    optimise_pose_graph,
)
from gpgrad_core.types import Dataset, LoopClosure, Submap

SIDE, STEP = 240.0, 0.25  # of the ground, and of its grid [m]
SCALE = 1 / 83.0
RADIUS, SPACING, LENGTH = 5.0, 10.0, 1000.0  # of a submap, between submaps, of a drive [m]
POINTS, POINT_STD = 1500, 0.03
TILT_STD = 0.002  # of a submap's ground [rad]
ROUGHNESS = 0.04  # of what the model's cells cannot hold [m]
START_STD, START_YAW_STD = 0.5, 0.01
ODOMETRY = SimulationParams(spacing=SPACING)
GRAPH = GraphParams(
    odometry_std=0.01,
    odometry_drift=ODOMETRY.odometry_drift,
    height_drift=ODOMETRY.odometry_drift,
    heading_drift=ODOMETRY.heading_drift,
)
BEFORE = GraphParams(height_drift=0.004)
REVISIT = 3
"""Submaps that came so many apart are a revisit."""
IN_68 = 2.28  # chi-square of two dimensions


@dataclass(frozen=True)
class Bench:
    """What is measured."""

    drives: int = 10
    first: int = 0
    """Seed of the first drive."""
    cells: tuple[int, ...] = (1, 5, 20)
    """Cells of the model a submap."""
    error: float = 0.05
    """Standard deviation of the model's heights [m]."""
    folder: Path | None = None
    """Keeps the drives here; else they are made anew."""


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive, its closures, and its ground."""

    dataset: Dataset
    closures: tuple[LoopClosure, ...]
    heights: np.ndarray  # (rows, columns), row 0 in the south
    params: gg.PipelineParams
    folder: Path

    @property
    def true(self) -> dict[str, Pose]:
        return {s.id: s.pose_true for s in self.dataset.submaps if s.pose_true is not None}


def make_drive(seed: int, folder: Path) -> Drive:
    """Drive over a window of the model that each seed turns and places elsewhere."""
    rng = np.random.default_rng(seed)
    elevation = get_sample_data("jacksboro_fault_dem.npz")["elevation"].astype(float) * SCALE
    size = int(SIDE) + 2
    row, column = (int(rng.integers(0, n - size + 1)) for n in elevation.shape)
    window = np.rot90(elevation[row : row + size, column : column + size], int(rng.integers(4)))
    along = np.arange(0.0, SIDE, STEP) + 1.0
    heights = ndimage.map_coordinates(window, np.meshgrid(along, along, indexing="ij"), order=3)
    for wave in (0.5, 1.0):
        rough = ndimage.gaussian_filter(rng.standard_normal(heights.shape), wave / STEP)
        heights += ROUGHNESS * rough / rough.std()
    xy = drive_lanes(LENGTH, SPACING / 50, RADIUS, 1.0, rng)[: 50 * round(LENGTH / SPACING)]
    xy += 0.5 * SIDE - 0.5 * (xy.min(axis=0) + xy.max(axis=0))
    assert xy.min() > RADIUS
    assert xy.max() < SIDE - RADIUS
    ahead = np.gradient(xy, axis=0)
    truth = [
        Pose.from_planar(SE2(x, y, float(np.arctan2(dy, dx))), float(height))
        for (x, y), (dx, dy), height in zip(
            xy[::50].tolist(), ahead[::50], height_at(heights, xy[::50]), strict=True
        )
    ]
    believed = drift(truth, ODOMETRY, rng, SPACING)
    submaps = []
    for k, (pose, thought) in enumerate(zip(truth, believed, strict=True)):
        angle, distance = 2 * np.pi * rng.random(POINTS), RADIUS * np.sqrt(rng.random(POINTS))
        places = pose.translation[:2] + np.column_stack(
            [distance * np.cos(angle), distance * np.sin(angle)]
        )
        points = np.column_stack([places, height_at(heights, places)])
        points[:, 2] += POINT_STD * rng.standard_normal(POINTS)
        points[:, 2] += (places - pose.translation[:2]) @ (TILT_STD * rng.standard_normal(2))
        local = pose.inverse().apply(points).astype(np.float32).astype(float)
        submaps.append(Submap.from_points(local, f"{k:03d}", pose_true=pose, pose_odometry=thought))
    dataset = Dataset(f"drive-{seed}", tuple(submaps))
    if not folder.exists():
        write_dataset(dataset, folder)
    kept = folder.with_suffix(".pickle")
    if kept.exists():
        return Drive(dataset, *pickle.loads(kept.read_bytes()), folder)
    params = resolve_parameters(
        [submaps[k] for k in representative(len(submaps))], gg.PipelineParams()
    )
    found = gg.detect_loop_closures(dataset, params, candidates=read_candidates("8"))
    closures = tuple(one for one in found.closures if one.accepted)
    kept.write_bytes(pickle.dumps((closures, heights, params)))
    return Drive(dataset, closures, heights, params, folder)


def height_at(heights: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Interpolate the ground."""
    return ndimage.map_coordinates(heights, places[:, ::-1].T / STEP, order=1)


def make_model(drive: Drive, cells: int, error: float, seed: int) -> Elevations:
    """Average the ground over cells; half of the error's variance is in waves of a few cells."""
    rng = np.random.default_rng([seed, cells])
    cell = 2 * RADIUS / cells
    many = round(cell / STEP)
    count = len(drive.heights) // many
    heights = drive.heights[: count * many, : count * many]
    mean = heights.reshape(count, many, count, many).mean(axis=(1, 3))
    waves = ndimage.gaussian_filter(rng.standard_normal(mean.shape), 2.0, mode="wrap")
    noise = rng.standard_normal(mean.shape) + waves / waves.std()
    corner = 0.5 * (cell - STEP)
    return Elevations(mean + error / np.sqrt(2) * noise, (cell, cell), (corner, corner))


@dataclass(frozen=True)
class Measured:
    """How far a map is off."""

    height: float  # root mean square error of the heights [m]
    place: float  # of the places, after the best turn and shift in the plane [m]
    revisit: float  # of the height between two visits [m]
    inside: float  # share of the places in their ellipses of 68 %


def measure(drive: Drive, graph: PoseGraph, result: OptimisedGraph) -> Measured:
    """Compare with the truth; heights and ellipses as they are, without any alignment."""
    true, names = drive.true, list(drive.true)
    truth = np.array([true[name].translation for name in names])
    poses = np.array([result.poses[name].translation for name in names])
    error = poses - truth
    a, b = (xyz[:, :2] - xyz[:, :2].mean(axis=0) for xyz in (poses, truth))
    turn = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    left = SE2(yaw=float(turn)).apply(a) - b
    covariances = measure_pose_covariances(graph, result)[:, :2, :2]
    flat = error[1:, :2, None]
    chi = (flat.transpose(0, 2, 1) @ np.linalg.solve(covariances[1:], flat))[:, 0, 0]
    again = [
        (names.index(one.query_id), names.index(one.database_id))
        for one in drive.closures
        if names.index(one.query_id) - names.index(one.database_id) > REVISIT
    ]
    visits = [error[q, 2] - error[d, 2] for q, d in again]
    return Measured(
        float(np.sqrt(np.mean(error[:, 2] ** 2))),
        float(np.sqrt(np.mean(np.sum(left**2, axis=1)))),
        float(np.sqrt(np.mean(np.square(visits)))) if visits else float("nan"),
        float(np.mean(chi < IN_68)),
    )


def anchored(drive: Drive, model: AnchorModel, graph: PoseGraph) -> tuple[Measured, Any]:
    """Anchor a drive whose start is known as well as it is said to be."""
    found = anchor_graph(graph, outline_dataset(drive.folder), model, drive.params)
    return measure(drive, found.graph, found.result), found


def main() -> None:
    """Measure and print."""
    bench = tyro.cli(Bench)
    with TemporaryDirectory() as temporary:
        folder = bench.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        rows: dict[str, list[Measured]] = {}
        for seed in range(bench.first, bench.first + bench.drives):
            for label, measured, said in run(seed, folder, bench):
                rows.setdefault(label, []).append(measured)
                print(f"drive {seed}, {label}: {measured} {said}", flush=True)
    tell(rows)


def tell(rows: dict[str, list[Measured]]) -> None:
    """Print the table."""
    print("| | height error [m] | place error [m] | at a revisit [m] | in the 68 % ellipse |")
    print("|---|---|---|---|---|")
    for label, all_of in rows.items():
        height, place, revisit = (
            np.sqrt(np.nanmean([getattr(one, name) ** 2 for one in all_of]))
            for name in ("height", "place", "revisit")
        )
        inside = np.mean([one.inside for one in all_of])
        print(f"| {label} | {height:.3f} | {place:.2f} | {revisit:.3f} | {inside:.2f} |")


def run(seed: int, folder: Path, bench: Bench) -> Iterator[tuple[str, Measured, str]]:
    """Measure one drive in all ways."""
    begun = monotonic()
    drive = make_drive(seed, folder / f"drive_{seed}")
    made = monotonic() - begun
    graph = build_pose_graph(drive.dataset, drive.closures, GRAPH)
    bare = replace(graph, edges=tuple(edge for edge in graph.edges if edge.kind == "odometry"))
    yield "odometry alone", measure(drive, bare, optimise_pose_graph(bare)), ""
    before = build_pose_graph(drive.dataset, drive.closures, BEFORE)
    before = replace(before, edges=tuple(with_height(edge, 0.03) for edge in before.edges))
    result = optimise_pose_graph(before)
    yield (
        "closures as they were: 3 cm, height drift 0.004",
        measure(drive, before, result),
        f"{len(result.refused)} of {len(drive.closures)} closures refused",
    )
    for label, other in (
        ("closures, default uncertainty", build_pose_graph(drive.dataset, drive.closures)),
        ("closures, uncertainty of this odometry", graph),
    ):
        result = optimise_pose_graph(other)
        yield (
            label,
            measure(drive, other, result),
            f"{len(result.refused)} of {len(drive.closures)} closures refused, {made:.0f} s",
        )
    rng = np.random.default_rng([seed, 7])
    first = drive.true[next(iter(drive.true))].planar
    dx, dy = (START_STD * rng.standard_normal(2)).tolist()
    start = SE2(
        first.x + dx, first.y + dy, first.yaw + START_YAW_STD * float(rng.standard_normal())
    )
    for cells in bench.cells:
        elevations = make_model(drive, cells, bench.error, seed)
        for std in (bench.error, None):
            begun = monotonic()
            model = AnchorModel(
                "model", elevations, (0.0, 0.0), std, start, AnchorParams(START_STD, START_YAW_STD)
            )
            measured, found = anchored(drive, model, graph)
            label = f"anchored, {cells} cells, error {'stated' if std else 'estimated'}"
            said = (
                f"std {found.std:.3f}, places {found.count('place')}, surface "
                f"{found.count('surface')}, {monotonic() - begun:.1f} s"
            )
            yield label, measured, said


def with_height(edge: Any, std: float) -> Any:
    """Give a closure another standard deviation of its height [m]."""
    if edge.kind == "odometry":
        return edge
    covariance = edge.covariance.copy()
    covariance[2, 2] = std**2
    return replace(edge, covariance=covariance)


if __name__ == "__main__":
    main()
