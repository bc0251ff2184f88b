"""The route goes out and back; the camera sees what it can, as well as it can."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from gpgrad_core.se2 import SE2
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.routes import STEP, plan_track
from gpgrad_core.simulation.rover import ANGULAR_STEP, HIGHEST_RING, LOWEST_RING, scan
from gpgrad_core.simulation.terrain import RESOLUTION, HeightField
from tests.support.refusal import assert_refused

PERFECT = SimulationParams(noise_constant=0.0, noise_quadratic=0.0, dropout_rate=0.0)
CENTRE = SE2(10.0, 10.0, 0.7)


def ground(height: float = 0.0) -> np.ndarray:
    size = round(20.0 / RESOLUTION)
    return np.full((size, size), height)


def look(
    elevation: np.ndarray, params: SimulationParams, stop: SE2 = CENTRE, seed: int = 0
) -> np.ndarray:
    return scan(HeightField(elevation), stop, params, np.random.default_rng(seed))


def along_and_across() -> tuple[np.ndarray, np.ndarray]:
    """The cells of `ground` in the frame of the rover at the centre [m]."""
    rows, columns = np.mgrid[: len(ground()), : len(ground())] * RESOLUTION
    inverse = CENTRE.inverse()
    along, across = inverse.apply(np.column_stack([columns.ravel(), rows.ravel()])).T
    return along.reshape(rows.shape), across.reshape(rows.shape)


def ranges(points: np.ndarray, params: SimulationParams) -> tuple[np.ndarray, np.ndarray]:
    """Measured ranges of points on flat ground, and the true ones along the same rays [m]."""
    rays = points - [CENTRE.x, CENTRE.y, params.camera_height]
    measured = np.linalg.norm(rays, axis=1)
    return measured, -params.camera_height * measured / rays[:, 2]


def in_rover(points: np.ndarray, stop: SE2 = CENTRE) -> tuple[np.ndarray, np.ndarray]:
    """Distance over ground from the rover [m], and bearing from its heading [rad]."""
    dx, dy = points[:, 0] - stop.x, points[:, 1] - stop.y
    bearing = np.arctan2(dy, dx) - stop.yaw
    return np.hypot(dx, dy), np.arctan2(np.sin(bearing), np.cos(bearing))


@pytest.mark.parametrize("route", ["winding", "loop", "figure_eight", "serpentine"])
def test_the_way_back_meets_the_way_out_head_on(route: str) -> None:
    params = SimulationParams(route=route, num_submaps=20, extent=90.0)
    track = plan_track(params)
    steps = np.hypot(*np.diff(track.xy, axis=0).T)
    assert steps.max() < 2 * STEP
    assert track.xy.min() > params.max_range
    assert track.xy.max() < params.extent - params.max_range
    half = round(0.5 * params.num_submaps * params.spacing / STEP)
    out, back = track.xy[:half], track.xy[half:]
    side = np.linalg.norm(out[:, None] - back[None, ::10], axis=2)
    nearest = side.argmin(axis=0)
    gaps = side.min(axis=0)
    assert gaps.max() <= params.lateral_offset + STEP
    assert gaps.max() > 0.8 * params.lateral_offset
    assert gaps[len(gaps) // 4 : -5].min() < 0.1  # it crosses
    opposite = track.yaw[:half][nearest] - track.yaw[half:][::10]
    assert np.median(np.cos(opposite)) < -0.9


def test_the_serpentine_route_goes_across_rows_and_along_them() -> None:
    params = SimulationParams(
        route="serpentine", num_submaps=40, extent=100.0, row_spacing=6.0, row_heading=0.4
    )
    track = plan_track(params)
    out = track.xy[: round(0.5 * params.num_submaps * params.spacing / STEP)]
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    across, along = ((out - out[0]) @ turn).T
    # The lanes along the rows are whole rows apart, and those across them share no ground.
    moved = np.gradient(np.column_stack([across, along]), STEP, axis=0)
    along_rows, across_rows = across[moved[:, 1] > 0.99999], along[np.abs(moved[:, 0]) > 0.99999]
    assert np.ptp(along_rows) == pytest.approx(24.0, abs=0.1)
    beside = np.diff(np.sort(across_rows))
    assert beside.max() == pytest.approx(2.0 * params.max_range + 2.0, abs=0.1)


def test_a_track_that_does_not_fit_says_what_would() -> None:
    assert_refused(
        lambda: plan_track(SimulationParams(num_submaps=20, route="winding", extent=30.0)),
        "extent must be",
        "20 submaps 5 m apart on the route 'winding', got 30 m",
    )


def test_flat_ground_is_measured_exactly_within_the_view() -> None:
    points = look(ground(), PERFECT)
    assert len(points) > 10_000
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-9)
    distance, bearing = in_rover(points)
    slant = np.hypot(distance, PERFECT.camera_height)
    assert slant.max() <= PERFECT.max_range + 1e-9
    assert slant.max() > 0.95 * PERFECT.max_range
    assert np.abs(bearing).max() == pytest.approx(0.5 * PERFECT.field_of_view, abs=0.02)


def test_every_point_lies_on_uneven_ground() -> None:
    rng = np.random.default_rng(1)
    bumps = ndimage.zoom(rng.normal(0, 0.15, (25, 25)), len(ground()) / 25, order=3)
    points = look(bumps, PERFECT)
    assert len(points) > 5_000
    true = HeightField(bumps).height(points[:, :2])
    np.testing.assert_allclose(points[:, 2], true, atol=1e-3)


def test_a_wall_casts_a_shadow() -> None:
    elevation = ground()
    along, across = along_and_across()
    height = 0.55  # half as high as the camera: its shadow is as long again as it is far
    elevation[(along > 2.0) & (along < 2.2) & (np.abs(across) < 0.5)] = height
    points = look(elevation, PERFECT)
    distance, bearing = in_rover(points)
    ahead = distance[np.abs(bearing) < 0.15]
    assert np.any((ahead > 1.5) & (ahead < 2.0))
    shadow_end = 2.2 * PERFECT.camera_height / (PERFECT.camera_height - height)
    assert not np.any((ahead > 2.3) & (ahead < shadow_end - 0.1))
    assert np.any(ahead > shadow_end + 0.1)
    aside = distance[np.abs(bearing) > 0.5]
    assert np.any((aside > 2.5) & (aside < shadow_end - 0.3))


def test_noise_grows_with_the_square_of_the_range() -> None:
    params = replace(PERFECT, noise_constant=0.005, noise_quadratic=0.004)
    measured, true = ranges(look(ground(), params), params)
    for low, high in ((1.2, 1.6), (2.8, 3.2), (5.5, 6.5)):
        band = (true > low) & (true < high)
        expected = np.sqrt(
            np.mean((params.noise_constant + params.noise_quadratic * true[band] ** 2) ** 2)
        )
        assert np.std((measured - true)[band]) == pytest.approx(expected, rel=0.1)


def test_errors_of_patches_are_as_large_and_alike_among_neighbours() -> None:
    for common in (0.0, 0.5, 1.0):
        params = replace(PERFECT, noise_constant=0.02, noise_common=common)
        found = np.subtract(*ranges(look(ground(), params), params))
        assert np.std(found) == pytest.approx(0.02, rel=0.1)
        # Successive points are of neighbouring rays.
        alike = np.corrcoef(found[1:], found[:-1])[0, 1]
        assert alike == pytest.approx(common, abs=0.06)


def test_dropouts_take_their_share_in_patches_and_singly() -> None:
    whole, holed = look(ground(), PERFECT), look(ground(), replace(PERFECT, dropout_rate=0.3))
    assert len(holed) / len(whole) == pytest.approx(0.7, abs=0.03)


def test_a_rover_on_a_slope_sees_a_tilted_view() -> None:
    along, _ = along_and_across()
    level_near = in_rover(look(ground(), PERFECT))[0].min()
    # Nose down before a plain: the view starts nearer to the wheels than on the level.
    nose_down = np.clip(-0.4 * (along + 0.4), -0.32, None)
    assert in_rover(look(nose_down, PERFECT))[0].min() < level_near - 0.05


LIDAR = replace(PERFECT, sensor="lidar", max_range=6.0, lidar_rings=16)


def test_a_lidar_sees_all_around_in_rings() -> None:
    points = look(ground(), LIDAR)
    distance, bearing = in_rover(points)
    np.testing.assert_allclose(points[:, 2], 0.0, atol=1e-9)
    assert np.histogram(bearing, 36, (-np.pi, np.pi))[0].min() > 0
    # On level ground each ring below the horizon that reaches it is a circle.
    spacing = (HIGHEST_RING - LOWEST_RING) / (LIDAR.lidar_rings - 1)
    down = np.arctan2(LIDAR.camera_height, distance)
    ring = (-down - LOWEST_RING) / spacing
    np.testing.assert_allclose(ring, np.rint(ring), atol=0.5 * ANGULAR_STEP / spacing + 1e-6)
    assert 4 <= len(np.unique(np.rint(ring))) <= 8


def test_a_lidars_noise_does_not_grow_with_the_range() -> None:
    params = replace(LIDAR, noise_constant=0.02, noise_quadratic=0.01, lidar_rings=64)
    measured, true = ranges(look(ground(), params), params)
    for band in (true < 3.0, true > 4.5):
        assert np.std((measured - true)[band]) == pytest.approx(0.02, rel=0.1)
    assert params.range_noise == (0.02, 0.0)


def test_an_airborne_scanner_sees_all_the_ground_at_one_density() -> None:
    params = replace(PERFECT, sensor="airborne", scan_density=40.0, dropout_rate=0.5, max_range=6.0)
    wall = ground()
    wall[:, round(11.0 / RESOLUTION) :] = 3.0  # a rover could not look over it
    points = look(wall, params)
    distance, _ = in_rover(points)
    assert distance.max() <= 6.0
    assert len(points) == pytest.approx(20.0 * np.pi * 36.0, rel=0.1)
    inner = np.sum(distance <= 3.0)
    assert inner == pytest.approx(len(points) / 4, rel=0.15)
    assert np.sum(points[:, 2] > 2.9) > 0.2 * len(points)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_the_noise_of_an_airborne_scanner_is_in_the_height(noise: float) -> None:
    params = replace(PERFECT, sensor="airborne", noise_constant=noise, scan_density=5.0)
    heights = look(ground(2.0), params)[:, 2]
    assert heights.mean() == pytest.approx(2.0, abs=0.03)
    assert heights.std() == pytest.approx(noise, rel=0.15)
