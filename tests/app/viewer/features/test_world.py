"""The world: poses, figures and surfaces of all submaps, and how they are drawn."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st

from app.viewer.features.world import merged as merged_module
from app.viewer.features.world.merged import drape, lines_of, merge, pieces, world_scale
from app.viewer.features.world.model import Correction, World
from app.viewer.features.world.scene import (
    LETTER,
    LINE,
    LOOP_PIECES,
    MOST_ARCHES,
    SIDES,
    FirstGround,
    WorldScene,
    arch_colors,
    arches,
    choose_arches,
    drawable,
    sides_of,
)
from app.viewer.features.world.submaps import (
    MADE_CELLS,
    Terrain,
    WorldColor,
    WorldOptions,
    counts_as_it_grows,
    figures_of,
    pose_sources,
    poses_of,
    quick_surface,
    submap_color,
)
from gpgrad_core.detection.choosing import likely
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, GradientMap, Grid, LoopClosure, Registration, Submap
from tests.support.synthetic import NUMBERS, make_dataset, make_map
from tests.support.widgets import node

DATASET = make_dataset()


def posed(x: float, yaw: float = 0.0) -> Pose:
    return Pose(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]))


def without_poses() -> Dataset:
    return replace(
        DATASET, submaps=tuple(replace(submap, pose_odometry=None) for submap in DATASET.submaps)
    )


def test_poses_come_from_what_there_is() -> None:
    corrected = {"000": posed(0.0)}
    assert pose_sources(DATASET) == ("odometry",)
    assert pose_sources(DATASET, corrected) == ("odometry", "corrected")
    assert list(poses_of(DATASET, "odometry")) == ["000", "001", "002", "003"]
    assert poses_of(DATASET, "corrected", corrected) == corrected
    assert poses_of(DATASET, "true") == {}


def test_submaps_without_poses_lie_beside_each_other() -> None:
    dataset = without_poses()
    assert pose_sources(dataset) == ("in rows",)
    poses = poses_of(dataset, "in rows")
    boxes = [
        (low, high)
        for submap in dataset.submaps
        for points in (poses[submap.id].apply(submap.points)[:, :2],)
        for low, high in ((points.min(axis=0), points.max(axis=0)),)
    ]
    for k, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:k]:
            assert (low >= other_high).any() or (high <= other_low).any()


def test_figures_are_those_of_a_known_cloud() -> None:
    x, y = np.meshgrid(np.arange(0.0, 4.0, 0.1), np.arange(0.0, 2.0, 0.1))
    points = np.column_stack([x.ravel() + 0.05, y.ravel() + 0.05, np.zeros(x.size)])
    points[: len(points) // 2, 2] = 0.5
    cloud = Submap.from_points(points, pose_true=posed(1.0), pose_odometry=posed(1.3, 0.1))
    assert dict(figures_of(cloud)) == {
        "points": "800",
        "extent": "3.9 m x 1.9 m, 0.50 m high",
        "ground seen": "8.0 m²",
        "density": "100 points/m²",
        "height std": "0.250 m",
        "true pose": "1.00, 0.00, 0.00 m; +0.0°",
        "odometry": "1.30, 0.00, 0.00 m; +5.7°",
        "odometry off by": "0.27 m",  # at its centre, about which odometry has turned it too
    }
    only = dict(figures_of(cloud, positions_only=True))
    assert only["odometry off by"] == "0.30 m"
    bare = dict(figures_of(replace(cloud, pose_true=None), posed(1.0)))
    assert [name for name in bare if "off by" in name or "pose" in name] == []
    assert bare["corrected"] == "1.00, 0.00, 0.00 m; +0.0°"


POSES = poses_of(DATASET, "odometry")
SIGHTS = {submap.id: Terrain(make_map(submap), 0.9) for submap in DATASET.submaps}


def closure(query: str, database: str, score: float, *, accepted: bool) -> LoopClosure:
    """Make a closure of which the scene draws the two ends and the score."""
    found = Registration(None, np.ones(0, np.bool_), np.inf, 0.0, 0.0, score)
    return LoopClosure(query, database, found, accepted, "")


LOOPS = (closure("003", "000", 5.0, accepted=True), closure("002", "000", 1.0, accepted=False))


def raised(position: Any, *, y: float = 0.0, z: float = 0.0) -> Any:
    return position + np.array([0.0, y, z])


def world(color: WorldColor = "elevation", selected: str | None = None, **options: Any) -> World:
    chosen = WorldOptions(color=color, **options)
    correction = Correction(loops=LOOPS, highest_score=6.0)
    return World(DATASET, chosen, correction, selected, surfaces=SIGHTS)


def test_all_submaps_lie_at_their_poses(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    assert scene.show(world("submap")) is None
    ground = scene.terrain
    scene.show(world("submap", selected="002"))
    assert scene.terrain is ground  # at the same poses, nothing is merged again
    offsets = [
        np.array(node(server, f"/world/submaps/{k}").position) - POSES[submap.id].translation
        for k, submap in enumerate(DATASET.submaps)
    ]
    np.testing.assert_allclose(offsets, np.tile(offsets[0], (4, 1)), atol=1e-9)  # one shift for all
    assert node(server, "/world/submaps/3/name").text == "003"
    assert scene.terrain is not None
    assert len(scene.terrain.positions) == sum(
        len(node(server, f"/world/submaps/{k}/surface").points) for k in range(4)
    )


def test_moving_sends_poses_and_no_points(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    scene.show(world())
    points = node(server, "/world/submaps/1/surface").points
    way_before = node(server, "/world/trajectories/odometry").points.copy()
    move = scene.mover()
    moved = {
        name: Pose(raised(pose.translation, y=3.0), pose.quaternion) for name, pose in POSES.items()
    }
    halfway = {
        name: Pose(raised(pose.translation, y=1.5), pose.quaternion) for name, pose in POSES.items()
    }
    before = np.array(node(server, "/world/submaps/1").position)
    move(halfway)
    np.testing.assert_allclose(
        np.array(node(server, "/world/submaps/1").position) - before, [0.0, 1.5, 0.0], atol=1e-9
    )
    assert node(server, "/world/submaps/1/surface").points is points
    moved_by = node(server, "/world/trajectories/odometry").points - way_before
    np.testing.assert_allclose(
        moved_by, np.broadcast_to([0.0, 1.5, 0.0], moved_by.shape), atol=1e-5
    )
    scene.show(world(names=False))
    move(moved)  # too late: something else is shown
    np.testing.assert_allclose(np.array(node(server, "/world/submaps/1").position), before)


def test_a_new_submap_lies_on_the_ground_until_that_is_merged(server: viser.ViserServer) -> None:
    scene, whole = WorldScene(server, visible=True), world()
    *submaps, last = DATASET.submaps
    fewer = replace(whole, whole=replace(DATASET, submaps=tuple(submaps)))
    scene.show(fewer)
    before = scene.terrain
    assert before is not None
    assert last.id not in before.names
    scene.show(whole, merges=False)
    assert scene.terrain is before
    assert len(node(server, "/world/submaps/3/surface").points) > 0
    terrain = merge(whole.surfaces, whole.poses)
    assert scene.take(whole, terrain)
    scene.show(whole)  # that is merged of the same already
    assert scene.terrain is terrain
    drawn = [len(node(server, f"/world/submaps/{k}/surface").points) for k in range(4)]
    assert sum(drawn) == len(terrain.positions)
    scene.show(fewer)  # who looks back is not shown what came later
    assert not scene.take(whole, terrain)


def test_what_is_switched_off_is_not_seen(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    scene.show(world(names=False))
    assert node(server, "/world/submaps/0/name") is None
    assert len(node(server, "/world/loops/2").points) == LOOP_PIECES  # it has a high score
    assert node(server, "/world/refused") is None
    scene.show(world(loops=False, refused=True))
    assert node(server, "/world/submaps/0/name").visible
    assert not node(server, "/world/loops/2").visible
    assert len(node(server, "/world/refused").points) == LOOP_PIECES
    scene.show(world(names=False))
    assert not node(server, "/world/submaps/0/name").visible
    assert not node(server, "/world/refused").visible


def test_of_many_loops_the_best_are_drawn_and_all_of_the_chosen_submap() -> None:
    loops = tuple(
        closure(f"{query:03d}", f"{database:03d}", float(query + database), accepted=True)
        for query in range(100)
        for database in range(query)
    )
    options = WorldOptions()
    best = choose_arches(loops, options, None)
    assert len(best) == MOST_ARCHES
    assert (
        min(loop.registration.score for loop in best)
        >= sorted(loop.registration.score for loop in loops)[-MOST_ARCHES]
    )
    chosen = choose_arches(loops, options, "007")
    assert set(best) < set(chosen)
    assert {loop for loop in loops if "007" in loop.pair} < set(chosen)
    assert len(chosen) == MOST_ARCHES + 99
    assert choose_arches(loops, WorldOptions(loops=False), "007") == ()
    far, near, accepted = (
        closure("2", "0", 0.9, accepted=False),
        closure("3", "0", 1.1, accepted=False),
        closure("1", "0", 2.0, accepted=True),
    )
    few = far, near, accepted
    assert choose_arches(few, WorldOptions(refused=True), None) == few[::-1]
    assert choose_arches(few, options, None) == (near, accepted)  # it was nearly accepted


def test_the_likeliest_pairs_are_accepted_and_then_of_a_high_score() -> None:
    refused, low, high, first = (
        closure("3", name, score, accepted=name != "0")
        for name, score in (("0", 9.0), ("1", 3.0), ("2", 4.0), ("1", 4.0))
    )
    assert likely((refused, low, high, first)) == [high, first, low, refused]
    assert likely(()) == []


def test_names_of_near_places_stand_beside_each_other(server: viser.ViserServer) -> None:
    width = 100.0
    places = {
        "000": np.array([0.0, 0.0]),
        "001": np.array([50.0, 0.0]),
        "006": np.array([50.0, 0.0]),  # back at the place of 001
        **{f"{k:03d}": np.array([0.0, 0.0]) for k in range(7, 20)},
    }
    sides = sides_of(places, width)
    assert sides["000"] == sides["001"] == "bottom-center"
    assert {"006", "007"} < set(sides) < set(places)  # there is no room for all
    size = width * np.array([4 * LETTER, LINE])
    middles = [places[name] + np.array(SIDES[side]) * size for name, side in sides.items()]
    for k, middle in enumerate(middles):
        for other in middles[:k]:
            assert np.any(np.abs(middle - other) > 0.94 * size), (places, sides)
    scene = WorldScene(server, visible=True)
    scene.show(world())
    labels = [node(server, f"/world/submaps/{k}/name") for k in range(4)]
    assert {label.anchor for label in labels} > {"bottom-center"}  # 003 is where 000 was


def test_a_smaller_dataset_leaves_nothing_of_the_larger(server: viser.ViserServer) -> None:
    def frames() -> list[int]:
        return [k for k in range(4) if node(server, f"/world/submaps/{k}") is not None]

    scene = WorldScene(server, visible=True)
    scene.show(world())
    assert frames() == [0, 1, 2, 3]
    smaller = Dataset("smaller", make_dataset(name="smaller").submaps[:2])
    scene.show(World(smaller, surfaces=SIGHTS))
    assert frames() == [0, 1]
    scene.show(world())
    assert frames() == [0, 1, 2, 3]


OFF = 0.1 / 32
"""OpenCV rounds where it interpolates to a 32nd of a cell [m of 0.1 m, on slopes of 0.5]."""


def plane(slope: tuple[float, float], offset: float, yaw: float) -> tuple[Terrain, Pose]:
    """Map a plane of the world from a submap that stands turned somewhere on it."""
    pose = posed(offset, yaw)
    grid = Grid((-2.0, -2.0), 0.1, (41, 41))
    x, y, _ = pose.apply(np.column_stack([grid.positions, np.zeros(grid.num_cells)])).T
    height = (slope[0] * x + slope[1] * y).reshape(grid.shape)
    c, s = np.cos(yaw), np.sin(yaw)
    own = np.array([c * slope[0] + s * slope[1], c * slope[1] - s * slope[0]])
    made = GradientMap(
        grid, height, np.full(grid.shape, 1e-4), np.tile(own, (*grid.shape, 1)), 1.0, 0.3
    )
    return Terrain(made, 0.9), pose


@settings(max_examples=30)
@given(
    slope=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    offset=st.floats(0.0, 2.0),
    yaw=st.floats(-3.0, 3.0),
)
def test_merged_planes_are_one_plane(slope: tuple[float, float], offset: float, yaw: float) -> None:
    made = {"a": plane(slope, 0.0, 0.0), "b": plane(slope, offset, yaw)}
    poses = {name: pose for name, (_, pose) in made.items()}
    terrain = merge({name: surface for name, (surface, _) in made.items()}, poses)
    x, y, z = terrain.positions.T
    np.testing.assert_allclose(z, slope[0] * x + slope[1] * y, atol=OFF)
    np.testing.assert_allclose(terrain.slope, np.tile(slope, (len(z), 1)), atol=1e-4)
    assert len(np.unique(np.round(terrain.positions[:, :2] / terrain.resolution), axis=0)) == len(z)
    both = np.diff(terrain.first) == 2
    assert both.any()
    np.testing.assert_allclose(terrain.std[both], 0.01 / np.sqrt(2), rtol=1e-3)
    np.testing.assert_allclose(terrain.std[~both], 0.01, rtol=1e-3)
    assert terrain.disagreement < OFF
    parts = pieces(terrain, "elevation", world_scale(terrain, "elevation"))
    assert sum(len(part.positions) for part in parts.values()) == len(z)
    back = np.concatenate(
        [poses[name].apply(part.positions.astype(np.float64)) for name, part in parts.items()]
    )
    np.testing.assert_allclose(back[:, 2], slope[0] * back[:, 0] + slope[1] * back[:, 1], atol=OFF)


def test_heights_that_differ_are_averaged_without_a_step() -> None:
    (low, pose), (high, _) = plane((0.0, 0.0), 0.0, 0.0), plane((0.0, 0.0), 0.0, 0.0)
    apart = Pose(np.array([2.0, 0.0, 0.2]), pose.quaternion)
    terrain = merge({"a": low, "b": high}, {"a": pose, "b": apart})
    x, y, z = terrain.positions.T
    along = z[np.abs(y) < 0.01][np.argsort(x[np.abs(y) < 0.01])]
    assert (along[0], along[-1]) == pytest.approx((0.0, 0.2), abs=1e-6)
    assert np.abs(np.diff(along)).max() < 0.04  # of 0.2 m that the two differ by
    assert terrain.disagreement == pytest.approx(0.2)


def test_nothing_that_is_seen_gives_no_terrain() -> None:
    terrain = merge({}, {})
    assert (len(terrain.positions), terrain.area) == (0, 0.0)
    assert world_scale(terrain, "elevation") is None
    assert terrain.hit(np.zeros(3), np.array([0.0, 0.0, -1.0])) is None


def test_a_submap_that_saw_no_whole_cell_takes_no_part() -> None:
    (ground, pose), (other, _) = plane((0.2, 0.1), 0.0, 0.0), plane((0.2, 0.1), 0.0, 0.0)
    variance = np.full(other.gradient_map.grid.shape, 1.0)
    variance[20, 20] = 1e-4  # trusted, and none of its neighbours
    lone = Terrain(replace(other.gradient_map, variance=variance), 0.9)
    between = Pose(np.array([0.05, 0.05, 0.0]), pose.quaternion)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        terrain = merge({"a": ground, "b": lone}, {"a": pose, "b": between})
    np.testing.assert_array_equal(terrain.positions, merge({"a": ground}, {"a": pose}).positions)
    assert set(terrain.seen_by) == {0}


def test_many_cells_make_a_coarser_lattice(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = merge(SIGHTS, POSES)
    monkeypatch.setattr(merged_module, "MAX_CELLS", len(fine.positions) // 3)
    coarse = merge(SIGHTS, POSES)
    assert len(coarse.positions) <= len(fine.positions) // 3
    assert coarse.area == pytest.approx(fine.area, rel=0.1)


def test_colours_share_one_scale() -> None:
    terrain = merge(SIGHTS, POSES)
    assert world_scale(terrain, "submap") is None
    scale = world_scale(terrain, "gradient")
    assert scale is not None
    assert (scale.low, scale.unit) == (0.0, "m/m")
    lifted = {
        name: Pose(raised(pose.translation, z=10.0), pose.quaternion)
        for name, pose in POSES.items()
    }
    low, high = (world_scale(merge(SIGHTS, poses), "elevation") for poses in (POSES, lifted))
    assert low is not None
    assert high is not None
    assert high.low - low.low == pytest.approx(10.0, abs=1e-5)


def test_neighbours_have_colours_apart() -> None:
    colors = np.array([submap_color(k) for k in range(40)], dtype=float)
    assert np.linalg.norm(np.diff(colors, axis=0), axis=1).min() > 60
    assert np.linalg.norm(colors[2:] - colors[:-2], axis=1).min() > 30


def test_a_quick_sight_is_as_coarse_as_many_submaps_ask_for() -> None:
    memo, submap = Memo(), DATASET.submaps[0]
    fine = replace(NUMBERS.map, resolution=0.03)
    few, many = (quick_surface(submap, fine, count, memo=memo) for count in (4, 400))
    assert few.gradient_map.grid.resolution == 0.03
    shown = many.gradient_map.trusted(many.max_std_ratio).sum()
    assert shown <= 1.5 * MADE_CELLS / 400
    seen = few.gradient_map.trusted(few.max_std_ratio)
    true = make_map(submap, few.gradient_map.grid.resolution).elevation - submap.centre[2]
    assert np.abs(few.gradient_map.elevation - true)[seen].mean() < 0.03


def test_grids_of_a_drive_become_coarser_some_at_a_time() -> None:
    assert counts_as_it_grows(3) == [32] * 3
    assert counts_as_it_grows(33) == [64] * 8 + [32] * 24 + [64]
    assert counts_as_it_grows(64) == [64] * 64
    for before in range(1, 200):
        old, new = counts_as_it_grows(before), counts_as_it_grows(before + 1)
        assert sum(a != b for a, b in zip(old, new, strict=False)) <= 8


def test_a_ray_finds_the_nearer_ground() -> None:
    (low, pose), (high, _) = plane((0.0, 0.0), 0.0, 0.4), plane((0.0, 0.0), 0.0, 0.4)
    terrain = merge(
        {"a": low, "b": high}, {"a": pose, "b": Pose(np.array([5.0, 0, 1.0]), pose.quaternion)}
    )
    down = np.array([0.0, 0.0, -2.0])

    def owner(x: float, y: float, direction: Any) -> str | None:
        cell = terrain.hit(np.array([x, y, 5.0]), direction)
        return None if cell is None else terrain.names[terrain.owner[cell]]

    assert owner(5.3, 0.1, down) == "b"
    assert owner(-0.5, 0.1, down) == "a"
    assert owner(0.0, 0.1, np.array([5.0, 0.0, -4.0])) == "b"
    assert owner(-9.0, 0.1, down) is None
    assert owner(0.0, 0.0, -down) is None


def test_lines_start_and_end_at_submaps() -> None:
    missing = closure("003", "nowhere", 1.0, accepted=True)
    assert drawable((*LOOPS, missing), POSES) == LOOPS
    feet = {name: pose.translation for name, pose in POSES.items()}
    lines = arches(LOOPS[:1], feet)
    np.testing.assert_allclose(lines[0, 0], feet["000"], atol=1e-6)
    np.testing.assert_allclose(lines[-1, 1], feet["003"], atol=1e-6)
    assert arches((), feet).shape == (0, 2, 3)


def test_tracks_lie_above_the_ground_at_each_vertex(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    drifted = replace(
        DATASET,
        submaps=tuple(
            replace(
                submap, pose_true=Pose(raised(pose.translation, y=0.3, z=-2.0), pose.quaternion)
            )
            for submap in DATASET.submaps
            for pose in (POSES[submap.id],)
        ),
    )
    scene.show(World(drifted, surfaces=SIGHTS))
    terrain = scene.terrain
    assert terrain is not None
    shift = np.array(node(server, "/world/submaps/0").position) - POSES["000"].translation
    for source in ("odometry", "true"):
        for name in (f"trajectories/{source}", f"edges/{source}"):
            vertices = node(server, f"/world/{name}").points.reshape(-1, 3) - shift
            ground = terrain.heights_near(vertices[:, :2])
            assert np.isfinite(ground).any()
            assert (vertices[:, 2] > ground)[np.isfinite(ground)].all()
    whole, dashed = (
        node(server, f"/world/trajectories/{source}").points for source in ("true", "odometry")
    )
    assert np.allclose(whole[1:, 0], whole[:-1, 1])
    assert not np.allclose(dashed[1:, 0], dashed[:-1, 1])  # where there is drift


@given(bumps=st.lists(st.floats(-3.0, 3.0), min_size=8, max_size=40))
def test_a_way_over_any_bumps_stays_above_them(bumps: list[float]) -> None:
    cell, count = 0.1, len(bumps)
    column = np.arange(count) * cell
    positions = np.column_stack([column, 0.0 * column, bumps])
    ground = replace(
        merge({}, {}),
        resolution=cell,
        positions=positions,
        std=np.zeros(count),
        slope=np.zeros((count, 2)),
        owner=np.zeros(count, dtype=np.intp),
    )
    ends = np.array([[0.0, 0.0, 9.0], [column[-1], 0.0, -9.0]])
    way = drape(ends, ground, 0.02).over(ends)
    assert (way[:, 2] >= ground.heights_near(way[:, :2]) + 0.02 - 1e-9).all()
    assert len(lines_of(way)) == len(way) - 1
    assert lines_of(way[:0]).shape == (0, 2, 3)


def test_an_arch_is_met_from_near(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    scene.show(world(names=False))
    loop = LOOPS[0]
    arch = scene.arch((loop.query_id, loop.database_id))
    top = arch[[0, -1]].mean(axis=0)
    span = float(np.linalg.norm((arch[0] - arch[-1])[:2]))
    eye, down = top + np.array([0.0, 0.0, 20.0 + span]), np.array([0.0, 0.0, -1.0])
    assert scene.arch_at(eye, down, 0.02 + 0.05 * span) is loop
    assert scene.arch_at(eye + np.array([50.0, 50.0, 0.0]), down, 0.02) is None
    assert not len(scene.arch((loop.query_id, "nobody")))
    rim, foot = scene.outline(loop.query_id)[:, :2], arch[-1, :2]
    assert (rim.min(axis=0) < foot).all()
    assert (foot < rim.max(axis=0)).all()
    assert not len(scene.outline("nobody"))


def test_a_loop_that_the_others_contradict_is_black() -> None:
    colors = arch_colors(LOOPS, 6.0, {LOOPS[0].pair}).reshape(2, LOOP_PIECES, 3)
    assert not colors[0].any()
    assert colors[1].all()


def test_the_first_ground_gives_way_to_the_map(server: viser.ViserServer) -> None:
    submap = DATASET.submaps[2]
    pose = submap.pose_odometry
    assert pose is not None
    start = np.array(server.initial_camera.position)
    ground = FirstGround(server, Memo())
    ground.add(submap)
    assert node(server, "/world").visible
    np.testing.assert_allclose(node(server, "/world/submaps/0").position, (0, 0, 0), atol=1e-9)
    assert (np.array(server.initial_camera.position) != start).any()
    # The scene of a session has the same nodes, so nothing of the first one is left.
    WorldScene(server)
    assert not node(server, "/world").visible
