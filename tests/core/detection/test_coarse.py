from dataclasses import replace

import numpy as np
import pytest

from gpgrad_core.detection import PipelineParams, infer_map
from gpgrad_core.detection.pipeline import COARSER, infer_coarse_map, infer_quick_map, thin_evenly
from gpgrad_core.mapping.gradient_map import MapParams, fit_terrain, sample_map
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Submap
from tests.support.ground import Ground

PARAMS = MapParams(length_scale=0.3, noise_std=0.05, resolution=0.1)


def ground(num_points: int = 4000, side: float = 6.0) -> Submap:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, side, (num_points, 2))
    z = Ground.random(1).height(xy) + rng.normal(0, 0.05, num_points)
    return Submap.from_points(np.column_stack([xy, z]))


SUBMAP = ground()


@pytest.mark.parametrize("noise_std", [0.02, 0.1, 0.2])
def test_it_is_the_same_trusted_terrain_with_larger_cells(noise_std: float) -> None:
    params = replace(PARAMS, noise_std=noise_std)
    coarse = infer_coarse_map(SUBMAP, params, Memo())
    full = sample_map(SUBMAP, fit_terrain(SUBMAP, params.terrain), COARSER * params.resolution)
    assert coarse.grid == full.grid
    error = (coarse.elevation - full.elevation)[full.trusted(0.3)]
    assert np.sqrt(np.mean(error**2)) < 0.5 * noise_std
    assert coarse.signal_std == full.signal_std
    both = coarse.trusted(0.3) & full.trusted(0.3)
    assert both.sum() > 0.9 * (coarse.trusted(0.3) | full.trusted(0.3)).sum() > 0


def test_it_is_made_of_fewer_points_that_lie_as_wide() -> None:
    thinned = thin_evenly(SUBMAP, PARAMS.terrain)
    assert len(thinned.points) < 0.6 * len(SUBMAP.points)
    np.testing.assert_allclose(np.ptp(thinned.points[:, :2], axis=0), 6.0, atol=0.3)
    assert thinned.fingerprint != SUBMAP.fingerprint
    assert len(thin_evenly(SUBMAP, replace(PARAMS.terrain, max_points=100)).points) <= 100


def test_a_fit_that_is_there_already_is_sampled_and_not_thinned() -> None:
    memo = Memo()
    infer_map(SUBMAP, PipelineParams(map=PARAMS), memo)
    coarse = infer_coarse_map(SUBMAP, PARAMS, memo)
    full = sample_map(SUBMAP, fit_terrain(SUBMAP, PARAMS.terrain), COARSER * PARAMS.resolution)
    np.testing.assert_array_equal(coarse.elevation, full.elevation)


def test_the_quick_map_is_the_full_one_if_that_is_there() -> None:
    memo = Memo()
    assert infer_quick_map(SUBMAP, PARAMS, memo).grid.resolution == COARSER * PARAMS.resolution
    full = infer_map(SUBMAP, PipelineParams(map=PARAMS), memo)
    assert infer_quick_map(SUBMAP, PARAMS, memo) is full
    finer = replace(PARAMS, resolution=0.05)
    assert infer_quick_map(SUBMAP, finer, memo).grid.resolution == COARSER * finer.resolution


def test_flat_ground_has_a_coarse_map_too() -> None:
    flat = SUBMAP.points * np.array([1.0, 1.0, 0.0])
    coarse = infer_coarse_map(Submap.from_points(flat), PARAMS, Memo())
    np.testing.assert_allclose(coarse.elevation, 0.0, atol=1e-9)
