"""Submaps are found on a larger model of their ground, and nowhere else."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import load_dataset, write_dataset
from gpgrad_core.io.rasters import Elevations
from gpgrad_core.locating import (
    CELLS_A_SCALE,
    Located,
    Window,
    cut_windows,
    locate,
    merge_submaps,
    parameters_for,
    spread,
    width_of,
)
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import Dataset, Submap
from tests.support.frames import UTM, in_frame
from tests.support.refusal import assert_refused

CELL = 0.25
CORNER = (500_000.0, 4_100_000.0)


@cache
def ground(seed: int = 0) -> np.ndarray:
    """Rough ground of 44 m in cells of 5 cm; row 0 in the south."""
    chance = np.random.default_rng(seed)
    total = np.zeros((880, 880))
    for wave, height in ((8, 0.05), (20, 0.12), (60, 0.35)):
        rough = ndimage.gaussian_filter(chance.normal(size=total.shape), wave, mode="wrap")
        total += height * rough / rough.std()
    return total


@cache
def model(seed: int = 0) -> Elevations:
    """What is known of it from above: cells of 25 cm, an error of 2 cm, and a hole."""
    heights = ground(seed).reshape(176, 5, 176, 5).mean(axis=(1, 3))
    heights += np.random.default_rng(9).normal(0, 0.02, heights.shape) + 300.0
    heights[20:26, 30:50] = np.nan
    return Elevations(heights, (CELL, CELL), (CORNER[0] + CELL / 2, CORNER[1] + CELL / 2))


def submap(x: float, y: float, yaw: float, name: str = "query_1", seed: int = 0) -> Submap:
    """A disc of 5 m around a place of the ground, measured from there."""
    chance = np.random.default_rng(int(100 * x + y))
    radius, angle = 5.0 * np.sqrt(chance.uniform(size=6000)), chance.uniform(0, 7, 6000)
    local = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    world = SE2(x, y, yaw).apply(local)
    z = ndimage.map_coordinates(ground(seed), world[:, ::-1].T / 0.05 - 0.5, order=1)
    z += chance.normal(0, 0.02, len(z))
    pose = Pose.from_planar(SE2(x, y, yaw), 0.0)
    return Submap.from_points(np.column_stack([local, z]), name, pose_odometry=pose)


@cache
def searched() -> tuple[list[Window], tuple[PipelineParams, PipelineParams]]:
    windows = cut_windows(model(), 10.1)
    return windows, parameters_for([submap(12, 30, 2.0)], windows, CELL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("x", "y", "yaw", "frame"),
    [(12.0, 30.0, 2.0, SE2()), (33.3, 9.2, -0.7, SE2()), (12.0, 30.0, 2.0, UTM)],
    ids=["", "elsewhere", "in a far frame"],
)
def test_a_submap_is_found_where_it_is(x: float, y: float, yaw: float, frame: SE2) -> None:
    windows, params = searched()
    seen = submap(x, y, yaw)
    (given,) = in_frame(Dataset("seen", (seen,)), frame).submaps
    (place,) = locate([given], windows, params)
    assert place.verdict.accepted
    true = seen.pose_odometry.apply(seen.points) + np.array([*CORNER, 300.0])
    off = place.pose.apply(given.points) - true
    east, north, height = off.mean(axis=0)
    assert np.hypot(east, north) < 0.1
    assert height == pytest.approx(0.0, abs=0.05)
    assert np.hypot(*off[:, :2].T).max() < 0.2
    assert np.hypot(east, north) < 4 * spread(place).max() < 0.4
    assert 0 <= place.runner_up < place.verdict.registration.score


@pytest.mark.slow
def test_other_ground_is_not_found() -> None:
    windows, params = searched()
    (place,) = locate([submap(20, 20, 0.3, seed=1)], windows, params)
    assert not place.verdict.accepted


@pytest.mark.slow
def test_the_score_pays_for_the_number_of_places() -> None:
    windows, params = searched()
    query = submap(12, 30, 2.0)
    (best,) = locate([query], windows, params)
    (name,) = {best.verdict.database_id}
    alone = [one for one in windows if one.name == name]
    (single,) = locate([query], alone, params)
    paid = single.verdict.registration.score - best.verdict.registration.score
    assert paid == pytest.approx(np.log10(len(windows)))


@pytest.mark.slow
def test_one_scale_that_both_resolve() -> None:
    windows, (of_query, of_model) = searched()
    assert of_query.map.scale == of_model.map.scale
    assert (of_query.map.scale or 0.0) >= CELLS_A_SCALE * CELL
    assert of_model.map.noise_std == pytest.approx(0.02, rel=0.5)
    given = parameters_for([submap(12, 30, 2.0)], windows, CELL, noise_std=0.1)
    assert given[1].map.noise_std == 0.1
    assert given[0].map.noise_std != 0.1


@given(st.integers(20, 90), st.integers(20, 90), st.floats(3, 20), st.floats(0, 1), st.floats(0, 1))
def test_whatever_is_as_wide_lies_in_a_window(
    rows: int, columns: int, width: float, right: float, up: float
) -> None:
    whole = Elevations(np.zeros((rows, columns)), (0.25, 0.5))
    inside = np.array([columns * 0.25 - width, rows * 0.5 - width])
    low = np.maximum(inside, 0) * [right, up] - [0.125, 0.25]
    high = low + np.minimum(width, [columns * 0.25, rows * 0.5])
    for window in cut_windows(whole, width):
        half = 0.5 * np.array(window.heights.shape[::-1]) * window.cell
        if np.all(low >= window.middle - half - 1e-9) and np.all(
            high <= window.middle + half + 1e-9
        ):
            return
    raise AssertionError


def test_windows_near_a_place() -> None:
    every, some = (cut_windows(model(), 10.1, near) for near in (None, (*CORNER, 2.0)))
    assert [one.name for one in some] == ["0,0"]
    assert len(every) == 16
    with pytest.raises(InputError, match=r"no 100 heights together within 2 m of 0, 0"):
        cut_windows(model(), 10.1, (0.0, 0.0, 2.0))
    with pytest.raises(InputError, match=r"windows of 1 m to search.*--near E,N,RADIUS"):
        cut_windows(Elevations(np.zeros((2000, 2000)), (0.05, 0.05)), 0.5)


def test_a_window_gives_its_heights_where_they_are() -> None:
    window = cut_windows(model(), 10.1)[0]
    points = window.load().points
    assert len(points) == np.isfinite(window.heights).sum()
    column, row = np.round((points[7, :2] + window.middle - model().corner) / CELL).astype(int)
    assert model().heights[row, column] == pytest.approx(points[7, 2])


@pytest.mark.slow
def test_merged_submaps_lie_as_their_poses_say(tmp_path: Path) -> None:
    some = [submap(12, 30, 2.0, "a_1"), submap(17, 28, 0.5, "a_2")]
    poses = [one.pose_odometry for one in some if one.pose_odometry is not None]
    merged = merge_submaps(some, poses, 0.1)
    assert width_of(merged) == pytest.approx(10 + np.hypot(5, 2), rel=0.1)
    windows, _ = searched()
    params = parameters_for([merged], windows, CELL)
    (place,) = locate([merged], windows, params)
    assert place.verdict.accepted
    np.testing.assert_allclose(place.pose.translation[:2] - CORNER, [12, 30], atol=0.1)
    drive = Dataset("drive", (merged,))
    located = Located(drive, model(), "dem", [merged], windows, [place], params)
    write_dataset(located.shown(), tmp_path / "shown")
    assert [one.id for one in load_dataset(tmp_path / "shown").submaps] == ["merged_000", "map_001"]


@pytest.mark.slow
def test_the_places_are_shown_as_a_dataset(tmp_path: Path) -> None:
    windows, params = searched()
    some = [submap(12, 30, 2.0, "a_1"), submap(20, 20, 0.3, "a_2", seed=1)]
    places = locate(some, windows, params)
    drive = Dataset("drive", tuple(some))
    located = Located(drive, model(), "dem.tif", some, windows, places, params)
    write_dataset(located.shown(), tmp_path / "shown")
    read = load_dataset(tmp_path / "shown")
    assert [one.id for one in read.submaps] == ["a_1", "map_002"]
    query, around = read.submaps
    onto = around.pose_odometry.inverse() @ query.pose_odometry
    # The submap lies on the model there.
    xyz = onto.apply(query.points)
    near = np.linalg.norm(around.points[:, None, :2] - xyz[None, ::500, :2], axis=2).argmin(axis=0)
    assert np.median(np.abs(around.points[near, 2] - xyz[::500, 2])) < 0.1
    assert read.preferred["query"] == "a_1"


@pytest.mark.slow
def test_too_little_noise_of_the_model_names_the_flag_that_helps() -> None:
    steep = Elevations(1e4 * model().heights[:40, 50:100], (CELL, CELL))
    query = submap(15.0, 5.0, 0.0)
    windows = cut_windows(steep, width_of(query))
    params = parameters_for([query], windows, CELL, noise_std=0.0005)
    assert_refused(lambda: locate([query], windows, params), "the model's noise (--map-noise")
