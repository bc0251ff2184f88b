"""Colours come through every format that holds them, and images with their submap."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from gpgrad_core.datasets import load_cloud, load_dataset, write_dataset
from gpgrad_core.datasets.clouds import read_cloud
from gpgrad_core.datasets.clouds.ply import write_ply
from gpgrad_core.types import Dataset, Submap

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-5, 5, (50, 3))
COLORS = RNG.integers(0, 256, (50, 3)) / 255.0


@pytest.mark.parametrize("ending", [".ply", ".pcd"])
@pytest.mark.parametrize("ascii_", [False, True])
@pytest.mark.parametrize("compressed", [False, True])
def test_colors_of_open3ds_files(
    tmp_path: Path, ending: str, ascii_: bool, compressed: bool
) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(POINTS))
    cloud.colors = o3d.utility.Vector3dVector(COLORS)
    path = tmp_path / f"000{ending}"
    assert o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)
    submap = load_cloud(path)
    assert submap.colors is not None
    np.testing.assert_allclose(submap.colors, COLORS, atol=1e-9)
    np.testing.assert_allclose(submap.points, POINTS, atol=1e-5)


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_ply(path, POINTS, COLORS)
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.colors, COLORS, atol=1e-9)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-6)
    write_ply(path, POINTS)
    assert read_cloud(path).colors is None


def test_colors_are_dropped_with_their_points_and_are_part_of_the_fingerprint() -> None:
    points = POINTS.copy()
    points[7, 2] = np.nan
    submap = Submap.from_points(points, colors=COLORS)
    assert submap.colors is not None
    np.testing.assert_array_equal(submap.colors, np.delete(COLORS, 7, axis=0))
    assert submap.fingerprint != Submap.from_points(points).fingerprint
    assert submap.fingerprint != Submap.from_points(points, colors=COLORS[::-1]).fingerprint


def test_images_belong_to_the_submap_of_their_folders_number(tmp_path: Path) -> None:
    submaps = tuple(Submap.from_points(POINTS + k, f"{k:03d}", colors=COLORS) for k in range(2))
    write_dataset(Dataset("seen", submaps), tmp_path / "seen")
    for name in ("001/b.png", "001/a.jpg", "001/notes.txt", "005/a.png"):
        file = tmp_path / "seen" / "images" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"")
    first, second = load_dataset(tmp_path / "seen").submaps
    assert first.images == ()
    assert [file.name for file in second.images] == ["a.jpg", "b.png"]
    assert second.colors is not None
    np.testing.assert_allclose(second.colors, COLORS, atol=1e-9)
