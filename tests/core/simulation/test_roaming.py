"""The world without an end: seamless ground, returns of every age, the same files by any way."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.simulation.endless_terrain import EndlessGround, Fractal
from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.recording import simulate_recording
from gpgrad_core.simulation.routes import drive_lanes, plan_track
from gpgrad_core.simulation.simulate import simulate_dataset, simulate_into
from gpgrad_core.simulation.terrain import RESOLUTION
from tests.core.simulation.test_simulate import ROAMING
from tests.support.laws import examples

GROUND = EndlessGround(
    replace(ROAMING, hill_height=1.0, hill_size=30.0), np.array([[0.0, 0.0], [20.0, 0.0]])
)


@pytest.mark.slow
@examples(4)
@given(
    st.tuples(*[st.floats(-20, 20)] * 2),
    st.tuples(*[st.floats(0, 3)] * 2),
    st.tuples(*[st.floats(4, 6)] * 2),
)
def test_windows_agree_where_they_overlap(low, shift, size) -> None:  # noqa: ANN001
    first = np.array(low)
    second = first + shift
    one, other = (GROUND.window(corner, corner + size) for corner in (first, second))
    inside = np.random.default_rng(0).uniform(second, first + size, (500, 2))
    np.testing.assert_allclose(one.height(inside), other.height(inside), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("largest", "coarseness"), [(16.0, 2), (5.0, 4), (40.0, 16)])
def test_a_field_varies_as_much_everywhere(largest: float, coarseness: int) -> None:
    field = Fractal(3, 1, 1.2, largest, coarseness)
    length, width = round(12 * largest / RESOLUTION), round(2 * largest / RESOLUTION)
    coarse = field.window((-length // 2, -width // 2), (width, length))[::coarseness, ::coarseness]
    assert coarse.std() == pytest.approx(1.0, abs=0.3)
    assert coarse.mean() == pytest.approx(0.0, abs=0.5)
    # As rough on the seams between patches as within them.
    steps = np.diff(coarse, axis=1).std(axis=0)
    assert steps.max() < 3.0 * np.median(steps)


def test_the_rover_comes_back_after_short_and_after_long() -> None:
    xy = drive_lanes(10_000.0, 1.0, 7.0, 1.0, np.random.default_rng(1))
    assert np.hypot(*np.diff(xy, axis=0).T).sum() > 10_000
    near = np.hypot(*(xy[::5, None] - xy[None, ::5]).transpose(2, 0, 1)) < 3.0
    i, j = np.nonzero(np.triu(near, 20))
    ages = 5 * (j - i)
    assert len(np.unique(j)) > 0.1 * len(xy[::5])
    assert ages.min() < 600
    assert ages.max() > 5_000
    assert np.median(ages) > 300


def test_lanes_are_as_far_apart_as_the_sensor_needs() -> None:
    xy = drive_lanes(3_000.0, 1.0, 30.0, 0.0, np.random.default_rng(1))
    on_a_lane = np.isclose(xy % 120.0, 0.0, atol=1e-6) | np.isclose(xy % 120.0, 120.0, atol=1e-6)
    assert on_a_lane.any(axis=1).mean() > 0.7


def test_the_drive_is_long_enough_for_all_submaps() -> None:
    for count in (1, 12, 500):
        assert plan_track(replace(ROAMING, num_submaps=count)).length > count * ROAMING.spacing


def files_of(folder: Path) -> dict[str, bytes]:
    files = (file for file in folder.rglob("*") if file.is_file())
    return {str(file.relative_to(folder)): file.read_bytes() for file in files}


@pytest.mark.parametrize(
    "params",
    [
        SimulationParams(num_submaps=2, extent=20.0, sensor="airborne", max_range=4.0),
        pytest.param(ROAMING, marks=pytest.mark.slow),
    ],
    ids=["a route with an end", "roaming"],
)
def test_a_folder_is_the_same_whoever_writes_it(params: SimulationParams, tmp_path: Path) -> None:
    dataset = simulate_dataset(params)
    write_dataset(dataset, tmp_path / "memory")
    simulate_into(tmp_path / "alone", params)
    assert files_of(tmp_path / "alone") == files_of(tmp_path / "memory")
    read = load_dataset(tmp_path / "alone").submaps  # no digit is lost
    assert [one.fingerprint for one in read] == [one.fingerprint for one in dataset.submaps]
    if params is ROAMING:
        with ProcessPoolExecutor(2, get_context("spawn")) as executor:
            simulate_into(tmp_path / "beside", params, executor=executor)
        assert files_of(tmp_path / "beside") == files_of(tmp_path / "alone")


def test_what_cannot_be_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="not empty"):
        simulate_into(tmp_path / "full", ROAMING)
    with pytest.raises(InputError, match="or take the route 'roaming'"):
        simulate_into(tmp_path / "new", SimulationParams(num_submaps=5000))
    with pytest.raises(InputError, match="route roaming makes submaps, not scans"):
        simulate_recording(tmp_path / "new", 5, ROAMING)
    assert not (tmp_path / "new").exists()
