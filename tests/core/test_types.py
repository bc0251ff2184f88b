"""The vocabulary: grids, submaps, poses and maps that cannot be changed by accident."""

import dataclasses
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, Features, GradientMap, Grid, Submap
from tests.support.ground import cloud, submap
from tests.support.refusal import assert_refused

coordinates = st.floats(-1000, 1000)


@given(
    st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=20),
    st.sampled_from([0.5, 1.0, 3.3]),
)
def test_a_grid_covers_its_points_with_no_cell_to_spare(
    points: list[tuple[float, float]], resolution: float
) -> None:
    xy = np.array(points)
    grid = Grid.covering(xy, resolution)
    assert (grid.x[0], grid.y[0]) == tuple(xy.min(axis=0))
    for centres, high in ((grid.x, xy[:, 0].max()), (grid.y, xy[:, 1].max())):
        assert high - 1e-6 <= centres[-1] < high + resolution + 1e-6


@given(st.tuples(coordinates, coordinates), st.floats(0.01, 10), st.integers(0, 2**32 - 1))
def test_pixels_and_positions_undo_each_other(
    origin: tuple[float, float], resolution: float, seed: int
) -> None:
    grid = Grid(origin, resolution, (7, 9))
    pixels = np.random.default_rng(seed).uniform(-5, 20, (10, 2))
    np.testing.assert_allclose(grid.to_pixel(grid.to_position(pixels)), pixels, atol=1e-6)


def test_columns_go_with_x_and_rows_with_y() -> None:
    grid = Grid((10.0, 20.0), 0.5, (3, 4))
    np.testing.assert_allclose(grid.x, [10.0, 10.5, 11.0, 11.5])
    np.testing.assert_allclose(grid.y, [20.0, 20.5, 21.0])
    np.testing.assert_allclose(grid.to_position(np.array([[3.0, 1.0]])), [[11.5, 20.5]])
    assert grid.num_cells == 12
    positions = grid.positions.reshape(3, 4, 2)
    np.testing.assert_allclose(positions[1, 3], [11.5, 20.5])
    np.testing.assert_allclose(positions[..., 0], np.broadcast_to(grid.x, (3, 4)))


@pytest.mark.parametrize(
    ("width", "height", "resolution"),
    [(10_000, 10_000, 0.03), (200, 150, 0.005), (90_000, 1, 0.005), (1_000_000, 200, 0.005)],
)
def test_a_grid_of_too_many_cells_is_refused_with_the_count_and_the_cure(
    width: int, height: int, resolution: float
) -> None:
    corners = np.array([[0.0, 0.0], [width, height]])
    with pytest.raises(InputError) as caught:
        Grid.covering(corners, resolution, name="submap 004", max_cells=12_000_000)
    message = str(caught.value)
    size = f"spans {width:,} m x {height:,} m: "
    for part in ("submap 004", size, f"cells at {resolution} m", "raise the resolution"):
        assert part in message
    advice = message.partition("raise the resolution to ")[2]
    advised = float(advice.partition(" m or more")[0])
    Grid.covering(corners, advised, max_cells=12_000_000)


def test_rows_that_are_not_finite_are_dropped_and_counted() -> None:
    points, colors = cloud(0, 50), np.random.default_rng(0).random((50, 3))
    spoiled = points.copy()
    spoiled[3, 0], spoiled[7, 2], spoiled[9] = np.nan, np.inf, -np.inf
    made = Submap.from_points(spoiled, "a", colors=colors)
    assert made.num_dropped == 3
    for found, whole in ((made.points, points), (made.colors, colors)):
        np.testing.assert_array_equal(found, np.delete(whole, [3, 7, 9], axis=0))
    assert made.fingerprint == Submap.from_points(made.points, "b", colors=made.colors).fingerprint


def test_points_that_are_known_to_be_sound_are_not_looked_at() -> None:
    points = cloud(0, 400) * (1, 1, 0.01)
    points[7] = 0.0, 0.0, 90.0
    points[9] = np.nan
    assert Submap.from_points(points).num_wild == 1
    made = Submap.from_points(points, ground=None)
    assert (made.num_wild, made.num_dropped, made.num_points) == (0, 1, 399)
    assert made.left_out is None


def test_the_fingerprint_is_that_of_the_points_and_their_colours() -> None:
    points, colors = cloud(0, 50), np.random.default_rng(0).random((50, 3))
    moved = points.copy()
    moved[17, 2] += 1e-9
    clouds = [(points, None), (moved, None), (points[::-1], None)]
    clouds += [(points, colors), (points, colors[::-1])]
    fingerprints = [Submap.from_points(xyz, colors=rgb).fingerprint for xyz, rgb in clouds]
    assert len(set(fingerprints)) == len(clouds)
    assert Submap.from_points(points.copy(), "other").fingerprint == fingerprints[0]


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_callers_array_is_neither_frozen_nor_shared(kind: type) -> None:
    points = cloud(0, 50).astype(kind)
    made, before = Submap.from_points(points), points.astype(np.float64)
    points[:] = 0
    np.testing.assert_array_equal(made.points, before)
    with pytest.raises(ValueError, match="read-only"):
        made.points[0, 0] = 1.0


LINE = np.linspace(0, 5, 40)


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((0, 3)), "found 0 of 0"),
        (np.ones((1, 3)), "found 1 of 1"),
        (np.array([[0.0, 0, 0], [1, 0, 0], [np.nan, 1, 0]]), "found 2 of 3"),
        (np.column_stack([LINE, 2 * LINE, LINE]), "one line"),
        (np.column_stack([LINE, 0 * LINE, LINE**2]), "one line"),
        (np.ones((30, 3)), "one line"),
        (np.column_stack([0 * LINE, 0 * LINE, LINE]), "one line"),
        (np.random.default_rng(0).uniform(0, 1e30, (10, 3)), "1e+09 m is the most"),
    ],
)
def test_points_that_are_no_ground_are_refused_by_name(points: Array, said: str) -> None:
    assert_refused(lambda: Submap.from_points(points, "submap 3"), "submap 3: ", said)


def test_a_motion_of_the_plane_becomes_one_of_space_and_back() -> None:
    motion, points = SE2(1.0, -2.0, 3.0), cloud(0, 20)
    pose = Pose.from_planar(motion, 0.5)
    moved = pose.apply(points)
    np.testing.assert_allclose(moved[:, :2], motion.apply(points[:, :2]), atol=1e-12)
    np.testing.assert_allclose(moved[:, 2], points[:, 2] + 0.5, atol=1e-12)
    assert vars(pose.planar) == pytest.approx(vars(motion))


@given(st.integers(0, 2**32 - 1))
def test_poses_turn_and_compose_as_their_matrices_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (
        Pose(rng.normal(size=3), quaternion / np.linalg.norm(quaternion))
        for quaternion in rng.normal(size=(2, 4))
    )
    points = rng.normal(size=(5, 3))
    np.testing.assert_allclose(a.rotation @ a.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(a.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=1e-12)
    np.testing.assert_allclose((a.inverse() @ a).apply(points), points, atol=1e-12)
    assert np.linalg.norm((a @ b).quaternion) == pytest.approx(1.0)
    assert (a @ b).quaternion[3] >= 0


def test_a_dataset_finds_its_submaps_by_id() -> None:
    dataset = Dataset("crater", (submap(0, 20), submap(1, 20)))
    assert dataset.submap("ground-1") is dataset.submaps[1]
    with pytest.raises(InputError, match="crater has no submap '7'"):
        dataset.submap("7")


@pytest.fixture
def gradient_map() -> GradientMap:
    slope = np.zeros((2, 3, 2))
    slope[0, 1] = [3.0, -4.0]
    variance = np.array([[0.01, 0.04, 0.09], [0.16, 0.25, 1.0]])
    grid = Grid((0.0, 0.0), 0.1, (2, 3))
    return GradientMap(grid, np.zeros((2, 3)), variance, slope, 1.0, 0.3)


def test_a_map_derives_steepness_and_std(gradient_map: GradientMap) -> None:
    assert gradient_map.gradient[0, 1] == pytest.approx(5.0)
    assert gradient_map.gradient[1, 2] == 0.0
    np.testing.assert_allclose(gradient_map.std, [[0.1, 0.2, 0.3], [0.4, 0.5, 1.0]])


def test_cells_are_trusted_up_to_and_with_the_ratio(gradient_map: GradientMap) -> None:
    assert gradient_map.trusted(0.5).tolist() == [[True, True, True], [True, True, False]]
    assert gradient_map.trusted(1.0).all()
    louder = dataclasses.replace(gradient_map, signal_std=2.0)
    np.testing.assert_array_equal(louder.trusted(0.25), gradient_map.trusted(0.5))


def test_a_map_cannot_be_changed(gradient_map: GradientMap) -> None:
    for name in ("elevation", "variance", "slope", "gradient", "std"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(gradient_map, name)[0] = 0.0
    with pytest.raises(FrozenInstanceError):
        gradient_map.signal_std = 2.0  # type: ignore[misc]


def test_features_are_chosen_by_mask_or_by_index() -> None:
    rng = np.random.default_rng(0)
    descriptors = rng.integers(0, 255, (5, 61)).astype(np.uint8)
    features = Features(rng.random((5, 2)), *rng.random((3, 5)), descriptors)
    for rows in (np.array([0, 3]), np.array([True, False, False, True, False])):
        chosen = features.select(rows)
        assert (len(features), len(chosen)) == (5, 2)
        for name, values in vars(features).items():
            np.testing.assert_array_equal(getattr(chosen, name), values[[0, 3]])


def test_data_are_told_apart_by_identity() -> None:
    points = cloud(0, 20)
    a, b = Submap.from_points(points), Submap.from_points(points)
    assert a != b
    assert len({a, b, a}) == 2
