"""Seconds of a gradient map, and its distance from the dense oracle in the same run.

``poe bench``; the oracle takes about a minute for each length-scale, so all in all it takes five.
"""

import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture
from threadpoolctl import threadpool_info

from gpgrad_core.arrays import Array
from gpgrad_core.detection import infer_gradient_map
from gpgrad_core.gp.kernel import SquaredExponential
from gpgrad_core.mapping.gradient_map import MapParams
from gpgrad_core.run.threads import num_workers
from gpgrad_core.types import GradientMap, Submap
from tests.support.dense import fit_dense, infer_elevation, infer_slope, infer_variance
from tests.support.ground import cloud

SIZE = (10.0, 10.0)
NOISE = 0.05
ORACLE_TILE = 2000  # cells at once: 80 MB of kernel rows

LENGTH_SCALES = [0.1, 0.3, 0.5]


def machine() -> str:
    cpu = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line for line in info.read_text().splitlines() if line.startswith("model name")]
        cpu = names[0].split(":")[1].strip() if names else cpu
    blas = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
    return f"{cpu}; {num_workers()} cores; BLAS threads {sorted(blas)}"


def params(length_scale: float) -> MapParams:
    return MapParams(length_scale=length_scale, noise_std=NOISE, resolution=0.03)


def make_submap(num: int) -> Submap:
    points = cloud(42, num, SIZE, noise=NOISE)
    points[:2, :2] = [[0.0, 0.0], SIZE]  # the whole box, to the corner
    return Submap.from_points(points, f"{num} points")


def dense_map(submap: Submap, made: GradientMap) -> tuple[Array, Array, Array]:
    """Infer all four fields at all cells by the oracle, no cell left out."""
    kernel = SquaredExponential(made.signal_std, made.length_scale)
    posterior = fit_dense(submap.points, kernel, NOISE)
    positions = made.grid.positions
    tiles = np.array_split(positions, -(-len(positions) // ORACLE_TILE))
    elevation = np.concatenate([infer_elevation(posterior, tile) for tile in tiles])
    variance = np.concatenate([infer_variance(posterior, tile) for tile in tiles])
    slope = np.concatenate([infer_slope(posterior, tile) for tile in tiles])
    shape = made.grid.shape
    return elevation.reshape(shape), variance.reshape(shape), slope.reshape(*shape, 2)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def timed(action: Callable[[], object]) -> float:
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


@pytest.fixture(scope="module")
def table() -> list[str]:
    print(f"\n{machine()}\n10 m x 10 m, 0.03 m/pixel, four fields; seconds are medians")  # noqa: T201
    return []


@pytest.mark.parametrize("length_scale", LENGTH_SCALES)
def test_five_thousand_points(
    benchmark: BenchmarkFixture, length_scale: float, table: list[str]
) -> None:
    submap = make_submap(5000)
    chosen = params(length_scale)
    made = benchmark.pedantic(
        infer_gradient_map, (submap, chosen), rounds=7, warmup_rounds=1, iterations=1
    )
    fast = statistics.median(benchmark.stats.stats.data)
    oracle: list[tuple[Array, Array, Array]] = []
    dense = timed(lambda: oracle.append(dense_map(submap, made)))
    ((elevation, variance, slope),) = oracle
    trusted = np.sqrt(variance) <= 0.3 * made.signal_std
    errors = {
        "elevation": rms(made.elevation - elevation) / NOISE,
        "slope": rms(made.slope - slope) / rms(slope),
        "std": float(np.abs(made.std / np.sqrt(variance) - 1)[trusted].max()),
    }
    table.append(f"{length_scale}")
    print(  # noqa: T201
        f"\n5,000 points, length-scale {length_scale} m, {made.grid.num_cells:,} cells: "
        f"fast {fast:.3f} s, dense {dense:.1f} s, ratio {dense / fast:.0f}; off by "
        f"{errors['elevation']:.2%} of the noise, {errors['slope']:.2%} of the slope (rms), "
        f"{errors['std']:.1%} of the standard deviation at most, where trusted "
        f"({trusted.mean():.0%} of the cells)"
    )
    benchmark.extra_info.update(dense_seconds=dense, ratio=dense / fast, **errors)
    assert errors["elevation"] <= 0.02
    assert errors["slope"] <= 0.02
    assert errors["std"] <= 0.05


@pytest.mark.parametrize("length_scale", LENGTH_SCALES)
def test_thirty_thousand_points(
    benchmark: BenchmarkFixture, length_scale: float, table: list[str]
) -> None:
    submap = make_submap(30_000)
    benchmark.pedantic(
        infer_gradient_map, (submap, params(length_scale)), rounds=7, warmup_rounds=1, iterations=1
    )
    seconds = statistics.median(benchmark.stats.stats.data)
    table.append(f"{length_scale}")
    print(f"\n30,000 points, length-scale {length_scale} m: {seconds:.3f} s")  # noqa: T201
