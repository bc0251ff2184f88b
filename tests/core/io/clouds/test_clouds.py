"""What a sound file holds is read: every layout of the formats, and notes on what is left out."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpgrad_core.io.clouds import load_cloud, load_cloud_with_notes, read_cloud
from gpgrad_core.io.clouds.pcd import decompress_lzf
from gpgrad_core.io.clouds.ply import write_ply
from tests.core.io.test_formats import WORLD
from tests.support.laws import examples
from tests.support.refusal import assert_refused

TABLE = [[1.0, 2.0, 3.0], [4.0, 6.5, 7.0], [-1.0, 0.25, 1e-3]]
FAR = np.random.default_rng(0).uniform(5e6, 5e6 + 10, (10, 3))


@examples(50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(offsets=hnp.arrays(np.float64, (20, 3), elements=st.floats(-300, 300, width=32)))
def test_written_points_come_back_within_float32(offsets: np.ndarray, tmp_path: Path) -> None:
    # A square under the drawn points, because points on one line are no terrain.
    points = np.vstack([offsets, [[0, 0, 0], [9, 0, 0], [0, 9, 0]]])
    write_ply(tmp_path / "a.ply", points)
    expected = points.astype(np.float32).astype(np.float64)
    np.testing.assert_array_equal(load_cloud(tmp_path / "a.ply").points, expected)


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


@pytest.mark.parametrize("order", ["little", "big"])
def test_other_properties_and_elements_of_a_ply_are_passed_over(order: str, tmp_path: Path) -> None:
    path, mark = tmp_path / "a.ply", {"little": "<", "big": ">"}[order]
    kinds = [("r", "u1"), ("z", "f8"), ("x", "f8"), ("n", "i2"), ("y", "f4")]
    table = np.zeros(10, [(name, mark + kind) for name, kind in kinds])
    points = FAR.astype(np.float32).astype(np.float64)
    for axis, name in enumerate("xyz"):
        table[name] = points[:, axis]
    header = (
        f"ply\nformat binary_{order}_endian 1.0\ncomment made for a test\nelement camera 2\n"
        "property float fx\nproperty uchar id\nelement vertex 10\nproperty uchar red\n"
        "property double z\nproperty double x\nproperty short n\nproperty float y\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode() + b"\x07" * 10 + table.tobytes() + b"\x03" + b"\x00" * 12)
    np.testing.assert_array_equal(load_cloud(path).points, points)


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
    path.write_bytes(header.format("binary").encode() + table.tobytes())
    np.testing.assert_array_equal(load_cloud(path).points, FAR)
    rows = "".join(f"0 0 0 {x!r} {y!r} {z!r}\n" for x, y, z in FAR.tolist())
    path.write_text(header.format("ascii") + rows)
    np.testing.assert_array_equal(load_cloud(path).points, FAR)
    path.write_text(header.format("ascii") + rows.replace("0 0 0", "0 0 0 up", 1))
    assert_refused(lambda: load_cloud(path), "line 12: 'up' is not a number")


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
    for path in (tmp_path / "a.xyz", tmp_path / "a.csv"):
        path.write_text(text, encoding="utf-8")
        np.testing.assert_array_equal(load_cloud(path).points, TABLE)


def test_npz_takes_the_only_array_of_points(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", cloud=FAR.astype(int), stamp=np.arange(3))
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npz").points, FAR.astype(int))
