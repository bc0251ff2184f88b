"""XYZ and CSV: columns by name, by place, and every bad row by its line."""

from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.io.clouds import load_cloud
from tests.support.refusal import assert_refused

EXPECTED = [[1.0, 2.0, 3.0], [4.0, 6.5, 7.0], [-1.0, 0.25, 1e-3]]


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
    ],
)
@pytest.mark.parametrize("ending", [".xyz", ".csv"])
def test_columns_are_found(text: str, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(load_cloud(path).points, EXPECTED)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("1 2 3\n4 five 6\n7 8 9\n", ["line 2", "'five' is not a number"]),
        ("x,y,z\n1,2,3\n\n4,5,six\n", ["line 4", "'six' is not a number"]),
        ("# hand\n1 2 3\n4 5\n7 8 9\n", ["line 3", "has 2 columns", "need 3", "'4 5'"]),
        ("id,x,y,z\n1,2,3,4\n7\n", ["line 3", "has 1 column,", "need 4"]),
        ("lon,lat,height\n1,2,3\n", ["line 1", "'lon' is not", "name the columns x, y and z"]),
        ("1.5;2,5;3\n", ["line 1", "is not a number"]),
        ("", ["empty cloud"]),
        ("x,y,z\n", ["empty cloud"]),
        ("# nothing\n\n", ["empty cloud"]),
    ],
)
def test_bad_rows_are_named_by_line(text: str, parts: list[str], tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)
    assert_refused(lambda: load_cloud(path), str(path), *parts)


def test_empty_fields_count_as_not_finite(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("x,y,z\n1,2,3\n4,,6\n7,9,9\nnan,1,1\n0,1,5\n")
    submap = load_cloud(path)
    assert submap.num_dropped == 2
    np.testing.assert_array_equal(submap.points, [[1, 2, 3], [7, 9, 9], [0, 1, 5]])


def test_what_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(bytes(range(256)) * 4)
    assert_refused(lambda: load_cloud(path), str(path), "not text")
