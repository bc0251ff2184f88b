"""PCD against Open3D as the outside writer."""

from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpgrad_core.io.clouds import load_cloud
from gpgrad_core.io.clouds.pcd import decompress_lzf
from tests.support.refusal import assert_refused

LAYOUTS = {"ascii": (True, False), "binary": (False, False), "compressed": (False, True)}


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """Rounded, so that the compressor finds repeats."""
    rng = np.random.default_rng(5)
    return np.round(rng.normal(size=(4000, 3)), 1).astype(np.float32).astype(np.float64)


def write_pcd(path: Path, points: np.ndarray, layout: str) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    ascii_, compressed = LAYOUTS[layout]
    assert o3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_, compressed=compressed)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_cut_file_is_refused(layout: str, points: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    write_pcd(path, points, layout)
    whole = path.read_bytes()
    for share in (0.999, 0.5, 0.05):
        path.write_bytes(whole[: int(share * len(whole))])
        assert_refused(lambda: load_cloud(path), str(path), "is cut short")
    path.write_bytes(whole[:60])
    assert_refused(lambda: load_cloud(path), str(path), "not a complete PCD")


def test_doubles_padding_and_counts(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(5e6, 5e6 + 10, (10, 3))
    table = np.zeros(10, [("_", "u1", 3), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS _ x y z\nSIZE 1 8 8 8\nTYPE U F F F\nCOUNT 3 1 1 1\n"
        "WIDTH 10\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 10\nDATA {}\n"
    )
    path = tmp_path / "a.pcd"
    path.write_bytes(header.format("binary").encode() + table.tobytes())
    np.testing.assert_array_equal(load_cloud(path).points, points)
    rows = "".join(f"0 0 0 {x!r} {y!r} {z!r}\n" for x, y, z in points.tolist())
    path.write_text(header.format("ascii") + rows)
    np.testing.assert_array_equal(load_cloud(path).points, points)
    path.write_text(header.format("ascii") + rows.replace("0 0 0", "0 0 0 up", 1))
    assert_refused(lambda: load_cloud(path), "line 12: 'up' is not a number")


@pytest.mark.parametrize(
    ("old", "new", "rule"),
    [
        ("FIELDS x y z", "FIELDS x y i", "no z"),
        ("FIELDS x y z\n", "", "no 'FIELDS' line"),
        ("SIZE 4 4 4", "SIZE 4 4", "SIZE line does not have 3 entries"),
        ("SIZE 4 4 4", "SIZE 4 4 3", "TYPE F of SIZE 3"),
        ("POINTS 4000", "POINTS all", "not a whole number"),
        ("DATA binary", "DATA zipped", "DATA 'zipped' is not one of"),
    ],
)
def test_broken_headers(old: str, new: str, rule: str, points: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    write_pcd(path, points, "binary")
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode(), 1))
    assert_refused(lambda: load_cloud(path), str(path), rule)


def test_damaged_compression_is_refused(points: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    write_pcd(path, points, "compressed")
    whole = bytearray(path.read_bytes())
    start = whole.index(b"binary_compressed\n") + 18 + 8
    whole[start : start + 50] = b"\xff" * 50
    path.write_bytes(whole)
    assert_refused(lambda: load_cloud(path), str(path), "damaged")


@given(packed=st.binary(max_size=200), size=st.integers(0, 300))
def test_any_bytes_unpack_or_fail_quietly(packed: bytes, size: int) -> None:
    assert isinstance(decompress_lzf(packed, size), bytes)


def test_lzf_by_hand() -> None:
    # Three letters, then a copy of 6 from 3 back that reads what it writes itself.
    assert decompress_lzf(b"\x02abc\x80\x02", 9) == b"abcabcabc"
