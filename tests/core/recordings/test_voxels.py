"""Voxels keep means, counts and scatter, in whatever portions the points come."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from gpgrad_core.recordings.voxels import Voxels, VoxelSums, reach
from tests.support.laws import examples


@examples(10)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(0.05, 0.5),
    portions=st.integers(1, 6),
    far=st.floats(-1000, 1000),
)
def test_sums_in_portions_are_the_same(seed: int, size: float, portions: int, far: float) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.4, (200, 3)) + far
    ranges = rng.uniform(1, 5, 200)
    sums = VoxelSums(size)
    for rows in np.array_split(np.arange(200), portions):
        sums.add(points[rows], ranges[rows])
    voxels = sums.total()
    cells = np.floor(points / size).astype(int)
    _, cell_of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    assert len(voxels.keys) == len(counts)
    np.testing.assert_array_equal(voxels.counts, counts)
    for k, (mean, away) in enumerate(zip(voxels.points, voxels.ranges, strict=True)):
        rows = cell_of.ravel() == k
        np.testing.assert_allclose(mean, points[rows].mean(axis=0), rtol=0, atol=1e-9)
        np.testing.assert_allclose(away, np.sqrt(np.mean(ranges[rows] ** 2)), rtol=1e-9)
    assert np.isfinite(voxels.noise_std).all()
    assert (voxels.noise_std > 0).all()


def test_scatter_tells_the_noise_of_a_mean() -> None:
    """Noise of 2 cm near and 8 cm far, far beyond the height of a voxel: both are found."""
    rng = np.random.default_rng(1)
    xy = rng.uniform(0, 8, (200_000, 2))
    std = np.where(xy[:, 0] < 4, 0.02, 0.08)
    points = np.column_stack([xy, std * rng.standard_normal(len(xy))])
    voxels = Voxels.of(points, np.where(xy[:, 0] < 4, 2.0, 6.0), 0.1)
    near = voxels.points[:, 0] < 3.9
    far = voxels.points[:, 0] > 4.1
    for those, truth in ((near, 0.02), (far, 0.08)):
        # The voxels of a column count together for as much as that many points.
        told = 1 / np.sqrt(np.mean(voxels.noise_std[those] ** -2))
        assert 0.95 * truth < told < 1.05 * truth
    # At the fringe of the scatter there are few points, and little is believed.
    fringe = far & (np.abs(voxels.points[:, 2]) > 0.2)
    assert np.median(voxels.noise_std[fringe]) > 0.16


def test_a_single_point_has_the_noise_usual_at_its_range() -> None:
    rng = np.random.default_rng(2)
    xy = rng.uniform(0, 3, (20_000, 2))
    crowd = np.column_stack([xy, 0.03 * rng.standard_normal(len(xy))])
    lonely = np.array([[50.02, 50.02, 1.0]])
    points = np.vstack([crowd, lonely])
    voxels = Voxels.of(points, np.full(len(points), 3.0), 0.1)
    (alone,) = voxels.noise_std[voxels.points[:, 0] > 40]
    assert 0.025 < alone < 0.035


@pytest.mark.parametrize("across", [1, 2, 4, 8, 16])
def test_neighbours_whose_windows_overlap_average_out_in_part(across: int) -> None:
    """Each point has the error of a window of 4 x 4 around it; voxels hold squares of points."""
    window, side = 4, 320
    white = np.random.default_rng(3).standard_normal((side, side))
    error = 0.02 * window * ndimage.uniform_filter(white, window, mode="wrap")
    squares = error.reshape(side // across, across, side // across, across)
    truth = squares.mean(axis=(1, 3)).std()
    x, y = np.meshgrid(*2 * [np.arange(side) + 0.5])
    points = np.column_stack([x.ravel(), y.ravel(), np.full(side**2, 0.5)])
    up = np.full((side**2, 3), [0.0, 0.0, 0.02])
    voxels = Voxels.of(points, np.ones(side**2), float(across), up, window**2)
    np.testing.assert_allclose(voxels.noise_std, truth, rtol=0.1)


def test_nothing_and_the_very_far() -> None:
    assert len(VoxelSums(0.1).total().keys) == 0
    furthest = 0.9 * reach(0.005)
    points = np.array([[furthest, -furthest, furthest], [-furthest, furthest, 0.0]])
    np.testing.assert_allclose(
        np.sort(Voxels.of(points, np.ones(2), 0.005).points, axis=0), np.sort(points, axis=0)
    )
