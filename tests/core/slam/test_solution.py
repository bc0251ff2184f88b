"""What `gpgrad slam` leaves is read by others: evo, Open3D, rasterio, NumPy."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d
import pytest
import rasterio
from evo.tools import file_interface

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import outline_dataset, write_dataset
from gpgrad_core.mapping.gradient_map import TerrainParams
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam import (
    MergeParams,
    Solution,
    join_datasets,
    measure_errors,
    read_graph,
    solve_datasets,
    write_graph,
    write_merged,
    write_solution,
)
from gpgrad_core.slam.solution import used_graph
from gpgrad_core.types import Dataset, LoopClosure, Submap
from tests.core.slam.simulated import closure, with_odometry
from tests.support.ground import Ground

GROUND = Ground.random(11, shortest=1.0, std=0.2)
PLACES = [  # all within one tile of the merged map
    SE2(3.0, 3.0, 0.0),
    SE2(4.5, 3.0, 0.3),
    SE2(6.0, 3.2, 2.0),
    SE2(4.6, 3.3, 3.0),
    SE2(3.1, 3.1, 3.1),
]
TERRAIN = TerrainParams(length_scale=0.2, noise_std=0.02)


def traverse() -> Dataset:
    """A walk whose odometry turns and slips a little at each step."""
    rng = np.random.default_rng(0)
    slip = Pose.from_planar(SE2(0.15, 0.05, 0.04), 0.03)
    submaps: list[Submap] = []
    for k, place in enumerate(PLACES):
        true = Pose.from_planar(place, float(GROUND.height(place.translation[None])[0]))
        odometry = true
        if submaps:
            last = submaps[-1]
            odometry = last.pose_odometry @ last.pose_true.inverse() @ true @ slip
        xy = rng.uniform(-1.2, 1.2, (1200, 2)) + true.translation[:2]
        z = GROUND.height(xy) + 0.01 * rng.standard_normal(len(xy))
        points = true.inverse().apply(np.column_stack([xy, z]))
        submap = Submap.from_points(points, f"{2 * k:03d}", pose_true=true, pose_odometry=odometry)
        submaps.append(submap)
    return Dataset("walk", tuple(submaps))


WALK = traverse()


def found(query: str, database: str) -> LoopClosure:
    """The true motion between two submaps that lie on one another."""
    between = WALK.submap(database).pose_true.inverse() @ WALK.submap(query).pose_true
    return closure(query, database, between.planar, float(between.translation[2]))


FOUND = [found("006", "002"), found("008", "000"), found("006", "000"), found("008", "002")]


@pytest.fixture(scope="module")
def solution(tmp_path_factory: pytest.TempPathFactory) -> Solution:
    folder = tmp_path_factory.mktemp("data") / "walk"
    write_dataset(WALK, folder)
    return solve_datasets(join_datasets([outline_dataset(folder)]), FOUND)


@pytest.fixture(scope="module")
def written(solution: Solution, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "map"
    write_solution(folder, solution, measure_errors(solution))
    params = MergeParams(resolution=0.1, voxel=0.1)
    assert not write_merged(folder, solution, TERRAIN, params)
    return folder


@pytest.mark.parametrize("factor", [1e3, 1e4, 1e5, 1e7])
def test_odometry_in_another_unit_is_solved_or_told(factor: float, tmp_path: Path) -> None:
    """GTSAM finds some of these graphs indeterminate, as rounding has it."""
    far = tuple(
        replace(submap, pose_odometry=Pose(factor * pose.translation, pose.quaternion))
        for submap in WALK.submaps
        if (pose := submap.pose_odometry)
    )
    write_dataset(replace(WALK, submaps=far), tmp_path / "walk")
    try:
        solve_datasets(join_datasets([outline_dataset(tmp_path / "walk")]), FOUND)
    except InputError as error:
        assert "are odometry's poses in metres?" in str(error)  # noqa: PT017


def test_nothing_else_is_left(written: Path) -> None:
    assert {path.name for path in written.iterdir()} == {
        *("poses_corrected.txt", "covariances_corrected.txt", "graph.g2o", "report.json"),
        *("trajectory.png", "errors.png", "cloud.ply", "map.npz", "map.tif"),
    }


def test_the_map_is_better_than_odometry(solution: Solution) -> None:
    errors = measure_errors(solution)
    before, after = errors.trajectories["walk"]
    assert after.absolute < 0.5 * before.absolute
    first, last = errors.overlaps
    assert last.median < 0.6 * first.median


def test_evo_reads_the_poses(written: Path, solution: Solution) -> None:
    read = file_interface.read_tum_trajectory_file(str(written / "poses_corrected.txt"))
    np.testing.assert_array_equal(read.timestamps, [0, 2, 4, 6, 8])  # the submaps' numbers
    poses = list(solution.result.poses.values())
    np.testing.assert_allclose(read.positions_xyz, [p.translation for p in poses], atol=1e-6)
    np.testing.assert_allclose(
        read.orientations_quat_wxyz[:, [1, 2, 3, 0]], [p.quaternion for p in poses], atol=1e-8
    )


def test_open3d_reads_the_cloud(written: Path) -> None:
    points = np.asarray(open3d.io.read_point_cloud(str(written / "cloud.ply")).points)
    assert len(points) > 500
    assert len(np.unique(np.floor(points / 0.1), axis=0)) == len(points)
    assert np.median(np.abs(points[:, 2] - GROUND.height(points[:, :2]))) < 0.05


def test_rasterio_reads_the_map_where_it_lies(written: Path) -> None:
    with np.load(written / "map.npz") as arrays, rasterio.open(written / "map.tif") as raster:
        elevation, origin = arrays["elevation"], arrays["origin"]
        assert set(arrays) == {
            *("elevation", "variance", "slope_x", "slope_y", "gradient", "origin", "resolution")
        }
        np.testing.assert_allclose(
            arrays["gradient"], np.hypot(arrays["slope_x"], arrays["slope_y"]), rtol=1e-6
        )
        assert raster.descriptions == ("elevation", "variance", "slope_x", "slope_y", "gradient")
        assert raster.units == ("m", "m2", "m/m", "m/m", "m/m")
        assert np.isnan(raster.nodata)
        assert raster.res == pytest.approx((0.1, 0.1))
        band = raster.read(1)
        np.testing.assert_array_equal(band[::-1], elevation.astype(np.float32))
        row, column = np.argwhere(np.isfinite(band))[100]
        x, y = raster.xy(row, column)
        cell = np.round((np.array([x, y]) - origin) / 0.1).astype(int)
        assert elevation[cell[1], cell[0]] == band[row, column]
        assert abs(GROUND.height(np.array([[x, y]]))[0] - band[row, column]) < 0.15


def test_the_report_tells_of_every_edge(written: Path, solution: Solution) -> None:
    report = json.loads((written / "report.json").read_text())
    assert report["dataset"] == "walk"
    assert len(report["edges"]) == len(solution.result.edges) == 4 + 4
    for edge in report["edges"]:
        assert edge["weight"] in (0.0, 1.0)
        assert edge["chi_square"] >= 0
    error = report["trajectory_error"]["walk"]
    assert error["after"]["absolute"] < error["before"]["absolute"]
    assert report["sessions"]["walk"]["poses"] == "poses_corrected.txt"


def test_a_wrong_closure_is_left_out_of_the_graph(solution: Solution, tmp_path: Path) -> None:
    wrong = closure("006", "002", SE2(3.0, -3.0, 1.0), 0.5)
    mixed = solve_datasets(solution.joined, [wrong, *FOUND[1:]])
    assert [fit.edge.pair for fit in mixed.result.refused] == [wrong.pair]
    assert used_graph(mixed).centres == mixed.placed.graph.centres
    write_graph(tmp_path / "graph.g2o", used_graph(mixed), mixed.result.poses)
    assert len(read_graph(tmp_path / "graph.g2o").loops) == 3


def test_two_sessions_have_a_file_each(tmp_path: Path) -> None:
    frame = Pose.from_planar(SE2(40.0, 7.0, 1.0), 3.0)
    first, second = Dataset("a", WALK.submaps[:3]), Dataset("b", WALK.submaps[3:])
    second = with_odometry(second, lambda pose: frame @ pose)
    for part in (first, second):
        write_dataset(part, tmp_path / part.name)
    closures = [
        replace(c, query_id=f"b:{c.query_id}", database_id=f"a:{c.database_id}") for c in FOUND
    ]
    joined = join_datasets([outline_dataset(tmp_path / name) for name in "ab"])
    both = solve_datasets(joined, closures)
    write_solution(tmp_path / "out", both, measure_errors(both))
    for name, numbers in (("a", ["0", "2", "4"]), ("b", ["6", "8"])):
        lines = (tmp_path / "out" / f"poses_corrected_{name}.txt").read_text().splitlines()
        assert [line.split()[0] for line in lines[1:]] == numbers
    for name, pose in both.result.poses.items():
        true = WALK.submap(name.split(":")[1]).pose_true
        assert np.linalg.norm(pose.translation - true.translation) < 0.4
