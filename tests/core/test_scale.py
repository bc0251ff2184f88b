"""The scale of comparison: what points resolve."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.scale import (
    finest_of_kernel,
    noise_density,
    resolved_scale,
    rounded_scale,
    std_at_scale,
)
from gpgrad_core.types import Submap
from tests.support.ground import Ground, scatter

positive = st.floats(1e-3, 1e3)


@given(density=st.floats(1e-9, 1e-2), slope=st.floats(0.01, 2.0), area=st.floats(1.0, 1e4))
def test_noise_and_sparse_points_coarsen_it_and_relief_refines_it(
    density: float, slope: float, area: float
) -> None:
    scale = resolved_scale(density, slope, area)
    assert math.sqrt(area) / 60 <= scale <= math.sqrt(area) / 8
    assert resolved_scale(2 * density, slope, area) >= scale
    assert resolved_scale(density, 2 * slope, area) <= scale


@given(factor=positive)
def test_it_grows_with_the_whole_scene(factor: float) -> None:
    """A scene of another size, with slopes, and points in it, as they were."""
    scale = resolved_scale(1e-4, 0.3, 120.0)
    grown = resolved_scale(1e-4 * factor**4, 0.3, 120.0 * factor**2)
    assert grown == pytest.approx(factor * scale)


def test_smooth_ground_holds_nothing_below_the_scale_at_which_noise_takes_over() -> None:
    density, signal, length = 1e-5, 0.5, 1.8
    scale = finest_of_kernel(density, signal, length)
    power = 2 * math.pi * (signal * length) ** 2 * math.exp(-0.5 * (length / scale) ** 2)
    assert power == pytest.approx(density)
    assert finest_of_kernel(0.0, signal, length) < scale


@given(scale=positive)
def test_rounding_moves_it_by_a_fifth_at_most(scale: float) -> None:
    assert abs(math.log(rounded_scale(scale) / scale)) <= math.log(2) / 4 + 1e-9


def test_heights_change_by_the_slope_and_by_the_signal_at_the_most() -> None:
    kernel = SquaredExponential(0.3, 1.2)
    assert std_at_scale(0.3, 1.2, 0.2) == pytest.approx(0.2 * kernel.slope_std)
    assert std_at_scale(0.3, 1.2, 5.0) == 0.3


@given(density=st.floats(1e-8, 1e-1), signal=st.floats(0.05, 2.0), length=st.floats(0.1, 3.0))
def test_the_density_of_noise_comes_back_from_the_variance(
    density: float, signal: float, length: float
) -> None:
    strongest = 2 * math.pi * (signal * length) ** 2
    variance = density / (2 * math.pi * length**2) * math.log1p(strongest / density)
    found = noise_density(np.array([variance]), signal, length)[0]
    assert found == pytest.approx(density, rel=0.05)


@pytest.mark.parametrize("length_scale", [0.3, 0.6])
def test_a_map_alone_tells_the_scale_by_its_points_whatever_its_kernel(length_scale: float) -> None:
    ground = Ground.random(3, shortest=1.5)
    xy = scatter(3, 4000, (8.0, 8.0))
    rng = np.random.default_rng(3)
    scales: list[float] = []
    for rows, noise in ((slice(None), 0.02), (slice(0, 400), 0.02), (slice(0, 400), 0.1)):
        z = ground.height(xy[rows]) + noise * rng.standard_normal(len(xy[rows]))
        submap = Submap.from_points(np.column_stack([xy[rows], z]))
        params = MapParams(length_scale=length_scale, noise_std=noise, resolution=0.1)
        scales.append(infer_gradient_map(submap, params).scale)
    assert scales[0] < scales[1] < scales[2]
    told = MapParams(length_scale=length_scale, noise_std=0.05, scale=0.4, resolution=0.1)
    assert infer_gradient_map(submap, told).scale == 0.4
