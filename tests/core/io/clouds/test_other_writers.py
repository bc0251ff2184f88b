"""Clouds as other programs write them: read as an independent reader does, or refused in a line."""

import struct
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest

from gpgrad_core.io.clouds import load_cloud, read_cloud
from tests.support.refusal import assert_refused

POINTS = np.random.default_rng(5).normal(size=(60, 3)).astype(np.float32) * [20, 10, 1]
ORDERS = {"little": "<", "big": ">"}


def by_open3d(path: Path) -> np.ndarray:
    return np.asarray(o3d.io.read_point_cloud(str(path)).points)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("lengths", [(3,), (0, 2, 5)])
def test_lists_of_and_before_the_vertices_of_a_binary_ply(
    order: str, lengths: tuple[int, ...], tmp_path: Path
) -> None:
    mark, path = ORDERS[order], tmp_path / "a.ply"
    header = (
        f"ply\nformat binary_{order}_endian 1.0\nelement sensor 2\n"
        "property list uchar float intrinsic\nproperty float t\nelement vertex 60\n"
        "property float x\nproperty list uint double vertex_indices\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(f"{mark}B{n}ff", n, *range(n), 9.0) for n in (1, 4))
    for k, (x, y, z) in enumerate(POINTS.astype("f4").tolist()):
        n = lengths[k % len(lengths)]
        body += struct.pack(f"{mark}fI{n}dff", x, n, *np.arange(float(n)), y, z)
    path.write_bytes(header.encode() + body + struct.pack(f"{mark}B3i", 3, 0, 1, 2))
    read = read_cloud(path).points
    np.testing.assert_array_equal(read, POINTS.astype("f4"))
    np.testing.assert_array_equal(read, by_open3d(path))
    path.write_bytes(path.read_bytes()[:-40])
    assert_refused(lambda: read_cloud(path), "is cut short or damaged")


@pytest.mark.parametrize(
    ("head", "padding"),
    [
        ("FIELDS _ x y z _\nSIZE 1 4 4 4 2\nTYPE U F F F U\nCOUNT 0 1 1 1 0\n", 0),
        ("FIELDS x y z _\nSIZE 4 4 4 0\nTYPE F F F U\nCOUNT 1 1 1 1\n", 0),
        ("FIELDS x y z _ _\nSIZE 4 4 4 3 1\nTYPE F F F U F\nCOUNT 1 1 1 1 5\n", 8),
    ],
)
def test_padding_of_a_pcd_is_passed_over(head: str, padding: int, tmp_path: Path) -> None:
    path, rows = tmp_path / "a.pcd", POINTS.astype("<f4").view("u1").reshape(60, 12)
    body = np.column_stack([rows, np.full((60, padding), 255, "u1")]).tobytes()
    path.write_bytes(f"{head}WIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA binary\n".encode() + body)
    np.testing.assert_array_equal(read_cloud(path).points, POINTS.astype("f4"))
    if head.startswith("FIELDS _"):  # the others Open3D does not read
        np.testing.assert_array_equal(read_cloud(path).points, by_open3d(path))
    if not head.endswith("COUNT 1 1 1 1\n"):
        path.write_bytes(path.read_bytes().replace(b" 1 1 1", b" 0 1 1", 1))
        assert_refused(lambda: read_cloud(path), "FIELDS have no x")


def test_faces_of_one_corner_are_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 60\nproperty float x\nproperty "
    head += "float y\nproperty float z\nelement face 2\nproperty list uchar int vertex_indices\n"
    faces = struct.pack("<BiB3i", 1, 7, 3, 0, 1, 2)
    path.write_bytes(f"{head}end_header\n".encode() + POINTS.astype("<f4").tobytes() + faces)
    np.testing.assert_array_equal(read_cloud(path).points, by_open3d(path))


def test_a_pcd_whose_block_is_stored_as_it_is(tmp_path: Path) -> None:
    path, block = tmp_path / "a.pcd", POINTS.T.astype("<f4").tobytes()
    path.write_bytes(
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\n"
        b"POINTS 60\nDATA binary_compressed\n" + struct.pack("<II", len(block), len(block)) + block
    )
    np.testing.assert_array_equal(read_cloud(path).points, POINTS.astype("f4"))
    path.write_bytes(path.read_bytes()[:-1])
    assert_refused(lambda: read_cloud(path), "is cut short")


def test_structured_arrays(tmp_path: Path) -> None:
    kinds = [("t", "<u4"), ("z", "<f8"), ("", "V4"), ("x", "<f4"), ("y", ">f4"), ("n", "<i2", (3,))]
    table = np.zeros((6, 10), kinds)
    for axis, name in enumerate("xyz"):
        table[name] = POINTS[:, axis].reshape(6, 10)
    table["t"] = np.arange(60).reshape(6, 10)
    np.save(tmp_path / "a.npy", table)
    np.savez(tmp_path / "b.npz", table)
    expected = np.column_stack([np.load(tmp_path / "a.npy")[name].ravel() for name in "xyz"])
    for name in ("a.npy", "b.npz"):
        np.testing.assert_array_equal(read_cloud(tmp_path / name).points, expected)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy", ["t"]).numbers["t"], range(60))
    np.save(tmp_path / "c.npy", table[["t", "x", "y"]])
    assert_refused(lambda: read_cloud(tmp_path / "c.npy"), "points must be numbers of fields x, y")
    whole = (tmp_path / "a.npy").read_bytes()
    for broken in (whole.replace(b"'y'", b"'x'", 1), whole.replace(b"('t'", b"(('t'", 1)):
        (tmp_path / "d.npy").write_bytes(broken)
        assert_refused(lambda: read_cloud(tmp_path / "d.npy"), "is not a type of numbers")


@pytest.mark.parametrize("ending", [".xyz", ".csv"])
def test_a_first_line_may_count_the_points(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    rows = "".join(f"{z} {x} {y}\n" for x, y, z in POINTS[:4].tolist())
    path.write_text(f"//Z X Y\n4\n{rows}")
    np.testing.assert_array_equal(read_cloud(path).points, POINTS[:4])
    path.write_text(f"4\nz x y\n{rows}")
    np.testing.assert_array_equal(read_cloud(path).points, POINTS[:4])
    path.write_text(f"5\n{rows}")
    assert_refused(lambda: read_cloud(path), "promises 5 points, but the file ends after 4")
    path.write_text(f"3\n{rows}")
    assert_refused(lambda: read_cloud(path), "4 points instead of 3")
    path.write_text("1\n2\n3\n")
    assert_refused(lambda: read_cloud(path), "line 1: has 1 column, x, y and z need 3")


def test_a_first_column_that_numbers_the_points_is_asked_about(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    for ids in (range(60), [3 * k + 1000 for k in range(60)][::-1]):
        rows = [",".join(map(str, (k, *row))) for k, row in zip(ids, POINTS.tolist(), strict=True)]
        path.write_text("\n".join(rows))
        assert_refused(lambda: read_cloud(path), "line 1: the first column seems to number the")
        path.write_text("\n".join(["id,x,y,z", *rows]))
        np.testing.assert_array_equal(read_cloud(path).points, POINTS)
    metres = np.column_stack([np.rint(POINTS[:, :2]), POINTS[:, 2]]).tolist()
    for ids, places in (
        ([k % 7 for k in range(60)], POINTS.tolist()),
        ([k % 7 for k in range(60)], metres),
        (["" if k % 9 == 4 else k for k in range(60)], POINTS.tolist()),
        (range(60), np.rint(POINTS).tolist()),
    ):
        rows = [",".join(map(str, (k, *row))) for k, row in zip(ids, places, strict=True)]
        path.write_text("\n".join(rows))
        assert_refused(lambda: read_cloud(path), "line 1: the first column seems to number the")
        path.write_text("\n".join(["id,x,y,z", *rows]))
        np.testing.assert_array_equal(read_cloud(path).points, places)
    grid = [f"{k // 8},{k % 8}.5,0.1,7" for k in range(64)]
    path.write_text("\n".join(grid))
    assert len(load_cloud(path).points) == 64


@pytest.mark.parametrize("width", [3, 5, 6, 7, 8])
def test_rows_that_are_not_of_four_numbers_are_noticed(width: int, tmp_path: Path) -> None:
    rng, count = np.random.default_rng(0), 2000
    further = [
        rng.uniform(0, 1, count),
        rng.integers(0, 32, count),
        *rng.uniform(0, 0.1, (3, count)),
    ]
    ground = np.column_stack(
        [*rng.normal(0, [[20], [10]], (2, count)), rng.normal(-1.7, 0.1, count)]
    )
    rows = np.column_stack([ground, *further])[:, :width].astype("<f4")
    rows.tofile(tmp_path / "a.bin")
    assert_refused(lambda: read_cloud(tmp_path / "a.bin"), f"seems to have {width} numbers a point")
    if width == 8:  # as the point cloud library lays them out
        filled = np.column_stack([ground, np.ones(count), 255 * further[0], np.zeros((count, 3))])
        filled.astype("<f4").tofile(tmp_path / "a.bin")
        assert_refused(lambda: read_cloud(tmp_path / "a.bin"), "seems to have 8 numbers a point")
    rows.astype("<f8")[:, :4].tofile(tmp_path / "a.bin")
    assert_refused(
        lambda: read_cloud(tmp_path / "a.bin"), f"{min(width, 4)} 64-bit numbers a point"
    )
    np.column_stack([ground, further[0]]).astype("<f4").tofile(tmp_path / "b.bin")
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.bin").points, ground.astype("f4"))
