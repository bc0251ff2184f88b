"""Every format of clouds: what other programs write is read, with all that it says of a point."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import open3d as o3d
import pytest
import trimesh

from gpgrad_core.io.clouds import CLOUD_FORMATS, load_cloud_with_notes, read_cloud
from gpgrad_core.io.clouds.ply import write_ply
from tests.support.drive import as_kitti

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-5, 5, (60, 3))
COLORS = RNG.integers(0, 256, (60, 3)) / 255.0
NOISE = RNG.uniform(0.01, 0.1, 60)
RANGES = RNG.uniform(1.0, 6.0, 60)
NUMBERS = {"noise_std": NOISE, "range": RANGES}
WORLD = np.array([456_789.123456789, 5_123_456.987654321, -1234.000000123])
"""Map coordinates, where float32 has steps of half a metre."""


def by_open3d(path: Path, points: np.ndarray, **layout: bool) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.colors = o3d.utility.Vector3dVector(COLORS)
    cloud.normals = o3d.utility.Vector3dVector(np.full((len(points), 3), 0.1))
    assert o3d.io.write_point_cloud(str(path), cloud, **layout)


def by_trimesh(path: Path, points: np.ndarray, **layout: str) -> None:
    trimesh.Trimesh(points, [[0, 1, 2], [3, 4, 5]], process=False).export(path, **layout)


def by_gpgrad(path: Path, points: np.ndarray) -> None:
    write_ply(path, points, COLORS, NUMBERS)


def by_hand(path: Path, points: np.ndarray) -> None:
    header = "".join(f"property double {name}\n" for name in ("x", "y", "z", *NUMBERS))
    rows = np.column_stack([points, NOISE, RANGES]).tolist()
    text = "\n".join(" ".join(map(repr, row)) for row in rows)
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex 60\n{header}end_header\n{text}\n")


def by_laspy(path: Path, points: np.ndarray) -> None:
    laspy = pytest.importorskip("laspy", reason="the extra 'las' is not installed")
    header = laspy.LasHeader(point_format=0)
    header.offsets, header.scales = np.floor(points.min(axis=0)), np.full(3, 1e-7)
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = points.T
    cloud.write(str(path))


def with_noise(path: Path, points: np.ndarray) -> None:
    as_kitti(path, points, NOISE)


def as_npy(path: Path, points: np.ndarray) -> None:
    with path.open("wb") as file:  # whatever the letters of its ending
        np.save(file, points)


def as_npz(path: Path, points: np.ndarray) -> None:
    np.savez(path, points=points, colours=COLORS, **NUMBERS)


def as_table(path: Path, points: np.ndarray, **layout: str) -> None:
    np.savetxt(path, points, fmt="%.17g", **layout)


class Writer(NamedTuple):
    """How another program writes a format: how precisely, and what else of each point."""

    ending: str
    write: Callable[[Path, np.ndarray], None]
    off: float = 0.0  # in double precision [m]; of 32 bits, relative
    wide: bool = True  # whether map coordinates keep their precision
    colors: bool = False
    numbers: bool = False


WRITERS = [
    Writer(".ply", by_open3d, 1e-7, colors=True),
    Writer(".ply", partial(by_open3d, write_ascii=True), 1e-5, wide=False, colors=True),
    Writer(".ply", by_trimesh, 1e-6, wide=False),
    Writer(".ply", partial(by_trimesh, encoding="ascii"), 1e-6, wide=False),
    Writer(".ply", by_gpgrad, 1e-6, colors=True, numbers=True),
    Writer(".ply", by_hand, numbers=True),
    Writer(".pcd", by_open3d, 1e-6, wide=False, colors=True),
    Writer(".pcd", partial(by_open3d, write_ascii=True), 1e-5, wide=False, colors=True),
    Writer(".pcd", partial(by_open3d, compressed=True), 1e-6, wide=False, colors=True),
    Writer(".las", by_laspy, 1e-7),
    Writer(".laz", by_laspy, 1e-7),
    Writer(".bin", with_noise, 1e-6, wide=False),
    Writer(".npy", as_npy),
    Writer(".NPY", as_npy),
    Writer(".npz", as_npz, numbers=True),
    Writer(".xyz", as_table),
    Writer(".csv", partial(as_table, delimiter=",", header="x,y,z", comments="")),
]


def test_no_format_is_left_out() -> None:
    tested = {writer.ending.lower() for writer in WRITERS}
    for ending, cloud_format in CLOUD_FORMATS.items():
        assert ending in tested or cloud_format.example, f"nothing writes {ending}"


@pytest.mark.parametrize("writer", WRITERS, ids=lambda writer: writer.ending)
def test_what_is_written_is_read(writer: Writer, tmp_path: Path) -> None:
    path = tmp_path / f"crater{writer.ending}"
    writer.write(path, POINTS)
    submap, notes = load_cloud_with_notes(path)
    assert submap.id == "crater"
    assert notes == ()
    np.testing.assert_allclose(submap.points, POINTS, rtol=0, atol=writer.off)
    assert (submap.colors is not None) == writer.colors
    if submap.colors is not None:
        np.testing.assert_allclose(submap.colors, COLORS, atol=1e-9)
    assert (submap.noise_std is not None) == writer.numbers
    if writer.numbers:
        np.testing.assert_allclose(submap.noise_std, NOISE, rtol=1e-6)
        np.testing.assert_allclose(submap.ranges, RANGES, rtol=1e-6)
    # Numbers are read only if they are wanted.
    assert read_cloud(path).numbers == {}
    held: Any = read_cloud(path, ("intensity", "noise_std", "temperature")).numbers
    also = {".bin": {"intensity"}, ".las": {"intensity"}, ".laz": {"intensity"}}
    assert set(held) == also.get(writer.ending, {"noise_std"} if writer.numbers else set())
    if writer.wide:
        writer.write(path, WORLD + POINTS)
        atol = min(writer.off, 1e-7)
        np.testing.assert_allclose(read_cloud(path).points, WORLD + POINTS, rtol=0, atol=atol)
