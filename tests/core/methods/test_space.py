"""Motions in space, descriptors that turn with the cloud, and what is left of them in the plane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.methods.rivals import (
    DescribedCloud,
    fit_rigid,
    mutual_matches,
    planar_motion,
    ransac_se3,
)
from gpgrad_core.methods.shot import (
    color_shot,
    curved_keypoints,
    describe_cshot,
    describe_shot,
    shot,
    surface_variation,
)
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Submap
from tests.support.laws import examples

SEEDS = st.integers(0, 2**32 - 1)


def motion(seed: int, tilt: float = np.pi) -> Array:
    """A random rigid motion whose turn is up to ``tilt``."""
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    matrix = np.eye(4)
    turn = rng.uniform(-tilt, tilt) * axis / np.linalg.norm(axis)
    matrix[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    matrix[:3, 3] = rng.uniform(-5, 5, 3)
    return matrix


def moved(matrix: Array, points: Array) -> Array:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@given(SEEDS, st.integers(3, 20))
def test_a_motion_is_fitted_exactly(seed: int, num: int) -> None:
    points = np.random.default_rng(seed).uniform(-5, 5, (num, 3))
    expected = motion(seed)
    found = fit_rigid(points[None], moved(expected, points)[None])[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)


@examples(10)
@given(SEEDS)
def test_ransac_finds_a_motion_among_three_times_as_many_outliers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    query, expected = rng.uniform(-5, 5, (80, 3)), motion(seed)
    database = rng.uniform(-5, 5, (80, 3))
    database[:20] = moved(expected, query[:20])
    found = ransac_se3(query, database, 0.1, 0)
    assert found is not None
    np.testing.assert_allclose(found[0], expected, atol=0.1)
    assert found[1][:20].all()
    assert ransac_se3(query[:2], database[:2], 0.1, 0) is None


def test_ransac_finds_no_motion_where_edges_are_alike_and_no_three_points_fit() -> None:
    points = np.random.default_rng(0).uniform(-5, 5, (20, 3))
    assert ransac_se3(points, 1.05 * points, 1e-6, 0) is None


@given(SEEDS)
def test_a_level_motion_stays_what_it_is_from_above(seed: int) -> None:
    rng = np.random.default_rng(seed)
    expected = SE2(*rng.uniform(-3, 3, 3).tolist())
    level = np.eye(4)
    level[:2, :2] = Rotation.from_euler("z", expected.yaw).as_matrix()[:2, :2]
    level[:3, 3] = expected.x, expected.y, rng.uniform(-5, 5)
    points = rng.uniform(-5, 5, (10, 3))
    found = planar_motion(level, points)
    np.testing.assert_allclose(found.apply(points[:, :2]), expected.apply(points[:, :2]), atol=1e-9)


@given(SEEDS)
def test_a_tilt_leaves_the_middle_of_the_query_where_it_was_put(seed: int) -> None:
    tilted = motion(seed, 0.2)
    points = np.random.default_rng(seed).uniform(-5, 5, (10, 3)) + np.array([40.0, 30.0, 0.0])
    put = planar_motion(tilted, points).apply(points[:, :2].mean(axis=0, keepdims=True))
    np.testing.assert_allclose(put[0], moved(tilted, points).mean(axis=0)[:2], atol=1e-9)


def bumpy(seed: int) -> tuple[Array, Array]:
    """Points on a bumpy sheet, and its upward normals."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-2, 2, (3000, 2))
    z = 0.3 * np.sin(2.1 * xy[:, 0]) * np.cos(1.7 * xy[:, 1]) + 0.1 * np.sin(5 * xy[:, 0])
    dx = 0.63 * np.cos(2.1 * xy[:, 0]) * np.cos(1.7 * xy[:, 1]) + 0.5 * np.cos(5 * xy[:, 0])
    dy = -0.51 * np.sin(2.1 * xy[:, 0]) * np.sin(1.7 * xy[:, 1])
    normals = np.column_stack([-dx, -dy, np.ones(len(xy))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.column_stack([xy, z]), normals


def test_shot_turns_with_the_cloud_and_tells_places_apart() -> None:
    points, normals = bumpy(1)
    inner = np.flatnonzero(np.abs(points[:, :2]).max(axis=1) < 1)[:40]
    turn = motion(5)
    plain = shot(points, normals, points[inner], 0.8)
    turned_points = moved(turn, points)
    turned = shot(turned_points, normals @ turn[:3, :3].T, turned_points[inner], 0.8)
    assert plain.shape == (40, 352)
    np.testing.assert_allclose(np.linalg.norm(plain, axis=1), 1, atol=1e-9)
    alike = plain @ turned.T
    # All but a few whose axis has as many neighbours on one side as on the other.
    assert np.sum(np.diag(alike) > 0.999) >= 38
    assert np.sum(alike.argmax(axis=1) == np.arange(40)) >= 38


def test_colors_of_the_neighbours_are_counted_by_how_they_differ() -> None:
    points, _ = bumpy(2)
    keypoints = points[:10]
    grey = np.full((len(points), 3), 0.5)
    alike = color_shot(points, grey, keypoints, 0.6).reshape(10, 32, 31)
    assert alike.shape == (10, 32, 31)
    assert np.all(alike[:, :, 1:] == 0)  # no difference at all: the first bin alone
    mixed = grey.copy()
    mixed[::2] = [1.0, 0.0, 0.0]
    other = color_shot(points, mixed, keypoints, 0.6).reshape(10, 32, 31)
    assert np.all(other[:, :, 3:].sum(axis=(1, 2)) > 0)


def test_keypoints_lie_where_the_surface_bends() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(-1, 1, (2000, 2))
    roof = np.column_stack([xy, -np.abs(xy[:, 0])])  # a ridge along y
    variation = surface_variation(roof, 0.2)
    ridge, slope = np.abs(xy[:, 0]) < 0.05, np.abs(xy[:, 0]) > 0.3
    assert variation[ridge].min() > 10 * variation[slope].max()
    chosen = curved_keypoints(roof, 0.2, 0.2, 4)
    assert len(chosen) == 4
    assert np.abs(xy[chosen, 0]).max() < 0.1


def test_cshot_says_that_it_needs_colors() -> None:
    plain = Submap.from_points(bumpy(1)[0], "007")
    with pytest.raises(InputError, match="007: cshot needs the colours"):
        describe_cshot(plain, PipelineParams(map=MapParams().guessed))


def test_cshot_is_shot_and_the_colors_in_equal_parts() -> None:
    points = bumpy(1)[0]
    colored = Submap.from_points(points, colors=np.tile([0.8, 0.35, 0.1], (len(points), 1)))
    params = PipelineParams(map=MapParams().guessed)
    both, plain = describe_cshot(colored, params), describe_shot(colored, params)
    assert both.descriptors.shape == (len(plain.points), 352 + 32 * 31)
    np.testing.assert_array_equal(both.points, plain.points)
    np.testing.assert_allclose(both.descriptors[:, :352], plain.descriptors / np.sqrt(2), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(both.descriptors, axis=1), 1.0, atol=1e-6)


def described(*descriptors: tuple[float, float]) -> DescribedCloud:
    values = np.array(descriptors, np.float32)
    return DescribedCloud(np.zeros((len(values), 3)), values, np.zeros((1, 3)))


def test_a_threshold_drops_associations_of_distant_descriptors() -> None:
    query, database = described((0, 0), (5, 0), (9, 0)), described((5.3, 0.4), (0, 0.1), (5.9, 0))
    assert mutual_matches(query, database).tolist() == [[0, 1], [1, 0]]
    assert mutual_matches(query, database, 0.51).tolist() == [[0, 1], [1, 0]]
    assert mutual_matches(query, database, 0.49).tolist() == [[0, 1]]
