"""PLY against an outside writer, and cut at every place."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from gpgrad_core.io.clouds import load_cloud
from gpgrad_core.io.clouds.ply import write_ply
from tests.support.laws import examples
from tests.support.refusal import assert_refused

ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    return np.random.default_rng(5).normal(size=(50, 3)).astype(np.float32).astype(np.float64)


def ply(layout: str, vertex: list[str], count: int, before: str = "", after: str = "") -> bytes:
    lines = [
        "ply",
        f"format {layout} 1.0",
        "comment made for a test",
        *before.splitlines(),
        f"element vertex {count}",
        *(f"property {line}" for line in vertex),
        *after.splitlines(),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode()


def test_what_is_written_trimesh_reads(points: np.ndarray, tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", points)
    np.testing.assert_array_equal(trimesh.load(tmp_path / "a.ply").vertices, points)


@pytest.mark.parametrize("layout", ORDERS)
def test_other_properties_and_elements_are_passed_over(
    layout: str, points: np.ndarray, tmp_path: Path
) -> None:
    order = ORDERS[layout]
    table = np.zeros(
        len(points),
        [("r", "u1"), ("z", order + "f8"), ("x", order + "f8"), ("n", order + "i2"), ("y", "f4")],
    )
    table["y"] = points[:, 1]
    table["y"] = table["y"].astype(order + "f4").view("f4")
    table["x"], table["z"] = points[:, 0], points[:, 2]
    header = ply(
        layout,
        ["uchar red", "double z", "double x", "short n", "float y"],
        len(points),
        before="element camera 2\nproperty float fx\nproperty uchar id",
        after="element face 1\nproperty list uchar int vertex_indices",
    )
    path = tmp_path / "a.ply"
    path.write_bytes(header + b"\x07" * 10 + table.tobytes() + b"\x03" + b"\x00" * 12)
    np.testing.assert_array_equal(load_cloud(path).points, points)


def test_ascii_keeps_double_precision(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(5e6, 5e6 + 10, (10, 3))
    rows = "\n".join(f"{x!r} 1 {y!r} {z!r}" for x, y, z in points.tolist())
    header = ply("ascii", ["double x", "uchar red", "double y", "double z"], 10, after="")
    path = tmp_path / "a.ply"
    path.write_bytes(header + rows.encode() + b"\n")
    np.testing.assert_array_equal(load_cloud(path).points, points)
    # Lines that end as they do on Windows, and no end of the last line.
    path.write_bytes((header + rows.encode()).replace(b"\n", b"\r\n"))
    np.testing.assert_array_equal(load_cloud(path).points, points)


@examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0.0, 0.999), layout=st.sampled_from(["ascii", *ORDERS]))
def test_a_cut_file_never_passes(
    share: float, layout: str, points: np.ndarray, tmp_path: Path
) -> None:
    body = points.astype(ORDERS.get(layout, "<") + "f4").tobytes()
    if layout == "ascii":
        body = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points).encode()
    whole = ply(layout, ["float x", "float y", "float z"], len(points)) + body
    path = tmp_path / "a.ply"
    # The last digits of an ascii file can go unseen; two characters short cannot.
    path.write_bytes(whole[: min(int(share * len(whole)), len(whole) - 26)])
    assert_refused(lambda: load_cloud(path), str(path))


def test_a_cut_file_says_what_is_missing(points: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    write_ply(path, points)
    path.write_bytes(path.read_bytes()[:-30])
    assert_refused(lambda: load_cloud(path), "promises 50 points, but the file ends after 47;")
    rows = "".join(f"{x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in points)
    header = ply("ascii", ["float x", "float y", "float z"], 50)
    path.write_bytes(header + rows[:-30].encode())
    assert_refused(lambda: load_cloud(path), "promises 50 points, but the file ends after 48;")


@pytest.mark.parametrize(
    ("data", "rule"),
    [
        (b"", "not a PLY"),
        (b"solid stl", "not a PLY"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", "no 'end_header'"),
        (b"ply\nelement vertex 3\nend_header\n", "no 'format'"),
        (b"ply\nformat binary_middle_endian 1.0\nend_header\n", "line 2: format"),
        (b"ply\nformat ascii 1.0\nend_header\n", "no 'element vertex'"),
        (b"ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "line 3"),
        (ply("ascii", ["float x", "float y"], 1) + b"1 2\n", "no property z"),
        (ply("ascii", ["quad x"], 1) + b"1\n", "line 5: 'property quad x'"),
        (
            ply("ascii", ["float x", "float y", "float z"], 2) + b"1 2 3\n4 5 up\n",
            "line 10: 'up' is not a number",
        ),
        (
            ply("binary_little_endian", ["list uchar float w", "float x"], 1),
            "no property y or z",
        ),
        (
            ply("binary_little_endian", ["float x", "float y", "float z", "list uchar int w"], 1),
            "does not hold 1 rows of 'element vertex'",
        ),
        (ply("ascii", ["float x", "float y", "float z"], 0), "empty cloud"),
    ],
)
def test_broken_headers_and_rows(data: bytes, rule: str, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(data)
    assert_refused(lambda: load_cloud(path), str(path), rule)
