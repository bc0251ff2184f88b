"""The registration benchmark's problems: read, judged, and refused where they are wrong."""

import json
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.detection import detect_loop_closures
from gpgrad_core.evaluation import evaluate, measure_pairs, read_problems
from gpgrad_core.evaluation.registration_benchmark import check_problems, describe_problems
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration, Submap
from tests.core.evaluation.squares import DATASET, PAIRS, RESULT, RIGHT, closure, report
from tests.support.refusal import assert_refused

HEADER = "id source target overlap scale t1 t2 t3 t4 t5 t6 t7 t8 t9 t10 t11 t12"
ROW = (
    "27844314100030 p2at_met_080.pcd p2at_met_031.pcd 0.11 2.86 -0.8839258089330189 "
    "-0.33998087621083517 0.3210734621749685 -67.08498894577622 0.24394905652608567 "
    "-0.9210212980915355 -0.30365873325464465 -210.03578688696183 0.3989536591161194 "
    "-0.19008622325854016 0.8970525099486447 -26.928575376191226"
)
"""The first row of the benchmark's own p2at_met_global.txt."""


def write(path: Path, *rows: str) -> Path:
    path.write_text("\n".join(rows) + "\n")
    return path


def test_the_benchmarks_own_row(tmp_path: Path) -> None:
    (one,) = read_problems(write(tmp_path / "p.txt", HEADER, ROW))
    assert (one.id, one.source, one.target) == ("27844314100030", "p2at_met_080", "p2at_met_031")
    assert one.overlap == 0.11
    np.testing.assert_allclose(one.misplacement.translation, [-67.08499, -210.035787, -26.928575])
    assert one.misplacement.rotation[0, 2] == pytest.approx(0.3210734621749685)
    # Without a header, and without the scale, as the benchmark's README gives the columns.
    bare = ROW.replace(" 2.86 ", " ")
    (again,) = read_problems(write(tmp_path / "q.txt", bare))
    np.testing.assert_allclose(again.misplacement.rotation, one.misplacement.rotation)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ((HEADER,), "holds no problems"),
        ((HEADER.replace("scale", "size"), ROW), "line 1: names other columns"),
        ((HEADER, ROW.rsplit(" ", 1)[0]), "line 2: has 16 columns, the rows before it have 17"),
        ((ROW.rsplit(" ", 2)[0],), "line 1: has 15 columns"),
        ((HEADER, ROW.replace("-0.8839258089330189", "0.1")), "line 2: the first three columns"),
        ((HEADER, ROW.replace("-67.08498894577622", "far")), "line 2: holds something that is not"),
        ((HEADER, ROW.replace("0.11", "-1")), "line 2: the overlap"),
        ((HEADER, ROW.replace("031", "080")), "places the cloud p2at_met_080 on itself"),
    ],
)
def test_wrong_files(rows: tuple[str, ...], said: str, tmp_path: Path) -> None:
    path = tmp_path / "p.txt"
    assert_refused(lambda: read_problems(path), "p.txt: no such file")
    assert_refused(lambda: read_problems(write(path, *rows)), str(path), said)


def test_the_benchmarks_error(tmp_path: Path) -> None:
    """The errors are those that the benchmark's own formula gives."""
    misplaced = "1 0 0 3 0 1 0 4 0 0 1 0"
    path = write(
        tmp_path / "squares_global.txt",
        f"1 000.pcd 003.pcd 0.8 {misplaced}",
        f"2 000.pcd 004.pcd 0.7 {misplaced}",
        f"3 000.pcd box_map.pcd 0.7 {misplaced}",
    )
    problems = read_problems(path)
    check_problems(problems, DATASET, path)
    right = closure("003", "000", 1.0, RIGHT, 20, accepted=True)
    off = closure("004", "000", 1.0, SE2(3.3, 0.0, 0.0), 20, accepted=True)
    evaluation = evaluate(DATASET, {"tool": report(right, off)})
    section = describe_problems(problems, DATASET, evaluation, path)
    json.dumps(section.content)
    assert (section.content["problems"], section.content["held"]) == (3, 2)
    first, second = section.content["pairs"]
    assert first["methods"]["tool"]["error"] == pytest.approx(0.0, abs=1e-9)
    source = DATASET.submap("000")
    true = source.pose_true.apply(source.points)
    weights = np.linalg.norm(true - true.mean(axis=0), axis=1)
    # An offset of 0.3 m moves all points by 0.3 m, in whichever direction it was found.
    assert second["methods"]["tool"]["error"] == pytest.approx(np.mean(0.3 / weights), rel=1e-6)
    assert second["error_misplaced"] == pytest.approx(np.mean(5.0 / weights), rel=1e-6)
    assert second["methods"]["tool"]["right"]
    assert "| tool | 2 | 2 | 2 | 2 |" in section.text
    assert "2 of the 3 problems of squares_global.txt" in section.text


def test_a_file_of_another_dataset(tmp_path: Path) -> None:
    path = write(tmp_path / "p.txt", HEADER, ROW)
    assert_refused(
        lambda: check_problems(read_problems(path), DATASET, path),
        *(str(path), "p2at_met_080 and p2at_met_031", "squares"),
    )


def test_only_the_listed_pairs_are_compared_and_measured() -> None:
    compared: list[tuple[str, str]] = []

    def note(query: Submap, database: Submap) -> Registration:
        compared.append((query.id, database.id))
        return closure("003", "000").registration

    only = {("000", "003"), ("001", "elsewhere")}
    result = detect_loop_closures(DATASET, detector=note, only=only)
    assert compared == [("003", "000")]
    assert [one.pair for one in result.closures] == compared
    pairs = measure_pairs(DATASET, only=only)
    assert [pairs.ids[k] for k in (*pairs.query, *pairs.database)] == ["003", "000"]
    assert "only the 1 listed of 10 pairs" in pairs.notes[-1]
    assert pairs.surface_overlap[0] == PAIRS.surface_overlap[PAIRS.rows[frozenset(compared[0])]]
    judged = evaluate(DATASET, {"mine": RESULT}, pairs=pairs)
    assert judged.methods[0].ranking.score.shape == (1,)
    assert_refused(
        lambda: measure_pairs(DATASET, only=[("a", "b")]), "squares", "none of the pairs"
    )
