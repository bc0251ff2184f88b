"""Fits to single submaps of real terrain: how fast, how good.

Fits to several submaps at once are judged by the calibration.
"""

import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.evaluation.calibration import judge_errors
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.fitting import fit_parameters
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.types import Submap

MOST_SECONDS = 5.0
FEWEST_BETTER = 0.75
"""Share of the submaps whose unseen points are told better after the fit."""


def log_density(seen: Submap, unseen: np.ndarray, params: MapParams) -> float:
    """Mean log predictive density of unseen heights, noise included."""
    made = infer_gradient_map(seen, params)
    column, row = made.grid.to_pixel(unseen[:, :2]).T
    elevation, variance = (
        map_coordinates(image, [row, column], order=1, mode="nearest")
        for image in (made.elevation, made.variance)
    )
    std = np.sqrt(variance + params.noise_std**2)
    return -judge_errors("", unseen[:, 2] - elevation, std, params).density


@pytest.mark.parametrize("name", ["marsyard2021", "sthelens", "apollo15"])
def test_a_fit_is_quick_and_tells_unseen_points_better(name: str, real_data: Path) -> None:
    start = MapParams()
    before, after = list[float](), list[float]()
    for submap in load_dataset(real_data / name).submaps[1::5]:
        held_out = np.random.default_rng(1).uniform(size=len(submap.points)) < 0.1
        seen = Submap.from_points(submap.points[~held_out], submap.id)
        begun, cpu = time.perf_counter(), time.process_time()
        found = fit_parameters([seen], start.guessed.terrain)
        seconds, cpu = time.perf_counter() - begun, time.process_time() - cpu
        fitted = replace(
            start, **{one.name: getattr(found.params, one.name) for one in fields(found.params)}
        )
        before.append(log_density(seen, submap.points[held_out], start))
        after.append(log_density(seen, submap.points[held_out], fitted))
        print(
            f"{name} {submap.id}: length-scale {fitted.length_scale:.3f} m, signal "
            f"{fitted.signal_std:.3f} m, noise {fitted.noise_std:.4f} m; {seconds:.1f} s "
            f"({cpu:.1f} s of CPU, {found.num_evaluations} evaluations); log density of unseen "
            f"points {before[-1]:.3f} -> {after[-1]:.3f}"
        )
        assert seconds <= MOST_SECONDS
    print(f"{name}: {np.mean(before):.3f} -> {np.mean(after):.3f}")
    assert np.mean(after) > np.mean(before)
    assert np.mean(np.array(after) > before) >= FEWEST_BETTER
