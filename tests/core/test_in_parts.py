"""What is computed part by part, to bound its memory, is what it is as a whole."""

import numpy as np
import pytest

from gpgrad_core import matching
from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.features import detection, slope_field
from gpgrad_core.gp import splat, tiles
from gpgrad_core.gp.inference import fit_gp
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.gp.splat import LatticeAxis, Splat
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.registration.surface import MOST_SIDE, thin_grid
from gpgrad_core.types import Features, Grid
from tests.core.gp.oracle import grid_beyond
from tests.support.ground import cloud, submap

PARAMS = MapParams(length_scale=0.3, noise_std=0.03, resolution=0.05, scale=0.3)


def test_interpolation_of_a_long_image(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    image = rng.normal(size=(50, 70, 3)).astype(np.float32)
    where = rng.uniform(-3, 75, (40, 9, 2))
    where[0, :4] = [[9.5, 9.5], [10.0, 20.0], [19.9, 10.1], [69.5, 49.5]]
    whole = detection.interpolate(image, where)
    monkeypatch.setattr(detection, "MOST_SIDE", 10)
    # OpenCV interpolates in steps of 1/32 pixel, relative to the part.
    np.testing.assert_allclose(detection.interpolate(image, where), whole, atol=0.15)
    exact = np.round(32 * where) / 32
    monkeypatch.undo()
    whole = detection.interpolate(image, exact)
    monkeypatch.setattr(detection, "MOST_SIDE", 10)
    np.testing.assert_allclose(detection.interpolate(image, exact), whole, atol=1e-5)
    monkeypatch.undo()
    # Longer than OpenCV samples.
    image = np.arange(40_000, dtype=np.float32)[None, :, None]
    at = np.array([[[31_000.5, 0.0], [39_999.0, 0.0], [3.25, 0.0]]])
    found = detection.interpolate(image, at)[0, :, 0]
    np.testing.assert_allclose(found, [31_000.5, 39_999.0, 3.25])


def test_keypoints_band_by_band(monkeypatch: pytest.MonkeyPatch) -> None:
    made = infer_gradient_map(submap(3), PARAMS)
    whole = slope_field.detect_slope_field(made)
    monkeypatch.setattr(slope_field, "CELLS_AT_ONCE", 7 * made.grid.shape[1])
    parts = slope_field.detect_slope_field(made)
    assert len(whole.pixels) == len(parts.pixels) > 10
    order = [np.lexsort(one.pixels.T) for one in (whole, parts)]
    for name in ("pixels", "diameters", "responses", "descriptors"):
        values = [getattr(one, name)[k] for one, k in zip((whole, parts), order, strict=True)]
        np.testing.assert_allclose(values[1], values[0], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 0.9])
@pytest.mark.parametrize("kind", ["float", "bits"])
def test_associations_in_turns(monkeypatch: pytest.MonkeyPatch, ratio: float, kind: str) -> None:
    rng = np.random.default_rng(0)

    def features(num: int) -> Features:
        bits = rng.integers(0, 4, (num, 2)).astype(np.uint8)  # many are equally near
        drawn = bits if kind == "bits" else rng.normal(size=(num, 5)).astype(np.float32)
        one = np.ones(num)
        return Features(rng.normal(size=(num, 2)), one, one, one, drawn)

    query, database = features(60), features(45)
    params = matching.MatchParams(ratio=ratio)
    whole = matching.match_features(query, database, params)
    monkeypatch.setattr(matching, "MOST_DISTANCES", 45 * 7)
    parts = matching.match_features(query, database, params)
    np.testing.assert_array_equal(parts.pairs, whole.pairs)
    np.testing.assert_array_equal(parts.distances, whole.distances)


def test_the_mean_block_by_block(monkeypatch: pytest.MonkeyPatch) -> None:
    points = cloud(2, 400, (24.0, 12.0))
    grid = grid_beyond(points, 1.0, 0.1)
    posterior = fit_gp(points, SquaredExponential(0.2, 0.3), 0.02, solver="tiles")
    assert posterior is not None
    parts = posterior.sample(grid)
    monkeypatch.setattr(splat, "BLOCK", 1e9)
    whole = posterior.sample(grid)
    np.testing.assert_allclose(parts.elevation, whole.elevation, atol=1e-6 * 0.02)
    np.testing.assert_allclose(parts.slope, whole.slope, atol=1e-5 * 0.02)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.05, 0.003, 0.0003])
def test_a_tiles_variance_by_a_polynomial(monkeypatch: pytest.MonkeyPatch, noise: float) -> None:
    points = cloud(2, 300, (6.0, 4.0), noise=noise)
    grid = grid_beyond(points, 0.2, 0.02)
    posterior = fit_gp(points, SquaredExponential(0.2, 0.3), noise, solver="tiles")
    assert posterior is not None
    quick = posterior.sample(grid).variance, posterior.sample_slope_variance(grid)
    monkeypatch.setattr(tiles, "WORTH", 1e9)
    monkeypatch.setattr(tiles, "MOST_PRODUCTS", 20_000)
    direct = posterior.sample(grid).variance, posterior.sample_slope_variance(grid)
    for one, other in zip(quick, direct, strict=True):
        np.testing.assert_allclose(np.sqrt(one), np.sqrt(other), rtol=1e-3)


def test_sums_over_sparse_points_are_the_same_in_small_chunks() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 300, (700, 2))
    xy = xy[np.argsort(xy[:, 0])]
    x, y = (LatticeAxis.covering(0.0, 300.0, 0.5, 4.0) for _ in range(2))
    splat, values = Splat(xy, x, y, 0.8, 5.5), rng.normal(size=700)
    nodes = splat.to_nodes(values)
    for k in (0, 350, 699):
        single = Splat(xy[k : k + 1], x, y, 0.8, 5.5).to_points(nodes)[0]
        assert splat.to_points(nodes)[k] == pytest.approx(single, rel=1e-9)
    total = np.pi * 0.8**2 / 0.25 * values.sum()
    assert nodes.sum() == pytest.approx(total, rel=1e-6)


def test_thinned_grids_are_bounded() -> None:
    long = thin_grid(Grid((0.0, 0.0), 0.03, (5, 400_000)), 0.01)
    large = thin_grid(Grid((0.0, 0.0), 0.03, (3000, 3000)), 0.01)
    assert max(long.shape) <= MOST_SIDE
    assert large.num_cells <= 1_000_000
    assert thin_grid(Grid((0.0, 0.0), 0.03, (300, 300)), 0.01).resolution == 0.03
