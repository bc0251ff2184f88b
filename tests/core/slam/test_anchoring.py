"""A drive is anchored on an elevation model: its surface, its places, and what is wrong there."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import outline_dataset, write_dataset
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.anchoring import (
    Anchored,
    AnchorModel,
    AnchorParams,
    anchor_graph,
    look_up,
    surface_anchor,
    thin_ground,
)
from gpgrad_core.slam.coordinates import georeference_on
from gpgrad_core.slam.graph import Anchor, GraphParams, build_pose_graph
from gpgrad_core.slam.optimise import (
    measure_covariances,
    measure_pose_covariances,
    optimise_pose_graph,
)
from gpgrad_core.types import Dataset, Submap
from tests.support.frames import UTM, in_frame
from tests.support.ground import Ground

COUNT, STEP, WIDTH, STD = 20, 8.0, 6.0, 0.05
PARAMS = GraphParams(height_drift=0.075)
UNMOVED = np.zeros((2, 2))


def hills(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 3.0 * np.sin(x / 17.0) * np.cos(y / 23.0) + 0.1 * x


def model(cell: float = 2.0, std: float = STD, seed: int = 0) -> AnchorModel:
    """The hills as cells with errors, around the drive."""
    east, north = np.arange(-30.0, 190.0, cell), np.arange(-40.0, 60.0, cell)
    heights = hills(*np.meshgrid(east, north))
    heights += std * np.random.default_rng(seed).standard_normal(heights.shape)
    elevations = Elevations(heights, (cell, cell), (-30.0, -40.0))
    start = AnchorParams(start_std=0.1, start_yaw_std=0.005)
    return AnchorModel("dem.tif", elevations, (0.0, 0.0), STD, SE2(), start)


def drive() -> Dataset:
    """A drive to the east whose height drifts by metres; its frame lies elsewhere."""
    rng = np.random.default_rng(1)
    true = [
        Pose.from_planar(SE2(STEP * k, 0.0), float(hills(np.array(STEP * k), np.array(0.0))))
        for k in range(COUNT)
    ]
    believed = [Pose.from_planar(SE2(500.0, -20.0, 1.0), 70.0)]
    for before, after in pairwise(true):
        error = rng.normal(0, [0.05, 0.05, 0.6])
        slip = Pose.from_planar(SE2(error[0], error[1], float(rng.normal(0, 0.002))), error[2])
        believed.append(believed[-1] @ before.inverse() @ after @ slip)
    submaps = []
    for k, (pose, thought) in enumerate(zip(true, believed, strict=True)):
        xy = rng.uniform(-WIDTH / 2, WIDTH / 2, (300, 2)) + pose.translation[:2]
        points = np.column_stack([xy, hills(*xy.T)]) + 0.01 * rng.standard_normal((300, 3))
        own = pose.inverse().apply(points)
        submaps.append(Submap.from_points(own, f"{k:03d}", pose_true=pose, pose_odometry=thought))
    return Dataset("east", tuple(submaps))


DRIVE = drive()
GRAPH = build_pose_graph(DRIVE, (), PARAMS)
Anchoring = Callable[[AnchorModel], Anchored]


@pytest.fixture(scope="module")
def anchor(tmp_path_factory: pytest.TempPathFactory) -> Anchoring:
    folder = tmp_path_factory.mktemp("anchored") / "east"
    write_dataset(DRIVE, folder)
    outline = outline_dataset(folder)
    return lambda held: anchor_graph(GRAPH, outline, held, PipelineParams())


@pytest.fixture(scope="module")
def anchored(anchor: Anchoring) -> Anchored:
    return anchor(model())


def errors(anchored: Anchored) -> np.ndarray:
    found = [anchored.result.poses[submap.id].translation for submap in DRIVE.submaps]
    return found - np.array([submap.pose_true.translation for submap in DRIVE.submaps])


def test_the_height_no_longer_drifts_and_the_ellipses_hold(anchored: Anchored) -> None:
    off = errors(anchored)
    driven = np.array([s.pose_odometry.translation[2] for s in DRIVE.submaps]) - 70.0
    drifted = driven - [s.pose_true.translation[2] for s in DRIVE.submaps]
    assert np.sqrt(np.mean(off[:, 2] ** 2)) < 0.2 * np.sqrt(np.mean(drifted**2))
    covariances = measure_pose_covariances(anchored.graph, anchored.result)
    inside = [
        error @ np.linalg.solve(covariance[:3, :3], error) < 11.3  # 99 % of three dimensions
        for error, covariance in zip(off, covariances, strict=True)
    ]
    assert np.mean(inside) > 0.9
    assert anchored.count("surface") == (COUNT, 0)
    assert anchored.outside == ()


def test_it_does_not_matter_where_frames_lie(anchored: Anchored, tmp_path: Path) -> None:
    moved = in_frame(DRIVE, UTM)
    write_dataset(moved, tmp_path / "moved")
    graph = build_pose_graph(moved, (), PARAMS)
    held = replace(model(), start=UTM.inverse())
    outline = outline_dataset(tmp_path / "moved")
    far = anchor_graph(graph, outline, held, PipelineParams())
    assert far.count("surface") == anchored.count("surface")
    for submap in moved.submaps:
        shown = far.result.poses[submap.id].apply(submap.points)
        there = anchored.result.poses[submap.id].apply(DRIVE.submap(submap.id).points)
        np.testing.assert_allclose(shown, there, atol=0.001)


def test_the_error_of_the_model_is_estimated(anchor: Anchoring) -> None:
    low, high = (anchor(replace(model(cell=WIDTH, std=true), std=None)).std for true in (0.05, 1.2))
    assert 0.6 < high < 2.4
    assert low < 0.4 * high


def near_the_tenth(model: AnchorModel, within: float) -> np.ndarray:
    """Which columns of a model lie near the submap 010."""
    elevations = model.elevations
    east = elevations.corner[0] + 2.0 * np.arange(elevations.heights.shape[1])
    return np.abs(east - 10 * STEP) < within


def test_what_is_wrong_on_the_model_is_refused(anchor: Anchoring) -> None:
    dug = model()
    dug.elevations.heights[:, near_the_tenth(dug, 4.5)] -= 4.0
    found = anchor(dug)
    wrong = {fit.anchor.submap for fit in found.result.anchors if fit.weight < 0.5}
    assert "010" in wrong
    assert wrong <= {"009", "010", "011"}  # the surface rises steeply beside it
    assert np.abs(errors(found)[:, 2]).max() < 1.2


def test_over_voids_odometry_holds(anchor: Anchoring) -> None:
    holed = model()
    holed.elevations.heights[:, near_the_tenth(holed, 6.0)] = np.nan
    found = anchor(holed)
    assert found.outside == ("010",)
    assert np.abs(errors(found)[:, 2]).max() < 1.2


def test_where_nothing_is_found_one_line_says_what_to_do(anchor: Anchoring) -> None:
    with pytest.raises(InputError, match=r"dem\.tif: has no height under any of the 20 submaps"):
        anchor(replace(model(), start=SE2(5000.0, 0.0)))
    with pytest.raises(InputError, match="say where the drive starts: --anchor-start"):
        anchor(replace(model(cell=20.0), start=None))


@pytest.mark.slow
def test_submaps_are_found_near_where_they_are_thought_on_a_fine_model(tmp_path: Path) -> None:
    """The start is told 0.4 m off; what is found of the submaps' own shape puts that right."""
    ground, rng = Ground.random(3, shortest=2.0, longest=9.0, std=0.4), np.random.default_rng(1)
    submaps: list[Submap] = []
    for k in range(2):
        here = np.array([8.0 * k, 0.0])
        pose = Pose.from_planar(SE2(*here, 0.4 * k), float(ground.height(here[None])[0]))
        xy = rng.uniform(-4.0, 4.0, (1500, 2)) + here
        own = pose.inverse().apply(np.column_stack([xy, ground.height(xy)]))
        submaps.append(Submap.from_points(own, f"{k:03d}", pose_odometry=pose))
    rough = Dataset("rough", tuple(submaps))
    write_dataset(rough, tmp_path / "rough")
    cells = np.dstack(np.meshgrid(np.arange(-10.0, 20.0, 0.5), np.arange(-12.0, 12.0, 0.5)))
    heights = ground.height(cells.reshape(-1, 2)).reshape(cells.shape[:2])
    elevations = Elevations(heights, (0.5, 0.5), (-10.0, -12.0))
    start = AnchorParams(start_std=0.4, start_yaw_std=0.05)
    held = AnchorModel("rough.tif", elevations, (0.0, 0.0), 0.02, SE2(0.3, -0.3), start)
    fitted = PipelineParams(map=MapParams(length_scale=1.0, signal_std=0.4, noise_std=0.03))
    graph = build_pose_graph(rough, (), PARAMS)
    found = anchor_graph(graph, outline_dataset(tmp_path / "rough"), held, fitted)
    places = [fit for fit in found.result.anchors if fit.anchor.kind == "place"]
    assert [(fit.anchor.submap, fit.weight) for fit in places] == [("000", 1.0), ("001", 1.0)]
    for submap in submaps:
        true, put = submap.pose_odometry, found.result.poses[submap.id]
        np.testing.assert_allclose(put.translation, true.translation, atol=0.05)


def test_a_map_on_a_model_has_coordinates_if_they_are_asked_for() -> None:
    held = replace(model(), origin=(500_000.0, 4_000_000.0))
    assert georeference_on(held, None, None, None) is None
    given = georeference_on(held, Path("dem.tif"), None, "EPSG:32633")
    assert given is not None
    np.testing.assert_allclose(given.apply(np.ones((1, 3))), [[500_001.0, 4_000_001.0, 1.0]])
    with pytest.raises(InputError, match="names no coordinate system; name it: --crs"):
        georeference_on(held, Path("dem.tif"), "37,15,0", None)


def test_the_surface_gives_height_and_tilt() -> None:
    """A submap that is too low and tilted is put right by its anchor."""
    rng = np.random.default_rng(3)
    true = Pose.from_planar(SE2(40.0, 5.0, 0.7), float(hills(np.array(40.0), np.array(5.0))))
    xy = rng.uniform(-6, 6, (3000, 2)) + true.translation[:2]
    submap = Submap.from_points(true.inverse().apply(np.column_stack([xy, hills(*xy.T)])))
    exact = model(cell=1.0, std=0.0)
    low = true @ Pose(np.array([0.0, 0.0, -0.5]), np.array([0.01, 0.0, 0.0, np.sqrt(1 - 1e-4)]))
    found = look_up(exact, thin_ground(submap, exact.cell), low, UNMOVED)
    put = surface_anchor("000", found, low, 0.05, 1.0).T_world_submap
    assert put.translation[2] == pytest.approx(true.translation[2], abs=0.02)
    np.testing.assert_allclose(put.rotation[:, 2], [0.0, 0.0, 1.0], atol=0.003)


def test_on_a_slope_the_height_tells_of_the_place() -> None:
    """by_pose is the derivative of the offset, as a difference says it."""
    rng = np.random.default_rng(4)
    xy = rng.uniform(-6, 6, (3000, 2))
    submap = Submap.from_points(np.column_stack([xy[:, 0] + 4.0, xy[:, 1], 0.2 * xy[:, 0]]))
    exact = model(cell=1.0, std=0.0)
    ground, pose = thin_ground(submap, exact.cell), Pose.from_planar(SE2(30.0, 4.0, 0.4), 1.0)
    found = look_up(exact, ground, pose, UNMOVED)
    for step, slope in zip(0.3 * np.eye(3), found.by_pose[:3], strict=True):
        moved = look_up(exact, ground, Pose(pose.translation + step, pose.quaternion), UNMOVED)
        assert found.offset - moved.offset == pytest.approx(0.3 * slope, abs=0.02)


def test_anchors_hold_a_graph_in_place_of_its_first_pose() -> None:
    wanted = Pose.from_planar(SE2(1.0, 2.0, 0.3), 5.0)
    held = replace(_at("005", wanted, 0.01), trusted=True)
    graph = replace(GRAPH, anchors=(held,))
    result = optimise_pose_graph(graph)
    np.testing.assert_allclose(result.poses["005"].translation, wanted.translation, atol=1e-3)
    (fit,) = result.anchors
    assert fit.weight == 1.0
    covariances = measure_pose_covariances(graph, result)
    assert np.sqrt(covariances[5, 0, 0]) == pytest.approx(0.01, rel=0.1)
    assert covariances[0, 0, 0] > covariances[5, 0, 0]


def test_one_wrong_anchor_of_many_is_refused() -> None:
    right = [_at(name, pose, 0.05) for name, pose in list(GRAPH.poses.items())[::4]]
    wrong = _at("010", Pose.from_planar(SE2(9.0, 9.0)) @ GRAPH.poses["010"], 0.05)
    result = optimise_pose_graph(replace(GRAPH, anchors=(*right, wrong)))
    assert [fit.anchor for fit in result.anchors if fit.weight < 0.5] == [wrong]


def test_the_plane_is_a_part_of_the_covariance() -> None:
    result = optimise_pose_graph(GRAPH)
    whole, plane = measure_pose_covariances(GRAPH, result), measure_covariances(GRAPH, result)
    np.testing.assert_array_equal(whole[:, [0, 1, 5]][:, :, [0, 1, 5]], plane)
    assert np.all(np.linalg.eigvalsh(whole) > 0)
    assert whole[-1, 2, 2] > whole[1, 2, 2]  # the height drifts


def _at(name: str, pose: Pose, std: float) -> Anchor:
    return Anchor(name, "place", pose, np.eye(6) / std**2)
