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
from tests.support.laws import examples

PARAMS = SimulationParams(
    seed=5,
    route="roaming",
    num_submaps=12,
    sensor="airborne",
    scan_density=30.0,
    max_range=4.0,
    rock_density=0.5,
)
GROUND = EndlessGround(
    replace(PARAMS, hill_height=1.0, hill_size=30.0), np.array([[0.0, 0.0], [20.0, 0.0]])
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


def test_another_seed_is_another_ground() -> None:
    first, other = (
        EndlessGround(replace(GROUND.params, seed=seed), GROUND.track).window(
            np.zeros(2), np.full(2, 2.0)
        )
        for seed in (5, 6)
    )
    assert np.abs(first.elevation - other.elevation).max() > 0.1


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
        assert plan_track(replace(PARAMS, num_submaps=count)).length > count * PARAMS.spacing


@pytest.mark.slow
def test_revisits_show_the_same_ground() -> None:
    dataset = simulate_dataset(replace(PARAMS, num_submaps=40))
    poses = [submap.pose_true for submap in dataset.submaps]
    places = np.array([pose.translation[:2] for pose in poses if pose is not None])
    apart = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    i, j = np.nonzero((apart < 2.0) & (np.subtract.outer(range(40), range(40)) > 3))
    assert len(i) > 0, "the seed has no revisit: choose another"
    cells: list[dict[tuple[int, int], float]] = []
    for k in (i[0], j[0]):
        pose = poses[k]
        world = dataset.submaps[k].points @ pose.rotation.T + pose.translation
        cells.append({(int(x // 0.1), int(y // 0.1)): z for x, y, z in world})
    common = cells[0].keys() & cells[1].keys()
    assert len(common) > 20
    differences = [abs(cells[0][key] - cells[1][key]) for key in common]
    assert np.median(differences) < 0.05


@pytest.mark.slow
def test_a_folder_is_the_same_whoever_writes_it(tmp_path: Path) -> None:
    write_dataset(simulate_dataset(PARAMS), tmp_path / "memory")
    simulate_into(tmp_path / "alone", PARAMS)
    with ProcessPoolExecutor(2, get_context("spawn")) as executor:
        simulate_into(tmp_path / "beside", PARAMS, executor=executor)
    contents = [
        {
            str(file.relative_to(tmp_path / way)): file.read_bytes()
            for file in (tmp_path / way).rglob("*")
            if file.is_file()
        }
        for way in ("memory", "alone", "beside")
    ]
    assert contents[0] == contents[1] == contents[2]
    assert len(load_dataset(tmp_path / "beside").submaps) == 12


def test_a_route_with_an_end_is_written_the_same(tmp_path: Path) -> None:
    params = SimulationParams(num_submaps=2, extent=20.0, sensor="airborne", max_range=4.0)
    dataset = simulate_dataset(params)
    write_dataset(dataset, tmp_path / "memory")
    simulate_into(tmp_path / "alone", params)
    for file in (tmp_path / "memory").rglob("*.*"):
        other = tmp_path / "alone" / file.relative_to(tmp_path / "memory")
        assert file.read_bytes() == other.read_bytes()
    read = load_dataset(tmp_path / "alone").submaps  # no digit is lost
    assert [one.fingerprint for one in read] == [one.fingerprint for one in dataset.submaps]


def test_what_cannot_be_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("x")
    with pytest.raises(InputError, match="not empty"):
        simulate_into(tmp_path / "full", PARAMS)
    with pytest.raises(InputError, match="or take the route 'roaming'"):
        simulate_into(tmp_path / "new", SimulationParams(num_submaps=5000))
    with pytest.raises(InputError, match="route roaming makes submaps, not scans"):
        simulate_recording(tmp_path / "new", 5, PARAMS)
    assert not (tmp_path / "new").exists()
