from typing import Any

import numpy as np
import pytest
import viser

from app.viewer.features.world.scene import (
    LOOP_PIECES,
    MOST_ARCHES,
    Loop,
    World,
    WorldScene,
    arches,
    choose_arches,
    drawable,
    trajectory_lines,
)
from app.viewer.features.world.submaps import (
    MAX_CELLS,
    PoseSource,
    Surface,
    WorldColor,
    WorldOptions,
    pick,
    poses_of,
    quick_surface,
    submap_color,
    world_scale,
)
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset
from tests.support.synthetic import NUMBERS, make_dataset, make_map
from tests.support.widgets import node

DATASET = make_dataset()
POSES = poses_of(DATASET, "odometry")
SIGHTS = {submap.id: Surface(make_map(submap), 0.9) for submap in DATASET.submaps}
LOOPS = (Loop("003", "000", 5.0, True), Loop("002", "000", 1.0, False))


def raised(position: Any, *, y: float = 0.0, z: float = 0.0) -> Any:
    return position + np.array([0.0, y, z])


def world(color: WorldColor = "submap", selected: str | None = None, **options: Any) -> World:
    trajectories: dict[PoseSource, Any] = {"odometry": POSES}
    chosen = WorldOptions(color=color, **options)
    return World(DATASET, SIGHTS, POSES, trajectories, chosen, LOOPS, selected, None, 6.0)


def test_all_submaps_lie_at_their_poses(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    assert scene.show(world()) is None
    offsets = [
        np.array(node(server, f"/world/submaps/{k}").position) - POSES[submap.id].translation
        for k, submap in enumerate(DATASET.submaps)
    ]
    np.testing.assert_allclose(offsets, np.tile(offsets[0], (4, 1)), atol=1e-9)  # one shift for all
    assert node(server, "/world/submaps/3/name").text == "003"
    assert scene.num_cells == sum(
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
    np.testing.assert_allclose(
        node(server, "/world/trajectories/odometry").points - way_before,
        [[[0.0, 1.5, 0.0]] * 2] * 3,
        atol=1e-5,
    )
    scene.show(world(names=False))
    move(moved)  # too late: something else is shown
    np.testing.assert_allclose(np.array(node(server, "/world/submaps/1").position), before)


def test_loops_show_and_hide(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    scene.show(world())
    assert len(node(server, "/world/loops").points) == LOOP_PIECES
    scene.show(world(loops=False, refused=True))
    assert not node(server, "/world/loops").visible
    assert len(node(server, "/world/refused").points) == LOOP_PIECES


def test_of_many_loops_the_best_are_drawn_and_all_of_the_chosen_submap() -> None:
    loops = tuple(
        Loop(f"{query:03d}", f"{database:03d}", float(query + database), accepted=True)
        for query in range(100)
        for database in range(query)
    )
    options = WorldOptions()
    best = choose_arches(loops, options, None)
    assert len(best) == MOST_ARCHES
    assert min(loop.score for loop in best) >= sorted(loop.score for loop in loops)[-MOST_ARCHES]
    chosen = choose_arches(loops, options, "007")
    assert set(best) < set(chosen)
    assert {loop for loop in loops if "007" in loop.pair} < set(chosen)
    assert len(chosen) == MOST_ARCHES + 99
    assert choose_arches(loops, WorldOptions(loops=False), "007") == ()
    few = (Loop("2", "0", 1.0, accepted=False), Loop("1", "0", 2.0, accepted=True))
    assert choose_arches(few, WorldOptions(refused=True), None) == few[::-1]


def test_a_submap_without_a_name_has_no_label(server: viser.ViserServer) -> None:
    scene = WorldScene(server, visible=True)
    scene.show(world(names=False))
    assert node(server, "/world/submaps/0/name") is None
    scene.show(world())
    assert node(server, "/world/submaps/0/name").visible
    scene.show(world(names=False))
    assert not node(server, "/world/submaps/0/name").visible


def test_a_smaller_dataset_leaves_nothing_of_the_larger(server: viser.ViserServer) -> None:
    def frames() -> list[int]:
        return [k for k in range(4) if node(server, f"/world/submaps/{k}") is not None]

    scene = WorldScene(server, visible=True)
    scene.show(world())
    assert frames() == [0, 1, 2, 3]
    smaller = Dataset("smaller", make_dataset(name="smaller").submaps[:2])
    poses = poses_of(smaller, "odometry")
    scene.show(World(smaller, SIGHTS, poses, {"odometry": poses}))
    assert frames() == [0, 1]
    scene.show(world())
    assert frames() == [0, 1, 2, 3]


def test_colours_share_one_scale() -> None:
    assert world_scale(SIGHTS, POSES, "submap") is None
    scale = world_scale(SIGHTS, POSES, "gradient")
    assert scale is not None
    assert (scale.low, scale.unit) == (0.0, "m/m")
    lifted = {
        name: Pose(raised(pose.translation, z=10.0), pose.quaternion)
        for name, pose in POSES.items()
    }
    low, high = (world_scale(SIGHTS, poses, "elevation") for poses in (POSES, lifted))
    assert low is not None
    assert high is not None
    assert high.low - low.low == pytest.approx(10.0, abs=1e-6)


def test_neighbours_have_colours_apart() -> None:
    colors = np.array([submap_color(k) for k in range(40)], dtype=float)
    assert np.linalg.norm(np.diff(colors, axis=0), axis=1).min() > 60
    assert np.linalg.norm(colors[2:] - colors[:-2], axis=1).min() > 30


def test_a_quick_sight_is_as_coarse_as_many_submaps_ask_for() -> None:
    memo, submap = Memo(), DATASET.submaps[0]
    few, many = (quick_surface(submap, NUMBERS, memo, count) for count in (4, 400))
    assert few.gradient_map.grid.resolution == pytest.approx(0.03)
    shown = many.gradient_map.trusted(many.max_std_ratio).sum()
    assert shown <= 1.5 * MAX_CELLS / 400
    seen = few.gradient_map.trusted(few.max_std_ratio)
    true = make_map(submap, few.gradient_map.grid.resolution).elevation
    assert np.abs(few.gradient_map.elevation - true)[seen].mean() < 0.03


def test_a_ray_finds_the_nearer_submap() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41))
    cells = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1).astype(np.float32)
    quarter = np.array([0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8)])
    surfaces = {
        "low": (cells, Pose(np.array([0.0, 0.0, 0.0]), quarter), 0.05),
        "high": (cells, Pose(np.array([1.5, 0.0, 1.0]), quarter), 0.05),
    }
    down = np.array([0.0, 0.0, -2.0])
    assert pick(np.array([0.9, 0.1, 5.0]), down, surfaces) == "high"
    assert pick(np.array([-0.5, 0.1, 5.0]), down, surfaces) == "low"
    assert pick(np.array([0.0, 1.3, 5.0]), down, surfaces) == "low"  # the corner is turned there
    assert pick(np.array([-5.0, 0.0, 5.0]), down, surfaces) is None
    assert pick(np.array([0.0, 0.0, 5.0]), -down, surfaces) is None


def test_lines_start_and_end_at_submaps() -> None:
    assert trajectory_lines(POSES, 0.5).shape == (3, 2, 3)
    missing = Loop("003", "nowhere", 1.0, True)
    assert drawable((*LOOPS, missing), POSES) == LOOPS
    lines = arches(LOOPS[:1], POSES, 0.5)
    np.testing.assert_allclose(lines[0, 0], raised(POSES["000"].translation, z=0.5), atol=1e-6)
    np.testing.assert_allclose(lines[-1, 1], raised(POSES["003"].translation, z=0.5), atol=1e-6)
    assert arches((), POSES, 0.5).shape == (0, 2, 3)
