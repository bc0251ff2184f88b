"""Every broken file of any format is refused in one line, which names the file and the rule."""

import io
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from gpgrad_core.io.clouds import load_cloud
from gpgrad_core.io.clouds.pcd import decompress_lzf
from gpgrad_core.io.clouds.ply import write_ply
from tests.core.io.test_formats import POINTS, by_laspy
from tests.support.laws import examples
from tests.support.refusal import assert_file_refused, assert_refused

XYZ = "property float x\nproperty float y\nproperty float z\n"
LISTS = "property float x\nproperty list uchar float w\n"
LITTLE = "ply\nformat binary_little_endian 1.0\n"


def npy(array: np.ndarray, save: Callable[..., None] = np.save, **named: np.ndarray) -> bytes:
    file = io.BytesIO()
    save(file, *([] if named else [array]), **named)
    return file.getvalue()


THOUSAND = npy(np.zeros((1000, 3)))
NINE = np.random.default_rng(1).normal(size=(9, 3))


@pytest.mark.parametrize(
    ("name", "data", "rules"),
    [
        ("a.ply", "", ["not a PLY"]),
        ("a.ply", "solid stl", ["not a PLY"]),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex 3\n", ["no 'end_header'"]),
        ("a.ply", "ply\nelement vertex 3\nend_header\n", ["no 'format'"]),
        ("a.ply", "ply\nformat binary_middle_endian 1.0\nend_header\n", ["line 2: format"]),
        ("a.ply", "ply\nformat ascii 1.0\nend_header\n", ["no 'element vertex'"]),
        ("a.ply", "ply\nformat ascii 1.0\nelement vertex many\nend_header\n", ["line 3"]),
        ("a.ply", f"{LITTLE}element vertex 1\n{XYZ[:34]}end_header\n", ["no property z"]),
        ("a.ply", f"{LITTLE}element vertex 1\nproperty quad x\n", ["line 4: 'property quad x'"]),
        (
            "a.ply",
            f"ply\nformat ascii 1.0\nelement vertex 2\n{XYZ}end_header\n1 2 3\n4 5 up\n",
            ["line 9: 'up' is not a number"],
        ),
        ("a.ply", f"{LITTLE}element vertex 1\n{LISTS}end_header\n", ["no property y or z"]),
        (
            "a.ply",
            f"{LITTLE}element vertex 1\n{XYZ}property list uchar int w\nend_header\n",
            ["does not hold 1 rows of 'element vertex'"],
        ),
        ("a.ply", f"{LITTLE}element vertex 0\n{XYZ}end_header\n", ["empty cloud"]),
        ("a.csv", "1 2 3\n4 five 6\n7 8 9\n", ["line 2", "'five' is not a number"]),
        ("a.csv", "x,y,z\n1,2,3\n\n4,5,six\n", ["line 4", "'six' is not a number"]),
        ("a.csv", "# hand\n1 2 3\n4 5\n7 8 9\n", ["line 3", "has 2 columns", "need 3", "'4 5'"]),
        ("a.csv", "id,x,y,z\n1,2,3,4\n7\n", ["line 3", "has 1 column,", "need 4"]),
        ("a.csv", "lon,lat,height\n1,2,3\n", ["line 1", "'lon' is not", "name the columns x, y"]),
        ("a.csv", "1.5;2,5;3\n", ["line 1", "is not a number"]),
        ("a.csv", "", ["empty cloud"]),
        ("a.csv", "x,y,z\n", ["empty cloud"]),
        ("a.csv", "# nothing\n\n", ["empty cloud"]),
        ("a.xyz", bytes(range(256)) * 4, ["not text"]),
        ("a.xyz", "1\n2\n3\n", ["line 1: has 1 column, x, y and z need 3"]),
        ("a.bin", bytes(43), ["not a complete KITTI scan"]),
        ("a.e57", "", ["unknown ending '.e57'", ".bin .csv .las .laz .npy .npz .pcd .ply .xyz"]),
        ("a.npy", npy(np.zeros((0, 3))), ["empty cloud"]),
        ("a.npy", npy(np.full((5, 3), np.nan)), ["found 0 of 5"]),
        ("a.npy", npy(np.zeros((4, 2))), ["shape (n, 3), got float64 (4, 2)"]),
        ("a.npy", npy(np.array([["a", "b", "c"]])), ["must be numbers"]),
        ("a.npy", npy(np.array([{"pickled": 1}], object)), ["is not a complete NPY"]),
        ("a.npy", npy(NINE, np.savez), ["rename it to .npz"]),
        *(
            (name, data[:end], ["is not a complete"])
            for name, data in (("a.npy", THOUSAND), ("a.npz", npy(NINE, np.savez)))
            for end in (len(data) // 2, 9, 0)
        ),
        ("a.npy", b"no archive\n" * 9, ["is not a complete"]),
        ("a.npz", b"no archive\n" * 9, ["is not a complete"]),
        ("a.npz", npy(NINE), ["rename it to .npy"]),
        (
            "a.npz",
            npy(NINE, np.savez, first=NINE, second=NINE),
            ["'points'", "first (9, 3), second (9, 3)"],
        ),
        ("a.npz", npy(NINE, np.savez, points=NINE[:, :2]), ["array 'points'", "(9, 2)"]),
    ],
    ids=lambda value: value if isinstance(value, str) and len(value) == 5 else "",
)
def test_a_broken_file(name: str, data: str | bytes, rules: list[str], tmp_path: Path) -> None:
    assert_file_refused(load_cloud, tmp_path / name, data, *rules)


def test_what_is_no_file_or_needs_an_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert_refused(lambda: load_cloud(tmp_path / "none.ply"), "none.ply: no such file")
    (tmp_path / "folder.ply").mkdir()
    assert_refused(lambda: load_cloud(tmp_path / "folder.ply"), "folder.ply: cannot be read")
    write_ply(tmp_path / "a.ply", POINTS, extras={"range": -np.ones(60)})
    assert_refused(lambda: load_cloud(tmp_path / "a.ply"), "a.ply: range must be 0 m or more")
    monkeypatch.setitem(sys.modules, "lazrs", None)
    assert_file_refused(load_cloud, tmp_path / "a.laz", b"LASF", "pip install 'gpgrad[las]'")


def test_an_archive_that_is_damaged_in_the_middle(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(1000, 3))
    whole = npy(NINE, np.savez_compressed, points=points)
    damaged = whole[:5000] + bytes(50) + whole[5050:]
    assert_file_refused(load_cloud, tmp_path / "a.npz", damaged, "is not a complete NPZ")


def test_a_cut_las(tmp_path: Path) -> None:
    for ending, rule in ((".las", "is cut short"), (".laz", "not a complete LAS file")):
        path = tmp_path / f"a{ending}"
        by_laspy(path, POINTS)
        assert_file_refused(load_cloud, path, path.read_bytes()[:300], rule)


@examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999), order=st.sampled_from(["", "<", ">"]))
def test_a_cut_ply_never_passes(share: float, order: str, tmp_path: Path) -> None:
    layout = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    body = POINTS.astype(f"{order}f4").tobytes()
    if not order:
        body = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in POINTS).encode()
    whole = f"ply\nformat {layout} 1.0\nelement vertex 60\n{XYZ}end_header\n".encode() + body
    path = tmp_path / "a.ply"
    # The last digits of an ascii file can go unseen; two characters short cannot.
    cut = whole[: min(int(share * len(whole)), len(whole) - 26)]
    assert_file_refused(load_cloud, path, cut)
    rule = f"promises 60 points, but the file ends after {57 if order else 58};"
    assert_file_refused(load_cloud, path, whole[:-30], rule)


def pcd(path: Path, layout: str) -> bytes:
    """Write rounded points by Open3D, so that the compressor finds repeats."""
    points = np.round(np.random.default_rng(5).normal(size=(4000, 3)), 1)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    options = {"write_ascii": layout == "ascii", "compressed": layout == "compressed"}
    assert o3d.io.write_point_cloud(str(path), cloud, **options)
    return path.read_bytes()


@pytest.mark.parametrize("layout", ["ascii", "binary", "compressed"])
def test_a_cut_pcd(layout: str, tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    whole = pcd(path, layout)
    for share in (0.999, 0.5, 0.05):
        assert_file_refused(load_cloud, path, whole[: int(share * len(whole))], "is cut short")
    assert_file_refused(load_cloud, path, whole[:60], "not a complete PCD")


def test_a_broken_pcd(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    whole = pcd(path, "binary")
    for old, new, rule in (
        (b"FIELDS x y z", b"FIELDS x y i", "no z"),
        (b"FIELDS x y z\n", b"", "no 'FIELDS' line"),
        (b"SIZE 4 4 4", b"SIZE 4 4", "SIZE line does not have 3 entries"),
        (b"SIZE 4 4 4", b"SIZE 4 4 3", "TYPE F of SIZE 3"),
        (b"POINTS 4000", b"POINTS all", "not a whole number"),
        (b"DATA binary", b"DATA zipped", "DATA 'zipped' is not one of"),
    ):
        assert_file_refused(load_cloud, path, whole.replace(old, new, 1), rule)
    packed = pcd(path, "compressed")
    start = packed.index(b"binary_compressed\n") + 18 + 8
    damaged = packed[:start] + b"\xff" * 50 + packed[start + 50 :]
    assert_file_refused(load_cloud, path, damaged, "damaged")


@given(packed=st.binary(max_size=200), size=st.integers(0, 300))
def test_any_bytes_unpack_or_fail_quietly(packed: bytes, size: int) -> None:
    assert isinstance(decompress_lzf(packed, size), bytes)
