"""A simulated dataset is reproducible, true to its own truth, and drifts."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.simulation.params import SimulationParams
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.simulation.terrain import params_on
from gpgrad_core.types import Dataset, Submap

SMALL = SimulationParams(
    seed=5, num_submaps=6, route="winding", extent=20.0, spacing=3.0, max_range=5.0
)
ROWS = params_on("dunes", seed=5, num_submaps=6, extent=16.0, spacing=1.0, max_range=3.0)
ROAMING = SimulationParams(
    seed=5,
    route="roaming",
    num_submaps=12,
    sensor="airborne",
    scan_density=30.0,
    max_range=4.0,
    rock_density=0.5,
)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return simulate_dataset(SMALL)


def in_world(dataset: Dataset) -> list[bytes]:
    """The bits of every submap and its poses."""
    poses = [pose for s in dataset.submaps for pose in (s.pose_true, s.pose_odometry)]
    numbers = [number for pose in poses for number in (pose.translation, pose.quaternion)]
    return [one.tobytes() for one in (*(s.points for s in dataset.submaps), *numbers)]


@pytest.mark.parametrize("params", [SMALL, ROWS, ROAMING], ids=["varied", "rows", "roaming"])
def test_the_seed_makes_the_dataset_to_the_bit(params: SimulationParams) -> None:
    few = replace(params, num_submaps=2, max_points=2000)
    first, again, other = (simulate_dataset(replace(few, seed=seed)) for seed in (5, 5, 6))
    assert in_world(first) == in_world(again)
    assert first.submaps[0].fingerprint != other.submaps[0].fingerprint


def cell_heights(submap: Submap) -> dict[tuple[int, int], float]:
    """Mean height of every 10 cm cell of the world that the submap says it saw."""
    world = submap.pose_true.apply(submap.points)
    keys, owner = np.unique(np.floor(world[:, :2] / 0.1).astype(int), axis=0, return_inverse=True)
    means = np.bincount(owner, world[:, 2]) / np.bincount(owner)
    return {(int(x), int(y)): float(z) for (x, y), z in zip(keys, means, strict=True)}


@pytest.mark.parametrize(
    ("params", "apart", "cells", "pairs"),
    [
        (SMALL, 1, 500, 6),
        pytest.param(replace(ROAMING, num_submaps=40), 4, 20, 1, marks=pytest.mark.slow),
    ],
    ids=["varied", "roaming"],
)
def test_truth_aligns_every_pair_that_overlaps(
    params: SimulationParams, apart: int, cells: int, pairs: int
) -> None:
    heights = [cell_heights(submap) for submap in simulate_dataset(params).submaps]
    differences = [
        [abs(one[cell] - earlier[cell]) for cell in one.keys() & earlier.keys()]
        for k, one in enumerate(heights)
        for earlier in heights[: max(k + 1 - apart, 0)]
    ]
    overlapping = [np.median(each) for each in differences if len(each) >= cells]
    assert len(overlapping) >= pairs
    assert max(overlapping) < 0.05


def test_the_way_back_sees_the_same_ground_from_the_other_side(dataset: Dataset) -> None:
    yaws = [submap.pose_true.planar.yaw for submap in dataset.submaps]
    opposite = np.cos([yaws[3] - yaws[2], yaws[4] - yaws[1], yaws[5] - yaws[0]])
    assert opposite.max() < -0.5
    first, last = cell_heights(dataset.submaps[0]), cell_heights(dataset.submaps[4])
    assert len(first.keys() & last.keys()) > 0.3 * min(len(first), len(last))


def test_submaps_are_as_promised(dataset: Dataset) -> None:
    assert [submap.id for submap in dataset.submaps] == [f"{k:03d}" for k in range(6)]
    assert dataset.sensor_noise == {
        "constant": SMALL.noise_constant,
        "quadratic": SMALL.noise_quadratic,
    }
    for submap in dataset.submaps:
        assert 10_000 < len(submap.points) <= SMALL.max_points
        x, y, z = submap.points.T
        # The rover looks ahead: the origin is under its first stop, x along the heading.
        assert -0.5 < x.min() < 1.0
        assert x.max() < SMALL.spacing + SMALL.max_range + 1.0
        assert np.abs(y).max() < SMALL.max_range + 1.0
        # The origin lies on the ground: the nearest points are no higher than a slope explains.
        distance = np.hypot(x, y)
        near = np.argsort(distance)[:50]
        assert np.all(np.abs(z[near]) < 0.1 + 0.6 * distance[near])
        np.testing.assert_array_equal(submap.points, np.float32(submap.points))
        np.testing.assert_allclose(
            1000 * submap.points % 1, np.round(1000 * submap.points % 1), atol=2e-3
        )


def test_voxels_hold_one_point_each() -> None:
    params = replace(SMALL, num_submaps=1, voxel_size=0.2, max_points=1_000_000)
    points = simulate_dataset(params).submaps[0].points
    cells = np.floor(points / params.voxel_size)
    # Rounding to a millimetre moves a few means across a face.
    assert len(np.unique(cells, axis=0)) > 0.98 * len(points)


def test_odometry_drifts_and_exact_odometry_does_not(dataset: Dataset) -> None:
    def errors(made: Dataset) -> list[float]:
        poses = [(submap.pose_odometry, submap.pose_true) for submap in made.submaps]
        return [float(np.linalg.norm(a.translation - b.translation)) for a, b in poses]

    drifted = errors(dataset)
    assert len(drifted) == 6
    assert drifted[0] == 0.0
    assert 0.05 < max(drifted) < 3.0
    exact = replace(SMALL, num_submaps=3, odometry_drift=0.0, heading_drift=0.0, max_points=100)
    assert max(errors(simulate_dataset(exact))) < 1e-5


@pytest.mark.slow
def test_more_submaps_keep_the_streams_of_the_others() -> None:
    """One more submap on the way back moves nothing that was there before it."""
    few = replace(SMALL, num_submaps=3, max_points=2000)
    a, b = simulate_dataset(few), simulate_dataset(replace(few, num_submaps=4))
    assert [s.fingerprint for s in a.submaps] == [s.fingerprint for s in b.submaps[:3]]


def test_progress_climbs_to_one() -> None:
    heard: list[float] = []
    simulate_dataset(replace(SMALL, num_submaps=2, max_points=500), heard.append)
    assert heard == sorted(heard)
    assert len(heard) == 3
    assert heard[-1] == 1.0


@pytest.mark.slow
def test_a_lesser_machine_makes_the_same() -> None:
    """Without the wide instructions NumPy's sines differ in the last bit; the points must not."""
    params = replace(SMALL, num_submaps=2, spacing=1.0, extent=14.0)
    found = np.show_config(mode="dicts")["SIMD Extensions"].get("found", [])
    program = (
        "from gpgrad_core import SimulationParams, simulate_dataset\n"
        f"dataset = simulate_dataset({params!r})\n"
        "print(*(submap.fingerprint for submap in dataset.submaps))\n"
    )
    root = Path(__file__).parents[3]
    lesser = {"NPY_DISABLE_CPU_FEATURES": " ".join(found), "OPENBLAS_NUM_THREADS": "1"}
    env = {**os.environ, "PYTHONPATH": str(root), **lesser}
    command = [sys.executable, "-c", program]
    finished = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=root, env=env
    )
    made = [submap.fingerprint for submap in simulate_dataset(params).submaps]
    assert finished.stdout.split() == made
