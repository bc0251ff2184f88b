"""`gpgrad evaluate`, as a process."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from gpgrad_core.io.folder import write_dataset
from tests.core.evaluation import squares
from tests.core.evaluation.test_registration_benchmark import write
from tests.end_to_end.process import gpgrad, run_on_terminal

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def report(with_truth: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "report"
    finished = gpgrad(
        "evaluate", with_truth, "--out", folder, "--seed", "3", "--num-resamples", "10"
    )
    assert finished.code == 0, finished.err
    assert finished.err == ""
    told, where = finished.out.splitlines()
    assert told.startswith("gradient: AP 1.000, R100 1.000, accepts 1 true and 0 false pairs")
    assert where == str(folder / "report.md")
    return folder


@pytest.mark.slow
def test_the_revisit_is_judged(report: Path) -> None:
    content = json.loads((report / "report.json").read_text())
    assert content["seed"] == 3
    (method,) = content["methods"]
    box = method["rules"]["box"]
    assert (box["accepted_true"], box["accepted_false"], box["missed"]) == (1, 0, 0)
    assert box["pose_error"]["median_offset"] < 0.1
    assert box["pose_error"]["near"] == 1.0
    assert {path.suffix for path in report.iterdir()} == {".html", ".json", ".md", ".png"}


@pytest.mark.slow
def test_what_was_found_can_be_judged_again_otherwise(
    with_truth: Path, report: Path, tmp_path: Path
) -> None:
    content = json.loads((report / "closures_gradient.json").read_text())
    assert content["params"]["registration"]["seed"] == 3
    content["method"] = "a tool of mine"
    content["pairs"] = [pair for pair in content["pairs"] if pair["query"] == "003"]
    mine = tmp_path / "mine.json"
    mine.write_text(json.dumps(content))
    finished = gpgrad(
        *("evaluate", with_truth, "--out", tmp_path / "again", "--min-overlap", "0.99"),
        *("--closures", report / "closures_gradient.json", mine, "--neighbours", "0"),
        *("--protocol", "paper"),
    )
    assert finished.code == 0, finished.err
    assert finished.err == "gpgrad: a tool of mine lists 3 of 6 pairs: the others rank last\n"
    content = json.loads((tmp_path / "again" / "report.json").read_text())
    assert [method["name"] for method in content["methods"]] == ["gradient", "a tool of mine"]
    assert len(content["protocols"]["by_inliers"]) == 8
    assert "## The paper's protocol" in (tmp_path / "again" / "report.md").read_text()
    assert content["rules"][0]["true"] == 0  # none overlaps so far
    assert content["rules"][1]["true"] == 1
    first, second = (method["rules"]["surface"] for method in content["methods"])
    assert first["pose_error"] == second["pose_error"]


@pytest.mark.slow
def test_the_least_file_of_the_leaderboard_is_judged(with_truth: Path, tmp_path: Path) -> None:
    page = (ROOT / "assets" / "guide" / "leaderboard.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"^```json\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    mine = tmp_path / "mine.json"
    mine.write_text(example)
    finished = gpgrad(
        *("evaluate", with_truth, "--out", tmp_path / "r", "--closures", mine),
        *("--num-resamples", "0"),
    )
    assert finished.code == 0, finished.err
    assert finished.err == "gpgrad: a tool of mine lists 1 of 6 pairs: the others rank last\n"
    assert finished.out.startswith("a tool of mine: AP ")


@pytest.mark.slow
def test_an_interrupt_leaves_nothing(with_truth: Path, tmp_path: Path) -> None:
    out = tmp_path / "r"
    code, seen = run_on_terminal("evaluate", with_truth, "--out", out, interrupt_at=b"evaluate")
    assert code == 130
    assert "gpgrad: interrupted" in seen
    assert "Traceback" not in seen
    assert not out.exists()


@pytest.mark.slow
def test_the_command_compares_only_the_listed_pairs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    write_dataset(squares.DATASET, tmp_path / "squares")
    file = write(tmp_path / "p.txt", "1 003.pcd 000.pcd 0.8 1 0 0 3 0 1 0 4 0 0 1 0")
    right = squares.closure("003", "000", 1.0, squares.RIGHT, 20, accepted=True)
    asked: list[object] = []

    def noted(*_: object, **options: Any) -> object:
        asked.append(options["only"])
        return {"tool": squares.report(right)}

    monkeypatch.setattr("gpgrad_core.evaluation.run_methods", noted)
    out = ("--out", tmp_path / "report", "--pairs", file)
    finished = gpgrad("evaluate", tmp_path / "squares", *out)
    assert finished.code == 0, finished.err
    assert asked == [{("003", "000")}]
    assert "only the 1 listed of 10 pairs are compared and judged" in finished.err
    assert "accepts 1 true and 0 false pairs" in finished.out
