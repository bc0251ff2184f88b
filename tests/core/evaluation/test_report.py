"""What lies in the folder of a report."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import matplotlib as mpl
import pytest

from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import (
    Evaluation,
    EvaluationParams,
    Section,
    check_directory,
    describe_protocol,
    evaluate,
    report_evaluation,
    write_report,
)
from gpgrad_core.evaluation.plots import report as plots
from gpgrad_core.evaluation.plots.style import in_print
from gpgrad_core.evaluation.report import describe
from gpgrad_core.io.records.closures import read_closures
from gpgrad_core.run import Cancelled
from gpgrad_core.types import Dataset
from tests.core.evaluation.squares import DATASET, RESULT, RIGHT, closure, report
from tests.support.cancelling import cancelling
from tests.support.closures import content_of

OTHER = report(closure("003", "000", 2.0, RIGHT, accepted=True))


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    return evaluate(DATASET, {"mine": RESULT, "other": OTHER}, EvaluationParams(num_resamples=20))


@pytest.fixture(scope="module")
def folder(evaluation: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole report, drawn once: it takes some seconds."""
    path = tmp_path_factory.mktemp("out") / "report"
    write_report(path, evaluation, closures={"other": OTHER})
    return path


@dataclass
class Picture:
    """A picture that is drawn at once, or that cannot be drawn to its end."""

    spoilt: bool = False

    def savefig(self, fname: Path) -> None:
        fname.write_bytes(b"half of a")
        if self.spoilt:
            raise OSError("no space left")


@pytest.fixture
def pictures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Picture]:
    """What is drawn in place of the figures."""
    drawn = {name: Picture() for name in ("first", "second", "third")}
    monkeypatch.setattr(plots, "draw_report", lambda _: dict(drawn))
    return drawn


def test_the_folder_holds_what_was_promised(folder: Path) -> None:
    names = {path.name for path in folder.iterdir()}
    curves = {"precision_recall.png", "precision_recall_by_inliers.png", "precision_by_inliers.png"}
    each = {f"{what}_{name}.png" for what in ("affinity", "loops") for name in ("mine", "other")}
    assert names == {"report.md", "report.json", "closures_other.json"} | curves | each
    for name in curves | each:
        picture = cv2.imread(str(folder / name))
        assert min(picture.shape[:2]) > 400
        assert picture.std() > 5  # not blank
    assert content_of(read_closures(folder / "closures_other.json")) == content_of(OTHER)


def test_the_json_holds_the_figures(folder: Path) -> None:
    content = json.loads((folder / "report.json").read_text())
    assert content["dataset"] == "squares"
    assert [rule["name"] for rule in content["rules"]] == ["box IoU > 0.3", "surface overlap > 0.2"]
    assert [(rule["true"], rule["false"], rule["grey"]) for rule in content["rules"]] == [
        (1, 4, 1),
        (2, 4, 0),
    ]
    mine, other = content["methods"]
    assert mine["name"] == "mine"
    assert mine["seconds"]["total"] == 1.75
    assert (mine["accepted"], mine["accepted_right"]) == (3, 2)
    assert (mine["accepted_wrong_motion"], mine["accepted_no_overlap"]) == (0, 1)
    ranked = mine["rules"]["box"]["ranked"]
    assert ranked["average_precision"]["value"] == 1.0
    assert ranked["by_score"]["thresholds"][0] == 9.0
    assert ranked["by_inliers"]["thresholds"] == list(range(1, 21))
    assert ranked["lead"] is None
    assert other["rules"]["box"]["ranked"]["lead"]["value"] == 0.0
    assert other["rules"]["box"]["ranked"]["by_score"]["thresholds"] == [2.0, None]
    assert len(content["pairs"]) == 10
    (pair,) = [p for p in content["pairs"] if (p["query"], p["database"]) == ("003", "000")]
    assert pair["methods"]["mine"]["offset_error"] == pytest.approx(0.05)
    assert pair["methods"]["other"]["offset_error"] == pytest.approx(0, abs=1e-9)
    assert content["notes"] == ["other lists 1 of 10 pairs: the others rank last"]
    assert all((folder / name).exists() for name in content["figures"])


def test_every_table_names_its_rule(folder: Path) -> None:
    text = (folder / "report.md").read_text()
    tables = re.findall(r"((?:^\|.*\n)+)", text, flags=re.MULTILINE)
    assert len(tables) == 1 + 2 * 5 + 1
    before = re.split(r"(?:^\|.*\n)+", text, flags=re.MULTILINE)
    for heading in before[:-2]:  # the last table is of times
        assert re.search(r"\*.*left out.*\*\n\n$", heading), heading
    widths = {len({row.count("|") for row in table.splitlines()}) for table in tables}
    assert widths == {1}  # no row is longer than its header
    for name in re.findall(r"\]\((.*?)\)", text):
        assert (folder / name).exists()
    assert "Note: other lists 1 of 10 pairs" in text
    assert "| mine | 1 | 1 | 1 | 1 | 0 | 5.0 cm |" in text
    assert "| mine | 3 | 2 | 0 | 1 |" in text


def test_without_true_pairs_there_is_a_report_all_the_same() -> None:
    params = EvaluationParams(min_overlap=0.95, min_surface_overlap=0.95)
    nothing_true = evaluate(DATASET, {"mine": RESULT}, params)
    assert describe(nothing_true).count("No pair is true by this rule") == 2
    assert report_evaluation(nothing_true)["methods"][0]["rules"]["box"]["ranked"] is None
    assert set(plots.draw_report(nothing_true)) == {"affinity_mine", "loops_mine"}


@pytest.mark.usefixtures("pictures")
def test_a_section_is_told_where_the_rest_is(evaluation: Evaluation, tmp_path: Path) -> None:
    section = Section("calibration", {"coverage": 0.68}, "## Calibration\n\nGood.\n")
    write_report(tmp_path, evaluation, sections=[section])
    assert json.loads((tmp_path / "report.json").read_text())["calibration"] == {"coverage": 0.68}
    assert (tmp_path / "report.md").read_text().endswith("## Calibration\n\nGood.\n")


@pytest.mark.usefixtures("pictures")
def test_a_stop_leaves_the_older_report(evaluation: Evaluation, tmp_path: Path) -> None:
    (tmp_path / "report.md").write_text("older")
    with pytest.raises(Cancelled):
        write_report(tmp_path, evaluation, progress=cancelling(0.5))
    assert (tmp_path / "report.md").read_text() == "older"
    assert not (tmp_path / "report.json").exists()
    assert {path.name for path in tmp_path.iterdir()} == {"report.md", "first.png", "second.png"}


def test_a_failure_leaves_no_half_of_a_figure(
    evaluation: Evaluation, tmp_path: Path, pictures: dict[str, Picture]
) -> None:
    pictures["second"].spoilt = True
    with pytest.raises(OSError, match="no space left"):
        write_report(tmp_path, evaluation)
    assert {path.name for path in tmp_path.iterdir()} == {"first.png"}


def test_where_nothing_can_be_written_is_said_before_the_work(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="is a file; give the name of a folder"):
        check_directory(file)
    with pytest.raises(InputError, match=r"there is no folder .*no; make it first"):
        check_directory(tmp_path / "no" / "report")
    assert check_directory(tmp_path / "new") == tmp_path / "new"
    assert not (tmp_path / "new").exists()


def test_figures_leave_matplotlibs_state_alone() -> None:
    before = dict(mpl.rcParams)
    folder = Path(plots.__file__).parent
    assert not any("pyplot" in path.read_text(encoding="utf-8") for path in folder.glob("*.py"))
    with in_print():
        assert dict(mpl.rcParams) != before
    assert dict(mpl.rcParams) == before


def protocol_of(dataset: Dataset, result: DetectionResult) -> Section:
    detections = {"mine": result}
    judged = evaluate(dataset, detections, EvaluationParams(num_resamples=0))
    return describe_protocol(dataset, detections, judged)


def test_both_protocols_are_counted_side_by_side() -> None:
    """000-003 overlaps by 0.6, the neighbours 003-004 by 0.33, and 000-004 by 0.14."""
    section = protocol_of(DATASET, RESULT)
    etna, morocco, ours, surface = section.content["by_inliers"]
    assert [row["protocol"] for row in (etna, morocco, ours, surface)] == [
        "paper's, box IoU > 0.3",
        "paper's, box IoU > 0.1",
        "ours, box IoU > 0.3",
        "ours, surface overlap > 0.2",
    ]
    # Neighbours are judged, and what overlaps a little is false.
    assert (etna["true"], etna["false"], etna["left_out"]) == (2, 8, 0)
    assert (etna["found_from_4"], etna["found_from_5"]) == ((1, 3), (1, 2))
    assert etna["false_placed_right"] == 1  # 000-004
    assert etna["right_from"] == 10
    assert etna["average_precision"] == pytest.approx(0.5 * 1 + 0.5 * 0.2)
    assert etna["recall_at_full_precision"] == 0.5
    assert (morocco["true"], morocco["false"], morocco["left_out"]) == (3, 7, 0)
    assert (morocco["found_from_5"], morocco["right_from"]) == ((2, 1), 7)
    assert (ours["true"], ours["false"], ours["left_out"]) == (1, 4, 5)
    assert (ours["found_from_5"], ours["false_placed_right"]) == ((1, 1), 0)
    assert "| paper's, box IoU > 0.3 | mine | 2 | 8 | 0 | 0.600 | 0.500 | 10 |" in section.text
    assert "| 0.33 (0.50) | 2 | 1 |" in section.text


def test_nothing_true_has_no_precision() -> None:
    apart = Dataset("apart", DATASET.submaps[:3])
    text = protocol_of(apart, DetectionResult((), {})).text
    assert "| mine | 0 | 3 | 0 | n/a | n/a | none | n/a | n/a | 0 | 0 |" in text
