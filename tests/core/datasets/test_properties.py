"""What a cloud tells of each point besides its place: noise and range, by whatever format."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.datasets import load_cloud, load_dataset, write_dataset
from gpgrad_core.datasets.clouds.ply import write_ply
from gpgrad_core.gradient_map import TerrainParams, point_noise
from gpgrad_core.types import Dataset, Submap
from tests.core.datasets.refusal import assert_refused

RNG = np.random.default_rng(0)
POINTS = np.column_stack([RNG.uniform(-3, 3, (500, 2)), np.zeros(500)])
NOISE = RNG.uniform(0.01, 0.1, 500)
RANGES = RNG.uniform(1.0, 6.0, 500)


def as_ascii(path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 500\n"
    names = ("x", "y", "z", "noise_std", "range")
    header += "".join(f"property double {name}\n" for name in names) + "end_header\n"
    rows = np.column_stack([POINTS, NOISE, RANGES])
    path.write_text(header + "".join(" ".join(f"{v:.17g}" for v in row) + "\n" for row in rows))


@pytest.mark.parametrize("way", ["binary.ply", "colored.ply", "ascii.ply", "archive.npz"])
def test_noise_and_range_are_read(way: str, tmp_path: Path) -> None:
    path = tmp_path / way
    extras = {"noise_std": NOISE, "range": RANGES}
    if way == "ascii.ply":
        as_ascii(path)
    elif way == "archive.npz":
        np.savez(path, points=POINTS, noise_std=NOISE, range=RANGES)
    else:
        write_ply(path, POINTS, RNG.random((500, 3)) if way == "colored.ply" else None, extras)
    submap = load_cloud(path)
    np.testing.assert_allclose(submap.points, POINTS, atol=1e-6)
    np.testing.assert_allclose(submap.noise_std, NOISE, rtol=1e-6)
    np.testing.assert_allclose(submap.ranges, RANGES, rtol=1e-6)
    assert (submap.colors is not None) == (way == "colored.ply")


def test_a_dataset_keeps_them(tmp_path: Path) -> None:
    submap = Submap.from_points(POINTS, "000", noise_std=NOISE, ranges=RANGES)
    write_dataset(Dataset("a", (submap,)), tmp_path / "a")
    (loaded,) = load_dataset(tmp_path / "a").submaps
    np.testing.assert_allclose(loaded.noise_std, NOISE, rtol=1e-6)
    np.testing.assert_allclose(loaded.ranges, RANGES, rtol=1e-6)
    assert load_cloud(tmp_path / "a" / "submaps" / "000.ply").fingerprint == loaded.fingerprint
    assert loaded.fingerprint != replace(submap, fingerprint="").fingerprint


def test_noise_grows_with_the_range_it_was_seen_from() -> None:
    params = TerrainParams(noise_model="range", noise_std=0.02, noise_growth=0.01)
    told = Submap.from_points(POINTS, ranges=RANGES)
    untold = Submap.from_points(POINTS)
    np.testing.assert_allclose(point_noise(told, params).std, 0.02 + 0.01 * RANGES**2)
    squared = np.sum(POINTS[:, :2] ** 2, axis=1)
    np.testing.assert_allclose(point_noise(untold, params).std, 0.02 + 0.01 * squared)
    assert told.fingerprint != untold.fingerprint


def test_a_range_below_nothing(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", POINTS, extras={"range": -RANGES})
    assert_refused(lambda: load_cloud(tmp_path / "a.ply"), "a.ply: range must be 0 m or more")


def test_kitti_scans(tmp_path: Path) -> None:
    rows = np.column_stack([POINTS, NOISE]).astype("<f4")
    rows.tofile(tmp_path / "000000.bin")
    np.testing.assert_allclose(load_cloud(tmp_path / "000000.bin").points, POINTS, atol=1e-6)
    (tmp_path / "cut.bin").write_bytes(rows.tobytes()[:-5])
    assert_refused(lambda: load_cloud(tmp_path / "cut.bin"), "not a complete KITTI scan")
