"""The ground has what its parameters say; rows are alike, differ, fork and end as much as asked."""

from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from gpgrad_core.simulation.endless_terrain import EndlessGround
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.simulation.terrain import (
    CLEARANCE,
    HILL_PERSISTENCE,
    RESOLUTION,
    ROWS,
    ElevationModel,
    HeightField,
    fractal_field,
    make_terrain,
    params_on,
    row_heights,
)
from tests.support.laws import examples
from tests.support.refusal import assert_refused

SIZE = 12.0
FLAT = SimulationParams(
    extent=SIZE, relief=0.0, crater_density=0.0, dune_height=0.0, rock_density=0.0
)
NOWHERE = np.full((1, 2), -50.0)
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


def test_rocks_rise_beside_the_track_and_never_on_it() -> None:
    rocky = make_terrain(replace(FLAT, rock_density=3.0), TRACK, rng(1)).elevation
    assert rocky.min() == 0.0
    assert 0.1 < rocky.max() < 1.0
    assert 0.01 < np.mean(rocky > 0) < 0.4
    band = round((CLEARANCE - 0.3) / RESOLUTION)
    middle = round(6.0 / RESOLUTION)
    assert not rocky[middle - band : middle + band].any()


def test_small_rocks_are_many_and_large_ones_few() -> None:
    rocky = make_terrain(replace(FLAT, extent=30.0, rock_density=0.3), TRACK, rng(2)).elevation
    labels, count = ndimage.label(rocky > 0)
    across = np.sqrt(np.bincount(labels.ravel())[1:]) * RESOLUTION
    assert 120 < count < 400
    assert np.sum(across < 0.3) > 3 * np.sum(across > 0.5) > 0


def test_craters_are_bowls_with_raised_rims() -> None:
    cratered = make_terrain(replace(FLAT, crater_density=0.03), TRACK[:1], rng(3)).elevation
    assert cratered.min() < -0.1
    assert 0.01 < cratered.max() < -cratered.min()


@pytest.mark.parametrize(
    ("params", "name", "height", "least", "most"),
    [
        (FLAT, "dune_height", 0.1, 0.03, 0.4),
        (params_on("spurs", extent=SIZE), "row_height", 1.0, 0.6, 1.6),
    ],
    ids=["ripples", "rows"],
)
def test_ripples_and_rows_are_added_to_the_relief_as_high_as_asked(
    params: SimulationParams, name: str, height: float, least: float, most: float
) -> None:
    flat, low, high = (
        make_terrain(replace(params, **{name: times * height}), NOWHERE, rng(4)).elevation
        for times in (0, 1, 2)
    )
    assert flat.std() == pytest.approx(params.relief)
    np.testing.assert_allclose(high - flat, 2.0 * (low - flat), atol=1e-12)
    assert least < np.ptp(low - flat) < most


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
    elevation = make_terrain(params, NOWHERE, rng()).elevation
    assert elevation.std() == pytest.approx(2.0, rel=0.05)
    slope = np.hypot(*np.gradient(elevation, RESOLUTION))
    assert 0.5 < np.sqrt(np.mean(slope**2)) < 2.0
    # Steep, and without roughness: neighbouring slopes are nearly the same.
    along = np.diff(elevation, axis=1) / RESOLUTION
    assert np.abs(np.diff(along, axis=1)).max() < 0.2


def made(ground: str, **changes: object) -> tuple[SimulationParams, HeightField]:
    """Make thirty rows, with cells of a twentieth of a row."""
    params = params_on(ground, **changes)
    cell, rng = params.row_spacing / 20, np.random.default_rng(1)
    largest = ROWS[ground].reach * params.row_spacing
    first, second = (fractal_field(600, HILL_PERSISTENCE, rng, largest, cell) for _ in range(2))
    along = cell * np.arange(600)
    return params, HeightField(row_heights(params, along, along, first, second), resolution=cell)


def from_row_to_row(params: SimulationParams, terrain: HeightField) -> float:
    """Root mean square of how much heights one row apart differ [m]."""
    at = params.row_spacing * np.random.default_rng(2).uniform(2.0, 28.0, (4000, 2))
    step = params.row_spacing * np.array([np.cos(params.row_heading), np.sin(params.row_heading)])
    return float(np.sqrt(np.mean((terrain.height(at + step) - terrain.height(at)) ** 2)))


def test_every_kind_is_offered() -> None:
    offered = get_args(get_args(get_type_hints(SimulationParams, include_extras=True)["ground"])[0])
    assert set(offered) == {"varied", *ROWS}
    assert params_on("varied") == SimulationParams()


@pytest.mark.parametrize("ground", ROWS)
def test_rows_are_as_high_and_as_much_alike_as_asked(ground: str) -> None:
    differences: list[float] = []
    for variety in (0.0, 0.1, 0.4):
        params, terrain = made(ground, row_variety=variety)
        differences.append(from_row_to_row(params, terrain) / params.row_height)
        assert 0.6 < np.ptp(terrain.elevation) / params.row_height < 1.3
    # The ground's cells are not whole parts of a row.
    assert differences[0] < 0.5 * differences[1]
    assert 0.005 < differences[1] < 0.5 * differences[2]


@pytest.mark.parametrize("ground", ROWS)
def test_only_rows_of_much_variety_fork_and_end(ground: str) -> None:
    def crests(variety: float) -> set[int]:
        _, terrain = made(ground, row_variety=variety, row_heading=0.0)
        return {int(np.sum(np.diff(np.sign(row)) > 0)) for row in terrain.elevation[::20]}

    assert len(crests(0.0)) == 1
    assert len(crests(0.6)) > 2


def test_rows_without_an_end_go_on_from_window_to_window() -> None:
    params = params_on("spurs", route="roaming", row_variety=0.3)
    ground = EndlessGround(params, NOWHERE)
    first, second = np.array([-8.0, 3.0]), np.array([-6.5, 4.0])
    windows = [ground.window(low, low + 6.0) for low in (first, second)]
    inside = np.random.default_rng(0).uniform(second, first + 6.0, (500, 2))
    np.testing.assert_allclose(*(window.height(inside) for window in windows), atol=1e-9)
    alike = replace(params, row_variety=0.0, relief=0.0, row_spacing=0.6)
    endless = EndlessGround(alike, NOWHERE).window(np.zeros(2), np.full(2, 18.0))
    assert from_row_to_row(alike, endless) < 0.01 * alike.row_height


def test_rows_are_not_laid_on_an_elevation_model() -> None:
    assert_refused(
        lambda: simulate_dataset(
            params_on("dunes", num_submaps=1), terrain=ElevationModel(Path("dem.tif"))
        ),
        "dem.tif: the ground 'dunes' is made",
    )
