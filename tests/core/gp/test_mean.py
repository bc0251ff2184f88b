"""The prior mean of heights around a place."""

import numpy as np
import pytest

from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.mean import LocalMean
from gpgrad_core.types import Grid

RNG = np.random.default_rng(4)
GRID = Grid((-1.0, -2.0), 0.05, (161, 121))  # the points' square of 5 m lies in its middle


def cloud(heights: float = 2.0) -> np.ndarray:
    xy = RNG.uniform([-0.5, -0.5], [4.5, 4.5], (4000, 2))
    return np.column_stack([xy, heights + 0.3 * np.sin(xy[:, 0]) + 0.1 * xy[:, 1]])


def local_mean(points: np.ndarray, noise_std: np.ndarray | float = 0.02) -> LocalMean:
    return LocalMean.of(points, np.broadcast_to(noise_std, len(points)), 0.4)


def test_grid_and_positions_agree() -> None:
    mean = local_mean(cloud())
    elevation, _ = mean.on(GRID)
    x, y = np.meshgrid(GRID.x, GRID.y)
    inside = (np.abs(x - 2) < 2.5) & (np.abs(y - 2) < 2.5)
    at = mean.at(np.column_stack([x[inside], y[inside]]))
    np.testing.assert_allclose(at, elevation[inside], atol=1e-12)


def test_slopes_are_the_derivatives() -> None:
    elevation, slope = local_mean(cloud()).on(GRID)
    along_y, along_x = np.gradient(elevation, GRID.resolution)
    inner = slice(8, -8), slice(8, -8)
    np.testing.assert_allclose(slope[(*inner, 0)], along_x[inner], atol=0.02)
    np.testing.assert_allclose(slope[(*inner, 1)], along_y[inner], atol=0.02)


def test_follows_the_ground_and_goes_flat_beyond_it() -> None:
    points = cloud()
    mean = local_mean(points)
    assert np.abs(mean.at(points[:, :2]) - points[:, 2]).max() < 0.15
    at = np.array([[7.0, 2.0], [50.0, 2.0]])
    near, far = mean.at(at)
    assert near == far
    elevation, slope = mean.on(Grid((7.0, 2.0), 43.0, (1, 2)))
    np.testing.assert_allclose(elevation, [[near, far]])
    assert (slope[..., 0] == 0).all()


def test_an_outlier_with_its_noise_moves_nothing() -> None:
    points, noise = cloud(), np.full(4000, 0.02)
    before = local_mean(points, noise).at(points[:, :2])
    points[7, 2] += 30.0
    noise[7] = 30.0
    assert np.abs(local_mean(points, noise).at(points[:, :2]) - before).max() < 0.002


@pytest.mark.parametrize("shift", [(0.0, 0.0), (1e6, -3e6)])
def test_depends_on_heights_around_alone(shift: tuple[float, float]) -> None:
    points = cloud()
    moved = points + np.array([*shift, 100.0])
    before, after = local_mean(points), local_mean(moved)
    np.testing.assert_allclose(after.at(moved[:, :2]), before.at(points[:, :2]) + 100.0, atol=1e-6)


def test_a_map_has_the_mean_in_its_elevation_and_slopes() -> None:
    points = cloud()
    kernel = SquaredExponential(0.2, 0.4)
    fields = fit_gp(points, kernel, 0.02, mean=local_mean(points)).sample(GRID)
    along_y, along_x = np.gradient(fields.elevation, GRID.resolution)
    x, y = np.meshgrid(GRID.x, GRID.y)
    inside = (np.abs(x - 2) < 2.2) & (np.abs(y - 2) < 2.2)
    expected = 2.0 + 0.3 * np.sin(x) + 0.1 * y
    assert np.abs(fields.elevation - expected)[inside].max() < 0.03
    np.testing.assert_allclose(fields.slope[inside, 0], along_x[inside], atol=0.02)
    np.testing.assert_allclose(fields.slope[inside, 1], along_y[inside], atol=0.02)
