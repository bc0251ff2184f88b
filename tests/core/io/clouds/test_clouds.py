"""What a sound file of any writer holds is read; what is left out or unclear is told."""

import struct
from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import pyproj
import pytest
import trimesh

from gpgrad_core.io.clouds import load_cloud, load_cloud_with_notes, read_cloud
from gpgrad_core.io.clouds.las import read_las
from gpgrad_core.io.clouds.pcd import decompress_lzf
from gpgrad_core.io.clouds.ply import write_ply
from tests.core.io.test_formats import WORLD
from tests.support.refusal import assert_file_refused, assert_refused

FAR = np.random.default_rng(0).uniform(5e6, 5e6 + 10, (10, 3))
POINTS = np.random.default_rng(5).normal(size=(60, 3)).astype(np.float32) * [20, 10, 1]
SINGLE = POINTS.astype("<f4")


def by_open3d(path: Path) -> np.ndarray:
    return np.asarray(o3d.io.read_point_cloud(str(path)).points)


def test_what_is_written_trimesh_reads(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", FAR)
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, FAR)


def test_points_that_are_left_out_are_counted_and_told(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(size=(3000, 3))
    odd = points.copy()
    odd[:7, 2], odd[7:12, 0] = np.nan, np.inf
    low_and_far = [[0.5, 0.5, -40.0], [900.0, 0.0, 0.5]]
    for rows, dropped, wild, note in (
        (odd, 12, 0, "12 of 3,000 rows are not finite and were dropped"),
        (odd[11:], 1, 0, "1 of 2,989 rows is not finite and was dropped"),
        (np.vstack([points, [[0.5, 0.5, 1e3]]]), 0, 1, "1 of 3,001 points was left out: no ground "
         "explains it"),
        (np.vstack([low_and_far, points]), 0, 2, "2 of 3,002 points were left out: no ground "
         "explains them"),
    ):  # fmt: skip
        np.save(tmp_path / "003.npy", rows)
        submap, notes = load_cloud_with_notes(tmp_path / "003.npy")
        assert (submap.num_dropped, submap.num_wild) == (dropped, wild)
        assert notes == (f"003.npy: {note}",)
        assert submap.num_points == len(rows) - dropped - wild
    np.testing.assert_array_equal(submap.points, points)


def test_world_coordinates_in_float32_are_told(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", (WORLD + FAR - 5e6).astype(np.float32))
    (note,) = load_cloud_with_notes(tmp_path / "a.npy")[1]
    assert "5,123,46" in note
    assert "steps of 0.5 m" in note


@pytest.mark.parametrize(("order", "mark"), [("little", "<"), ("big", ">")])
@pytest.mark.parametrize("lengths", [(), (3,), (0, 2, 5)])
def test_other_properties_and_elements_of_a_binary_ply_are_passed_over(
    order: str, mark: str, lengths: tuple[int, ...], tmp_path: Path
) -> None:
    path = tmp_path / "a.ply"
    of_sensor, of_vertex = "property uchar id\n", ""
    first, second, third = "xyz" if lengths else "zxy"  # which Open3D does not read
    if lengths:
        of_sensor = "property list uchar float intrinsic\n"
        of_vertex = "property list uint double vertex_indices\n"
    header = (
        f"ply\nformat binary_{order}_endian 1.0\ncomment made for a test\nelement sensor 2\n"
        f"{of_sensor}property float t\nelement vertex 60\nproperty uchar strength\n"
        f"property double {first}\n{of_vertex}property short n\nproperty float {second}\n"
        f"property float {third}\n"
        "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(f"{mark}B{n}ff", n, *range(n), 9.0) for n in (1, 4) if lengths)
    body += b"" if lengths else struct.pack(f"{mark}BfBf", 1, 9.0, 2, 9.0)
    for k, point in enumerate(SINGLE.tolist()):
        place = dict(zip("xyz", point, strict=True))
        row = struct.pack(f"{mark}Bd", 7, place[first])
        if lengths:
            n = lengths[k % len(lengths)]
            row += struct.pack(f"{mark}I{n}d", n, *np.arange(float(n)))
        body += row + struct.pack(f"{mark}hff", -1, place[second], place[third])
    faces = struct.pack(f"{mark}BiB3i", 1, 7, 3, 0, 1, 2)
    path.write_bytes(header.encode() + body + faces)
    read = read_cloud(path).points
    np.testing.assert_array_equal(read, SINGLE)
    if lengths:
        np.testing.assert_array_equal(read, by_open3d(path))
    cut = path.read_bytes()[:-40]
    rule = "is cut short or damaged" if lengths else "promises 60 points"
    assert_file_refused(read_cloud, path, cut, rule)


def test_text_keeps_double_precision(tmp_path: Path) -> None:
    rows = "\n".join(f"{x!r} 1 {y!r} {z!r}" for x, y, z in FAR.tolist())
    names = "property double x\nproperty uchar red\nproperty double y\nproperty double z"
    text = f"ply\nformat ascii 1.0\nelement vertex 10\n{names}\nend_header\n{rows}".encode()
    path = tmp_path / "a.ply"
    # Lines that end as they do on Windows, too, and no end of the last line.
    for written in (text + b"\n", text.replace(b"\n", b"\r\n")):
        path.write_bytes(written)
        np.testing.assert_array_equal(load_cloud(path).points, FAR)


def test_doubles_padding_and_counts_of_a_pcd(tmp_path: Path) -> None:
    table = np.zeros(10, [("_", "u1", 3), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    for axis, name in enumerate("xyz"):
        table[name] = FAR[:, axis]
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS _ x y z\nSIZE 1 8 8 8\nTYPE U F F F\nCOUNT 3 1 1 1\n"
        "WIDTH 10\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 10\nDATA {}\n"
    )
    path = tmp_path / "a.pcd"
    rows = "".join(f"0 0 0 {x!r} {y!r} {z!r}\n" for x, y, z in FAR.tolist())
    ascii_header = header.format("ascii")
    for content in (header.format("binary").encode() + table.tobytes(), ascii_header + rows):
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        np.testing.assert_array_equal(load_cloud(path).points, FAR)
    spoiled = ascii_header + rows.replace("0 0 0", "0 0 0 up", 1)
    assert_file_refused(load_cloud, path, spoiled, "line 12: 'up' is not a number")


@pytest.mark.parametrize(
    ("head", "padding"),
    [
        ("FIELDS _ x y z _\nSIZE 1 4 4 4 2\nTYPE U F F F U\nCOUNT 0 1 1 1 0\n", 0),
        ("FIELDS x y z _\nSIZE 4 4 4 0\nTYPE F F F U\nCOUNT 1 1 1 1\n", 0),
        ("FIELDS x y z _ _\nSIZE 4 4 4 3 1\nTYPE F F F U F\nCOUNT 1 1 1 1 5\n", 8),
    ],
    ids=["no count", "no size", "odd size"],
)
def test_padding_of_a_pcd_is_passed_over(head: str, padding: int, tmp_path: Path) -> None:
    path, rows = tmp_path / "a.pcd", SINGLE.view("u1").reshape(60, 12)
    body = np.column_stack([rows, np.full((60, padding), 255, "u1")]).tobytes()
    path.write_bytes(f"{head}WIDTH 60\nHEIGHT 1\nPOINTS 60\nDATA binary\n".encode() + body)
    np.testing.assert_array_equal(read_cloud(path).points, SINGLE)
    if head.startswith("FIELDS _"):  # the others Open3D does not read
        np.testing.assert_array_equal(read_cloud(path).points, by_open3d(path))


def test_a_pcd_whose_block_is_stored_as_it_is(tmp_path: Path) -> None:
    path, block = tmp_path / "a.pcd", POINTS.T.astype("<f4").tobytes()
    whole = (
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\n"
        b"POINTS 60\nDATA binary_compressed\n" + struct.pack("<II", len(block), len(block)) + block
    )
    path.write_bytes(whole)
    np.testing.assert_array_equal(read_cloud(path).points, SINGLE)
    assert_file_refused(read_cloud, path, whole[:-1], "is cut short")


def test_lzf_by_hand() -> None:
    # Three letters, then a copy of 6 from 3 back that reads what it writes itself.
    assert decompress_lzf(b"\x02abc\x80\x02", 9) == b"abcabcabc"


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 6.5 7\n-1 .25 1e-3\n",
        "1\t2\t3\n4\t6.5\t7\n-1\t.25\t1e-3",
        "  1   2  3 255 0 0\n4 6.5 7 255 0 0\n\n-1 .25 1e-3 0 0 0\n",
        "# made by hand\n1,2,3\n4,6.5,7\n# a pause\n-1,.25,1e-3\n",
        "x,y,z\n1,2,3\n4,6.5,7\n-1,.25,1e-3\n",
        "X;Y;Z\r\n1;2;3\r\n4;6.5;7\r\n-1;.25;1e-3\r\n",
        '"Intensity","Z","Y","X"\n9,3,2,1\n9,7,6.5,4\n9,1e-3,.25,-1\n',
        "//X,Y,Z,R\n1,2,3,0\n4,6.5,7,0\n-1,.25,1e-3,0\n",
        "# z y x\n3 2 1\n7 6.5 4\n1e-3 .25 -1\n",
        "# the columns are x y z in metres\n1 2 3\n4 6.5 7\n-1 .25 1e-3\n",
        "# made by hand\nx, y, z\n1, 2, 3\n4, 6.5, 7\n-1, .25, 1e-3\n",
        "\ufeffx,y,z\n1,2,3\n4,6.5,7\n-1,.25,1e-3\n",
        '"x","y","z"\n"1","2","3"\n"4","6.5","7"\n"-1",".25","1e-3"\n',
        "x,y,z\n1,2,3\n5,,6\n4,6.5,7\nnan,1,1\n-1,.25,1e-3\n",  # what is empty is not finite
    ],
)
def test_columns_of_a_table_are_found(text: str, tmp_path: Path) -> None:
    table = [[1.0, 2.0, 3.0], [4.0, 6.5, 7.0], [-1.0, 0.25, 1e-3]]
    for path in (tmp_path / "a.xyz", tmp_path / "a.csv"):
        path.write_text(text, encoding="utf-8")
        np.testing.assert_array_equal(load_cloud(path).points, table)


@pytest.mark.parametrize(
    ("head", "rows"),
    [
        ("y x z", "2,1,3"),
        ("z, x, y", "3 1 2"),
        ("fields: z x y", "3 1 2"),
        ("columns: y x z", "2\t1\t3"),
        ("y [m] x [m] z [m]", "2 1 3"),
        ("y(m) x(m) z(m)", "2;1;3"),
        ("p_z p_x p_y", "3 1 2"),
        ("row col x y z", "8 9 1 2 3"),
        ("scanned by them: x is east", "1 2 3"),
        ("heights (mm) are of the tripod", "1 2 3"),
        ("each row is y x z.", "names x, y and z in another order, but not each of the 3 columns"),
        ("x[mm] y[mm] z[mm]", "line 1: names columns in mm; give metres"),
        ("the columns are x, y, z (cm)", "line 1: names columns in cm; give metres"),
    ],
)
def test_columns_that_a_comment_names(head: str, rows: str, tmp_path: Path) -> None:
    for path, mark in ((tmp_path / "a.xyz", "# "), (tmp_path / "a.csv", "//")):
        if rows[0].isdigit():
            path.write_text(f"{mark}{head}\n{rows}\n")
            np.testing.assert_array_equal(read_cloud(path).points, [[1, 2, 3]])
        else:
            assert_file_refused(read_cloud, path, f"{mark}{head}\n1 2 3\n", rows)


def test_rows_and_columns_before_x_are_asked_about(tmp_path: Path) -> None:
    path, points = tmp_path / "a.csv", hills(60)[1]
    rows = [f"{k // 8},{k % 8},{x:.3f},{y:.3f},{z:.3f}" for k, (x, y, z) in enumerate(points)]
    rule = "line 1: the first column seems to be no x but the number of a row", "row,col,x,y,z,… if"
    assert_file_refused(read_cloud, path, "\n".join(rows), *rule)
    path.write_text("\n".join(["row,col,x,y,z", *rows]))
    np.testing.assert_allclose(read_cloud(path).points, points, atol=1e-3)


def test_arrays_by_their_names_or_as_the_only_one_of_points(tmp_path: Path) -> None:
    np.savez(tmp_path / "only.npz", cloud=FAR.astype(int), stamp=np.arange(3))
    np.testing.assert_array_equal(read_cloud(tmp_path / "only.npz").points, FAR.astype(int))
    kinds = [("t", "<u4"), ("z", "<f8"), ("", "V4"), ("x", "<f4"), ("y", ">f4"), ("n", "<i2", (3,))]
    table = np.zeros((6, 10), kinds)
    for axis, name in enumerate("xyz"):
        table[name] = POINTS[:, axis].reshape(6, 10)
    table["t"] = np.arange(60).reshape(6, 10)
    np.save(tmp_path / "a.npy", table)
    np.savez(tmp_path / "b.npz", table)
    for name in ("a.npy", "b.npz"):
        np.testing.assert_array_equal(read_cloud(tmp_path / name).points, SINGLE)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy", ["t"]).numbers["t"], range(60))
    np.save(tmp_path / "c.npy", table[["t", "x", "y"]])
    assert_refused(lambda: read_cloud(tmp_path / "c.npy"), "points must be numbers of fields x, y")
    whole = (tmp_path / "a.npy").read_bytes()
    for broken in (whole.replace(b"'y'", b"'x'", 1), whole.replace(b"('t'", b"(('t'", 1)):
        assert_file_refused(read_cloud, tmp_path / "d.npy", broken, "is not a type of numbers")


@pytest.mark.parametrize("ending", [".xyz", ".csv"])
def test_a_first_line_may_count_the_points(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    rows = "".join(f"{z} {x} {y}\n" for x, y, z in POINTS[:4].tolist())
    for head in ("//Z X Y\n4\n", "4\nz x y\n"):
        path.write_text(head + rows)
        np.testing.assert_array_equal(read_cloud(path).points, POINTS[:4])
    more, fewer = "promises 5 points, but the file ends after 4", "4 points instead of 3"
    assert_file_refused(read_cloud, path, f"5\n{rows}", more)
    assert_file_refused(read_cloud, path, f"3\n{rows}", fewer)


METRES = np.column_stack([np.rint(POINTS[:, :2]), POINTS[:, 2]])


@pytest.mark.parametrize(
    ("ids", "points"),
    [
        (range(60), POINTS),
        ([3 * k + 1000 for k in range(60)][::-1], POINTS),
        ([k % 7 for k in range(60)], POINTS),
        ([k % 7 for k in range(60)], METRES),
        (["" if k % 9 == 4 else k for k in range(60)], POINTS),
        (range(60), np.rint(POINTS)),
    ],
    ids=["rising", "falling", "repeated", "beside metres", "with gaps", "beside whole numbers"],
)
def test_a_first_column_that_numbers_the_points_is_asked_about(
    ids: Sequence[object], points: np.ndarray, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    rows = [",".join(map(str, (k, *row))) for k, row in zip(ids, points.tolist(), strict=True)]
    rule = "line 1: the first column seems to number the"
    assert_file_refused(read_cloud, path, "\n".join(rows), rule)
    path.write_text("\n".join(["id,x,y,z", *rows]))
    np.testing.assert_array_equal(read_cloud(path).points, points)


def hills(count: int) -> tuple[np.random.Generator, np.ndarray]:
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, [[30], [20]], (2, count))
    return rng, np.column_stack([x + 20, y + 10, np.sin(0.3 * x) + np.cos(0.4 * y) + 3])


@pytest.mark.parametrize("relief", [1.0, 0.0], ids=["hills", "plain"])
@pytest.mark.parametrize("count", [10, 150, 3000])
@pytest.mark.parametrize("first", ["time", "stamp", "packets", "strength", "256", "ring"])
def test_a_first_column_that_is_no_x_is_asked_about(
    first: str, count: int, relief: float, tmp_path: Path
) -> None:
    if first in ("strength", "256", "ring"):
        count = max(count, 150)  # fewer points do not show what is terrain
    rng, points = hills(count)
    points[:, 2] = relief * points[:, 2] + rng.normal(0, 0.02, count)
    strength, time = rng.uniform(0, 1, count), np.linspace(0.0, 0.1, count)
    columns = {
        "time": [time],
        "stamp": [1.7e9 + 100 * time],
        "packets": [np.floor(50 * time) / 50],
        "strength": [strength],
        "256": [255 * strength],
        "ring": [strength, rng.integers(0, 64, count)],
    }[first]
    path = tmp_path / "a.csv"
    for further in ([], [strength], [rng.integers(0, 256, (count, 3))]):
        np.savetxt(path, np.column_stack([*columns, points, *further]), fmt="%.6f", delimiter=",")
        assert_refused(lambda: read_cloud(path), "line 1: the first column seems to be no x but a")
        names = ["t", "ring"][: len(columns)] + list("xyzabc")[: 3 + np.size(further) // count]
        path.write_text("\n".join([",".join(names), path.read_text()]))
        np.testing.assert_allclose(read_cloud(path).points, points, atol=1e-6)


@pytest.mark.parametrize("count", [6, 60, 150, 3000])
@pytest.mark.parametrize("steep", [0.0, 1.0, 5.0])
def test_common_columns_need_no_names(steep: float, count: int, tmp_path: Path) -> None:
    rng, points = hills(count)
    points[:, 2] = steep * points[:, 2] + rng.normal(0, 0.02, count)
    normals = rng.normal([0, 0, 1], [0.2, 0.2, 0.02], (count, 3))
    strength = np.exp(-np.hypot(*points[:, :2].T) / 20) + rng.normal(0, 0.01, count)
    grid = np.stack(np.meshgrid(*[np.arange(0, 20, 0.5)] * 2, indexing="ij"), -1).reshape(-1, 2)
    raster = np.column_stack([grid, np.sin(grid[:, 0])])[::-1]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    path = tmp_path / "sorted.xyz"
    np.savetxt(path, np.hstack([points[np.argsort(points[:, 0])], normals]))
    assert len(read_cloud(path).points) == count
    for further in (
        strength,
        255 * strength,
        rng.integers(0, 256, (count, 3)),
        normals,
        normals**2,
    ):
        for cloud in (points, raster):
            rows = np.column_stack([cloud, np.resize(further, (len(cloud), further.size // count))])
            np.savetxt(tmp_path / "a.xyz", rows, fmt="%.6f")
            np.testing.assert_allclose(read_cloud(tmp_path / "a.xyz").points, cloud, atol=1e-6)


def test_a_first_column_of_a_grid_numbers_no_points(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(f"{k // 8},{k % 8}.5,0.1,7" for k in range(64)))
    assert len(load_cloud(tmp_path / "a.csv").points) == 64


@pytest.mark.parametrize("count", [16, 36, 2000])
@pytest.mark.parametrize("width", [3, 5, 6, 7, 8, 9, 10])
def test_rows_that_are_not_of_four_numbers_are_noticed(
    width: int, count: int, tmp_path: Path
) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "a.bin"
    strength, ring = rng.uniform(0, 1, count), rng.integers(0, 32, count)
    normals = rng.normal([0, 0, 1], [0.2, 0.2, 0.02], (count, 3))
    level = rng.normal(0, [[20], [10]], (2, count))
    ground = np.column_stack([*level, rng.normal(-1.7, 0.1, count)])
    colours = rng.integers(0, 256, (count, 3))
    layouts = [
        (strength, ring, *rng.uniform(0, 0.1, (5, count))),
        (*normals.T, strength, *colours.T),
        (*colours.T, strength, *normals.T),
        (np.ones(count), 255 * strength, *np.zeros((5, count))),  # as PCL lays them out
    ]
    for further in layouts:
        rows = np.column_stack([ground, *further])[:, :width].astype("<f4")
        rows.tofile(path)
        assert_refused(lambda: read_cloud(path), f"seems to have {width} numbers a point")
        rows.astype("<f8")[:, :7].tofile(path)
        assert_refused(lambda: read_cloud(path), f"seems to have {min(width, 7)} 64-bit numbers")


@pytest.mark.parametrize("count", [1, 6, 15, 60, 105, 2100])
def test_rows_of_four_numbers_are_points_whatever_they_are(count: int, tmp_path: Path) -> None:
    rng, path = np.random.default_rng(0), tmp_path / "b.bin"
    angle = np.linspace(0, 6, count)
    height = np.array([-1.7, 0.5, -1.6, 4.0])[np.arange(count) % 4]  # lasers that take turns
    ring = np.column_stack([9 * np.cos(angle), 9 * np.sin(angle), height])
    flat = rng.normal(0, [20, 10, 0.1], (count, 3))
    holes = np.where(np.arange(count)[:, None] % 5 == 4, np.nan, flat)
    for points in (ring, flat, holes, np.add(flat, [5e5, 4e6, 90]), rng.normal(size=(count, 3))):
        for strength in (rng.uniform(0, 1, count), np.zeros(count), rng.normal(size=count)):
            rows = np.column_stack([points, strength]).astype("<f4")
            rows.tofile(path)
            np.testing.assert_array_equal(read_cloud(path).points, rows[:, :3])


FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


def write_las(
    path: Path,
    named: str | tuple[int, ...],
    unit: tuple[float, ...] = (1.0, 1.0, 1.0),
    *,
    last: bool = False,
) -> Path:
    """Write `POINTS` in units [m], with well-known text or keys; `last` puts it after them."""
    if isinstance(named, str):
        header = laspy.LasHeader(point_format=6, version="1.4")
        record = laspy.VLR("LASF_Projection", 2112, "", named.encode() + b"\0")
    else:
        header = laspy.LasHeader(point_format=0, version="1.2")
        content = np.array([1, 1, 0, len(named) // 4, *named], "<u2").tobytes()
        record = laspy.VLR("LASF_Projection", 34735, "", content)
    header.scales = np.full(3, 1e-4)
    if not last:
        header.vlrs.append(record)
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = (POINTS / unit).T
    if last:
        scan.evlrs = laspy.vlrs.vlrlist.VLRList([record])
    scan.write(path)
    return path


def text_of(system: str, version: str = "WKT1_GDAL") -> str:
    return pyproj.CRS(system).to_wkt(version)


@pytest.mark.parametrize(
    ("named", "flat", "height"),
    [
        ("", 1.0, 1.0),
        (text_of("EPSG:32633"), 1.0, 1.0),
        (text_of("EPSG:2227"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2227", "WKT2_2019"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2264+6360"), SURVEY_FOOT, SURVEY_FOOT),
        (text_of("EPSG:2264+5703"), SURVEY_FOOT, 1.0),
        (text_of("EPSG:26917+6360"), 1.0, SURVEY_FOOT),
        (text_of("EPSG:2256"), FOOT, FOOT),
        ('LOCAL_CS["site",UNIT["foot",0.3048]]', FOOT, FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 2227), SURVEY_FOOT, SURVEY_FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 2227, 4096, 0, 1, 5703), SURVEY_FOOT, 1.0),
        ((1024, 0, 1, 1, 3072, 0, 1, 26917, 4096, 0, 1, 6360), 1.0, SURVEY_FOOT),
        # The first GeoTIFF's code of NAVD 88 says nothing of the unit.
        ((1024, 0, 1, 1, 3072, 0, 1, 26917, 4096, 0, 1, 5103), 1.0, 1.0),
        ((3072, 0, 1, 26917, 4096, 0, 1, 5103, 4099, 0, 1, 9003), 1.0, SURVEY_FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 32767, 3076, 0, 1, 9002), FOOT, FOOT),
        ((1024, 0, 1, 1, 3072, 0, 1, 12, 3076, 0, 1, 9002), FOOT, FOOT),
    ],
)
def test_text_and_keys_give_the_units(
    named: str | tuple[int, ...], flat: float, height: float, tmp_path: Path
) -> None:
    unit = (flat, flat, height)
    paths = [write_las(tmp_path / "000.las", named, unit, last=isinstance(named, str))]
    if isinstance(named, str):
        paths.append(write_las(tmp_path / "000.laz", named, unit))
    for path in paths:
        np.testing.assert_allclose(read_las(path).points, POINTS, atol=6e-5)


EARTH_CENTRED = "is in geocentric coordinates, whose z is not up; project it"
DEPTHS = "has depths, which count downwards"


def test_units_that_are_not_known(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "000.las"
    for named, rule in (
        (text_of("EPSG:4326"), "is in degrees; project it"),
        ((1024, 0, 1, 2, 2048, 0, 1, 4326), "is in degrees; project it"),
        ("PROJCS[", "PROJ does not know its coordinate system 'PROJCS['"),
        ((1024, 0, 1, 1, 3072, 0, 1, 12), "PROJ does not know its coordinate system 12"),
        ((3076, 0, 1, 9999), "is in '9999', which is no known unit of length"),
        ((3076, 0, 1, 32767, 3077, 34736, 1, 0), "is in a unit of its own"),
        ((2048, 0, 1, 4326), "is in degrees"),
        ((1024, 0, 1, 3), "is in geocentric coordinates"),
        *((text_of("EPSG:4978", kind), EARTH_CENTRED) for kind in ("WKT1_GDAL", "WKT2_2019")),
        ((1024, 0, 1, 2, 2048, 0, 1, 4978), EARTH_CENTRED),
        ((1024, 0, 1, 1, 3072, 0, 1, 4978, 3076, 0, 1, 9001), EARTH_CENTRED),
        (text_of("EPSG:3857"), "is in Mercator"),
        (text_of("EPSG:3395", "WKT1_GDAL"), "is in Mercator"),
        ((1024, 0, 1, 1, 3072, 0, 1, 3857), "is in Mercator"),
        (text_of("EPSG:32633+5715"), DEPTHS),
        (text_of("EPSG:26917+6358", "WKT2_2019"), DEPTHS),
        ((3072, 0, 1, 32633, 4096, 0, 1, 5715), DEPTHS),
        ((3072, 0, 1, 32633, 4096, 0, 1, 5715, 4099, 0, 1, 9001), DEPTHS),
    ):
        write_las(path, named)
        assert_refused(lambda: read_las(path), str(path), rule)
    assert capfd.readouterr() == ("", "")
