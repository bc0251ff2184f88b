"""Rows repeat as exactly as asked, and differ, fork and end as much as asked."""

from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest

from gpgrad_core.simulation.endless_terrain import EndlessGround
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.simulation.terrain import (
    HILL_PERSISTENCE,
    ROWS,
    ElevationModel,
    HeightField,
    fractal_field,
    make_terrain,
    params_on,
    row_heights,
)
from tests.support.refusal import assert_refused

NOWHERE = np.full((1, 2), -50.0)


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


def test_the_same_seed_makes_the_same_rows_and_another_does_not() -> None:
    params = params_on("dunes", num_submaps=1, spacing=1.0, extent=30.0, max_range=3.0)
    first, second, other = (
        simulate_dataset(replace(params, seed=seed)).submaps[0].fingerprint for seed in (1, 1, 2)
    )
    assert first == second
    assert first != other


def test_rows_are_added_to_the_relief() -> None:
    params = params_on("spurs", extent=12.0)
    grounds = [
        make_terrain(replace(params, row_height=height), NOWHERE, np.random.default_rng(3))
        for height in (0.0, 1.0, 2.0)
    ]
    flat, low, high = (ground.elevation for ground in grounds)
    assert flat.std() == pytest.approx(params.relief)
    np.testing.assert_allclose(high - flat, 2.0 * (low - flat), atol=1e-12)
    assert np.ptp(low - flat) > 0.6


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
