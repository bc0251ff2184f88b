"""closures.json holds what the contract promises, and comes back as it went."""

import json
import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import pytest

from gpgrad_core import __version__
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.io.records.closures import (
    ClosureReport,
    ClosureWriter,
    Decision,
    count_images,
    read_closures,
    report_closures,
    restore_closures,
    write_closure_table,
    write_closures,
)
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, ImageVerdict, LoopClosure, Registration, Submap
from tests.support.closures import content_of
from tests.support.refusal import assert_file_refused


@pytest.fixture
def dataset() -> Dataset:
    clouds = np.random.default_rng(0).normal(size=(3, 10, 3))
    submaps = (Submap.from_points(points, f"00{2 * k}") for k, points in enumerate(clouds))
    return Dataset("crater", tuple(submaps))


@pytest.fixture
def result() -> DetectionResult:
    placed = Registration(
        SE2(5.1, 4.9, np.pi - 0.01), np.array([True] * 9 + [False]), 0.123456789012, 20.0, 0.8, 44.0
    )
    lost = Registration(None, np.zeros(0, dtype=bool), float("inf"), 0.0, 0.0, 0.0)
    return DetectionResult(
        closures=(
            LoopClosure("002", "000", lost, accepted=False, reason="no associations"),
            LoopClosure("004", "000", placed, accepted=True, reason="9 inliers >= 8"),
            LoopClosure("004", "002", lost, accepted=False, reason="no associations"),
        ),
        seconds={"maps": 0.12345, "features": 0.0, "pairs": 0.5, "total": 0.62},
    )


@pytest.fixture
def report(dataset: Dataset, result: DetectionResult) -> ClosureReport:
    return report_closures(dataset, result, PipelineParams())


@pytest.fixture
def path(report: ClosureReport, tmp_path: Path) -> Path:
    write_closures(tmp_path / "closures.json", report)
    return tmp_path / "closures.json"


ThereAndBack: TypeAlias = Callable[..., ClosureReport]


@pytest.fixture
def there_and_back(dataset: Dataset, result: DetectionResult, tmp_path: Path) -> ThereAndBack:
    """Write closures and read them, and check that nothing changes on the way."""

    def write_and_read(closures: Iterable[LoopClosure], **options: Any) -> ClosureReport:
        hyperparameters = options.pop("hyperparameters", {})
        found = replace(result, closures=tuple(closures), hyperparameters=hyperparameters)
        report = report_closures(dataset, found, PipelineParams(), **options)
        write_closures(tmp_path / "closures.json", report)
        back = read_closures(tmp_path / "closures.json")
        assert content_of(back) == content_of(report)
        return back

    return write_and_read


def test_the_file_has_what_the_contract_promises(path: Path) -> None:
    content = json.loads(path.read_text())
    assert content.pop("params")["map"]["length_scale"] == PipelineParams().map.length_scale
    assert content.pop("versions") == {
        "gpgrad": __version__,
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }
    assert content["pairs"].pop(1) == {
        "query": "004",
        "database": "000",
        "num_inliers": 9,
        "score": 44.0,
        "dissimilarity": 0.123456789,
        "overlap_area": 20.0,
        "accepted": True,
        "reason": "9 inliers >= 8",
        "T_database_query": {"x": 5.1, "y": 4.9, "yaw": 3.13159265},
        **dict.fromkeys(("z_offset", "covariance", "z_std", "scale", "agreement")),  # not aligned
    }
    lost, _ = content.pop("pairs")
    assert content == {
        "dataset": "crater",
        "method": "gradient",
        "seed": 0,
        "seconds": {"maps": 0.123, "features": 0.0, "pairs": 0.5, "total": 0.62},
        "submaps": [{"id": f"00{i}", "num_points": 10} for i in (0, 2, 4)],
        "num_pairs_skipped": 0,
    }
    # Nothing was compared: null, for JSON has no infinity.
    assert lost["dissimilarity"] is None
    assert lost["T_database_query"] is None


def test_what_is_written_is_read(
    there_and_back: ThereAndBack, result: DetectionResult, path: Path
) -> None:
    before = path.read_bytes()
    back = there_and_back(result.closures)
    assert path.read_bytes() == before  # the same result is the same file
    assert back.accepted == (back.pairs[1],)
    assert back.pairs[0].registration.dissimilarity == math.inf
    assert back.pairs[1].registration.T_database_query == SE2(5.1, 4.9, 3.13159265)


def test_pairs_are_written_as_they_come_and_nothing_is_left_of_half_a_file(
    report: ClosureReport, tmp_path: Path
) -> None:
    write_closures(tmp_path / "whole.json", report)
    with ClosureWriter(tmp_path / "streamed.json") as writer:
        for closure in report.pairs:
            writer.add(closure)
        writer.write(replace(report, pairs=()))
    assert writer.num_pairs == len(report.pairs)
    files = [tmp_path / "streamed.json", tmp_path / "whole.json"]
    assert files[0].read_bytes() == files[1].read_bytes()
    with ClosureWriter(tmp_path / "half.json") as writer:
        writer.add(report.pairs[0])  # and then something fails
    assert sorted(tmp_path.iterdir()) == files
    write_closures(tmp_path / "none.json", replace(report, pairs=()))
    assert read_closures(tmp_path / "none.json").pairs == ()


SKEWED = np.array([[2.0, 0.10727, -0.26], [0.107271, 0.14, -0.0072], [-0.26, -0.0072, 0.04]])


@pytest.mark.parametrize(("covariance", "kept"), [(SKEWED, True), (np.zeros((3, 3)), False)])
def test_what_was_aligned_keeps_its_height_and_covariance(
    covariance: np.ndarray, kept: bool, there_and_back: ThereAndBack, result: DetectionResult
) -> None:
    lost, found = result.closures[:2]
    registration = replace(found.registration, z_offset=-0.25, covariance=covariance)
    report = there_and_back((lost, replace(found, registration=registration)))
    lost, back = restore_closures(report)
    assert (lost.registration.T_database_query, lost.accepted) == (None, False)
    assert (back.pair, back.accepted) == (found.pair, True)
    assert back.registration.num_inliers == found.registration.num_inliers
    matrix = back.registration.covariance
    assert (matrix is not None) == kept  # a degenerate one is left out
    assert back.registration.z_offset == (-0.25 if kept else 0.0)
    if matrix is not None:
        np.testing.assert_array_equal(matrix, matrix.T)
        np.testing.assert_allclose(matrix, covariance, rtol=1e-4)


def test_a_score_that_is_no_number_is_never_written(report: ClosureReport, tmp_path: Path) -> None:
    first = report.pairs[0]
    first = replace(first, registration=replace(first.registration, score=math.nan))
    with pytest.raises(ValueError, match="JSON compliant"):
        write_closures(tmp_path / "a.json", replace(report, pairs=(first,)))
    assert not list(tmp_path.iterdir())


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    assert_file_refused(read_closures, tmp_path / "a.json", "{", "not a JSON file")
    rule = "not a file of loop closures: must be an object, got a list"
    assert_file_refused(read_closures, tmp_path / "a.json", "[]", rule)


IMAGES = {"verdict": "silent", "reason": "dark", "num_associations": 0, "num_inliers": 0}


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"database": "002"}, "pairs[0]: 'database' must be another submap"),
        ({"database": "007"}, "names submap '007', which 'submaps' has not"),
        ({"covariance": [1, 2, 3]}, "'covariance' must be three rows of three"),
        ({"covariance": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "must be positive definite"),
        ({"covariance": [[1, 5, 0], [0, 1, 0], [0, 0, 1]]}, "must be symmetric"),
        ({"T_database_query": {"x": 1, "y": 1}}, "pairs[0], T_database_query: 'yaw' is missing"),
        ({"z_std": -1}, "'z_std' must be a finite number, 0 or more, got -1"),
        ({"images": IMAGES | {"verdict": "maybe"}}, "'verdict' must be one of confirmed, contrad"),
        ({"decision": "yes"}, "'decision' must be an object, got 'yes'"),
        ({"decision": {"accepted": "yes"}}, "'accepted' must be true or false, got 'yes'"),
        ({"decision": {"accepted": 1}}, "decision: 'accepted' must be true or false, got 1"),
        ({"decision": {"note": 3}}, "decision: 'note' must be a text, got 3"),
        ({"decision": {"note": "two\nlines"}}, "'note' must be one line of at most 200 letters"),
        ({"decision": {"note": 201 * "x"}}, "'note' must be one line of at most 200 letters"),
        ({"decision": {"accepted": True}}, "accepts the pair, but it has no motion"),
        ({"query": "004"}, "the pair of '004' and '000' a second time"),
        ({"submaps": [{"id": "000"}]}, "submaps[0]: 'num_points' is missing"),
        ({"submaps": 2 * [{"id": "000", "num_points": 9}]}, "names a submap twice"),
        ({"submaps": [{"id": "000", "num_points": 9, "noise_std": "much"}]}, "'noise_std' must be"),
        ({"seconds": {"total": "long"}}, "'seconds[…]' must be a finite number"),
        ({"num_pairs_skipped": -1}, "'num_pairs_skipped' must be a whole number, 0 or more"),
        ({"pairs": [3]}, "'pairs[0]' must be an object, got 3"),
    ],
)
def test_what_is_no_report_is_refused(changed: dict[str, Any], said: str, path: Path) -> None:
    content = json.loads(path.read_text())
    of_report = set(changed) <= set(content)
    (content if of_report else content["pairs"][0]).update(changed)
    rule = "not a file of loop closures" + ("" if of_report else ", pairs")
    assert_file_refused(read_closures, path, json.dumps(content), rule, said)


def test_a_decision_is_kept_and_outweighs_the_verdict(
    there_and_back: ThereAndBack, result: DetectionResult
) -> None:
    lost, found, other = result.closures
    weak = replace(found, accepted=False, reason="score 2 < 3")
    refused, noted = Decision(accepted=False, note="only a dune, twice"), Decision(note="again")
    back = there_and_back(result.closures, decisions={found.pair: refused, lost.pair: noted})
    assert [back.decisions[pair.pair] for pair in back.pairs[:2]] == [noted, refused]
    assert back.accepted == back.confirmed == ()
    first, second, _ = restore_closures(back)
    assert (second.accepted, second.reason) == (False, "refused by hand")
    assert first.reason == lost.reason  # a note alone leaves the verdict as it is
    back = there_and_back([lost, weak, other], decisions={found.pair: Decision(accepted=True)})
    assert back.confirmed == (found.pair,)
    closure = restore_closures(back)[1]
    assert (closure.accepted, closure.reason) == (True, "accepted by hand")


def test_what_images_say_is_kept_and_counted(
    there_and_back: ThereAndBack, result: DetectionResult, tmp_path: Path
) -> None:
    verdict = ImageVerdict("contradicted", "another place", 12, 3)
    first, second, third = result.closures
    report = there_and_back((first, replace(second, images=verdict), third))
    content = json.loads((tmp_path / "closures.json").read_text())
    assert content["pairs"][1]["images"] == asdict(verdict)
    assert "images" not in content["pairs"][0]
    assert restore_closures(report)[1].images == verdict
    counted = "images: 0 confirmed, 1 contradicted, 0 silent"
    assert count_images(pair.images for pair in report.pairs) == counted
    assert count_images([None, None]) == ""


def test_a_table_has_no_digits_that_nobody_knows_and_no_negative_zero(
    there_and_back: ThereAndBack, result: DetectionResult, tmp_path: Path
) -> None:
    lost, found, _ = result.closures
    registration = replace(
        found.registration, dissimilarity=994881405123.0, T_database_query=SE2(-0.0, 4.9, 0.0)
    )
    report = there_and_back((lost, replace(found, registration=registration)))
    write_closure_table(tmp_path / "closures.csv", report)
    _, _, row = (tmp_path / "closures.csv").read_text().splitlines()
    assert row == "004,000,true,44,9,20,9.94881405e+11,0,4.9,0,9 inliers >= 8"
    assert "-0.0" not in (tmp_path / "closures.json").read_text()


def test_each_submaps_own_numbers_are_kept(
    there_and_back: ThereAndBack, result: DetectionResult, tmp_path: Path
) -> None:
    own = {"002": Hyperparameters(0.5, 0.25, 0.0125)}
    compared = [
        replace(pair, registration=replace(pair.registration, mean_dissimilarity=h))
        for pair, h in zip(result.closures, (math.inf, 2.5, 5.0), strict=True)
    ]
    report = there_and_back(compared, method="paper", hyperparameters=own)
    content = json.loads((tmp_path / "closures.json").read_text())
    assert content["submaps"][0] == {"id": "000", "num_points": 10}
    assert content["submaps"][1] == {"id": "002", "num_points": 10, **asdict(own["002"])}
    assert ["mean_dissimilarity" in pair for pair in content["pairs"]] == [False, True, True]
    assert [pair.registration.mean_dissimilarity for pair in report.pairs] == [math.inf, 2.5, 5.0]
