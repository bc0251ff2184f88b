"""The synthetic ground has what its parameters say, where they say it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.terrain import (
    CLEARANCE,
    RESOLUTION,
    HeightField,
    fractal_field,
    make_terrain,
)
from tests.support.laws import examples

SIZE = 12.0
FLAT = SimulationParams(
    extent=SIZE, relief=0.0, crater_density=0.0, dune_height=0.0, rock_density=0.0
)
TRACK = np.column_stack([np.linspace(1.0, 11.0, 201), np.full(201, 6.0)])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_height_is_linear_between_cells_and_level_beyond() -> None:
    rows, columns = np.mgrid[:5, :9] * 0.5
    field = HeightField(2.0 * columns - 3.0 * rows, resolution=0.5)
    xy = rng().uniform([0.0, 0.0], [4.0, 2.0], (50, 2))
    np.testing.assert_allclose(field.height(xy), xy @ [2.0, -3.0], atol=1e-12)
    assert field.height(np.array([[-3.0, 0.0]]))[0] == field.height(np.array([[0.0, 0.0]]))[0]


@examples(10)
@given(persistence=st.floats(0.3, 1.4), seed=st.integers(0, 1000))
def test_a_fractal_is_standardised_and_follows_its_power_law(persistence: float, seed: int) -> None:
    field = fractal_field(600, persistence, rng(seed))
    assert field.mean() == pytest.approx(0.0, abs=1e-9)
    assert field.std() == pytest.approx(1.0)
    # Of H = 1 or more the increments grow with the lag itself: the ground is smooth.
    steps = [np.std(field[:, lag:] - field[:, :-lag]) for lag in (4, 8, 16)]
    growth = np.log2(steps[1] / steps[0]), np.log2(steps[2] / steps[1])
    np.testing.assert_allclose(growth, min(persistence, 0.95), atol=0.2)


def test_flat_params_give_flat_ground() -> None:
    assert not make_terrain(FLAT, TRACK, rng()).elevation.any()


def test_rocks_rise_beside_the_track_and_never_on_it() -> None:
    rocky = make_terrain(replace(FLAT, rock_density=3.0), TRACK, rng(1)).elevation
    assert rocky.min() == 0.0
    assert 0.1 < rocky.max() < 1.0
    assert 0.01 < np.mean(rocky > 0) < 0.4
    band = round((CLEARANCE - 0.3) / RESOLUTION)
    middle = round(6.0 / RESOLUTION)
    assert not rocky[middle - band : middle + band].any()


def test_small_rocks_are_many_and_large_ones_few() -> None:
    from scipy import ndimage  # noqa: PLC0415 - only this test counts rocks

    rocky = make_terrain(replace(FLAT, extent=40.0, rock_density=0.3), TRACK, rng(2)).elevation
    labels, count = ndimage.label(rocky > 0)
    across = np.sqrt(np.bincount(labels.ravel())[1:]) * RESOLUTION
    assert 200 < count < 700
    assert np.sum(across < 0.3) > 3 * np.sum(across > 0.5) > 0


def test_craters_are_bowls_with_raised_rims() -> None:
    cratered = make_terrain(replace(FLAT, crater_density=0.03), TRACK[:1], rng(3)).elevation
    assert cratered.min() < -0.1
    assert 0.01 < cratered.max() < -cratered.min()


def test_ripples_have_the_height_asked_for() -> None:
    low, high = (
        make_terrain(replace(FLAT, dune_height=height), TRACK, rng(4)).elevation
        for height in (0.1, 0.2)
    )
    np.testing.assert_allclose(high, 2.0 * low)
    assert 0.03 < np.ptp(low) < 0.4


def test_rough_ground_is_steeper_than_smooth_of_the_same_relief() -> None:
    slopes = []
    for roughness in (0.1, 0.4, 0.7):
        params = replace(FLAT, relief=0.3, roughness=roughness)
        ground = make_terrain(params, TRACK, rng(5)).elevation
        assert ground.std() == pytest.approx(0.3)
        slopes.append(np.std(np.diff(ground)) / RESOLUTION)
    assert slopes[0] < slopes[1] < slopes[2]


def test_hills_are_as_high_as_asked_and_smooth() -> None:
    params = replace(FLAT, extent=40.0, hill_height=2.0, hill_size=10.0)
    elevation = make_terrain(params, np.full((1, 2), -50.0), rng()).elevation
    assert elevation.std() == pytest.approx(2.0, rel=0.05)
    slope = np.hypot(*np.gradient(elevation, RESOLUTION))
    assert 0.5 < np.sqrt(np.mean(slope**2)) < 2.0
    # Steep, and without roughness: neighbouring slopes are nearly the same.
    along = np.diff(elevation, axis=1) / RESOLUTION
    assert np.abs(np.diff(along, axis=1)).max() < 0.2
