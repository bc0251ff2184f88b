"""closures.json holds what the contract promises, and comes back as it went."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.outputs import (
    ClosureWriter,
    Decision,
    count_images,
    read_closures,
    report_closures,
    restore_closures,
    write_closures,
)
from gpgrad_core.outputs.closure_writer import write_closure_table
from gpgrad_core.pipeline import DetectionResult, PipelineParams
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Dataset, ImageVerdict
from gpgrad_core.version import VERSION


def test_the_file_has_what_the_contract_promises(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "closures.json"
    write_closures(path, report_closures(dataset, result, PipelineParams()))
    content = json.loads(path.read_text())
    assert list(content) == [
        "dataset",
        "method",
        "seed",
        "params",
        "versions",
        "seconds",
        "submaps",
        "num_pairs_skipped",
        "pairs",
    ]
    assert content["num_pairs_skipped"] == 0
    assert content["dataset"] == "crater"
    assert content["method"] == "gradient"
    assert content["seed"] == 0
    assert content["params"]["map"]["length_scale"] == PipelineParams().map.length_scale
    assert content["params"]["features"]["detector"]["name"] == "slope"
    assert content["versions"]["gpgrad"] == VERSION
    assert content["versions"].keys() == {"gpgrad", "numpy", "opencv"}
    assert content["seconds"] == {"maps": 0.123, "features": 0.0, "pairs": 0.5, "total": 0.62}
    assert content["submaps"] == [{"id": f"00{i}", "num_points": 10} for i in (0, 2, 4)]
    assert content["pairs"][1] == {
        "query": "004",
        "database": "000",
        "num_inliers": 9,
        "score": 44.0,
        "dissimilarity": 0.123456789,
        "overlap_area": 20.0,
        "accepted": True,
        "reason": "9 inliers >= 8",
        "T_database_query": {"x": 5.1, "y": 4.9, "yaw": 3.13159265},
        "z_offset": None,  # nothing was aligned
        "covariance": None,
        "z_std": None,
        "scale": None,
        "agreement": None,
    }
    # Nothing was compared: null, for JSON has no infinity.
    assert content["pairs"][0]["dissimilarity"] is None
    assert content["pairs"][0]["T_database_query"] is None


def test_pairs_are_written_as_they_come_and_nothing_is_left_of_half_a_file(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    report = report_closures(dataset, result, PipelineParams())
    write_closures(tmp_path / "whole.json", report)
    with ClosureWriter(tmp_path / "streamed.json") as writer:
        for closure in result.closures:
            writer.add(closure)
        writer.write(replace(report, pairs=()))
    assert writer.num_pairs == len(result.closures)
    files = [tmp_path / "streamed.json", tmp_path / "whole.json"]
    assert files[0].read_bytes() == files[1].read_bytes()
    with ClosureWriter(tmp_path / "half.json") as writer:
        writer.add(result.closures[0])  # and then something fails
    assert sorted(tmp_path.iterdir()) == files
    write_closures(tmp_path / "none.json", replace(report, pairs=()))
    assert read_closures(tmp_path / "none.json").pairs == ()


def test_what_is_written_is_read(dataset: Dataset, result: DetectionResult, tmp_path: Path) -> None:
    report = report_closures(dataset, result, PipelineParams(), method="gradient")
    write_closures(tmp_path / "a.json", report)
    back = read_closures(tmp_path / "a.json")
    assert back == report
    assert back.accepted == (back.pairs[1],)
    assert back.pairs[0].dissimilarity == math.inf
    assert back.pairs[1].T_database_query == SE2(5.1, 4.9, 3.13159265)


def test_what_was_aligned_keeps_its_height_and_covariance(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    covariance = np.array([[0.01, 0.002, 0.0], [0.002, 0.02, 0.0], [0.0, 0.0, 1e-4]])
    found = result.closures[1]
    aligned = replace(
        found, registration=replace(found.registration, z_offset=-0.25, covariance=covariance)
    )
    report = report_closures(
        dataset, replace(result, closures=(result.closures[0], aligned)), PipelineParams()
    )
    write_closures(tmp_path / "a.json", report)
    lost, back = restore_closures(read_closures(tmp_path / "a.json"))
    assert lost.registration.T_database_query is None
    assert not lost.accepted
    assert back.accepted
    assert (back.query_id, back.database_id) == (found.query_id, found.database_id)
    assert back.registration.num_inliers == found.registration.num_inliers
    assert back.registration.z_offset == -0.25
    np.testing.assert_allclose(back.registration.covariance, covariance)


def test_a_covariance_of_half_precision_is_made_symmetric_and_a_degenerate_one_left_out(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    skewed = np.array([[2.0, 0.10727, -0.26], [0.107271, 0.14, -0.0072], [-0.26, -0.0072, 0.04]])
    for covariance, kept in ((skewed, True), (np.zeros((3, 3)), False)):
        found = result.closures[1]
        found = replace(found, registration=replace(found.registration, covariance=covariance))
        report = report_closures(dataset, replace(result, closures=(found,)), PipelineParams())
        write_closures(tmp_path / "a.json", report)
        (back,) = restore_closures(read_closures(tmp_path / "a.json"))
        assert (back.registration.covariance is not None) == kept
        if back.registration.covariance is not None:
            matrix = back.registration.covariance
            np.testing.assert_array_equal(matrix, matrix.T)
            np.testing.assert_allclose(matrix, skewed, rtol=1e-4)


@pytest.mark.parametrize("wrong", [[[1, 0], [0, 1]], [[1, 0, 0], [0, 1, 0], [0, 0, -1]], [1, 2, 3]])
def test_a_covariance_that_is_none_is_refused(
    wrong: object, dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "a.json"
    write_closures(path, report_closures(dataset, result, PipelineParams()))
    content = json.loads(path.read_text())
    content["pairs"][1]["covariance"] = wrong
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"a\.json: .*covariance'? must be"):
        read_closures(path)


def test_the_same_result_is_the_same_file(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    for name in ("a.json", "b.json"):
        write_closures(tmp_path / name, report_closures(dataset, result, PipelineParams()))
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_score_that_is_not_a_number_is_never_written(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    report = report_closures(dataset, result, PipelineParams())
    broken = replace(report, pairs=(replace(report.pairs[0], score=math.nan),))
    with pytest.raises(ValueError, match="JSON compliant"):
        write_closures(tmp_path / "a.json", broken)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not a JSON file"),
        ("[]", "not a file of loop closures"),
        ("{}", "'dataset' is missing"),
        ('{"dataset": "a", "method": "a", "seed": 0, "params": {}, "versions": {}, "seconds": {}, '
         '"submaps": [{"id": "000"}], "pairs": []}', "'num_points' is missing"),
    ],
)  # fmt: skip
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_closures(path)
    assert str(refusal.value).startswith(f"{path}: ")
    assert said in str(refusal.value)


def test_a_closure_of_a_submap_with_itself_is_refused(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "closures.json"
    write_closures(path, report_closures(dataset, result, PipelineParams()))
    content = json.loads(path.read_text())
    content["pairs"][0]["database"] = content["pairs"][0]["query"]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"pairs\[0\]: 'database' must be another submap"):
        read_closures(path)


def test_a_decision_is_kept_and_outweighs_the_verdict(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    lost, found = result.closures[:2]
    decisions = {
        (found.query_id, found.database_id): Decision(accepted=False, note="only a dune, twice"),
        (lost.query_id, lost.database_id): Decision(note="look again"),
    }
    report = report_closures(dataset, result, PipelineParams(), decisions=decisions)
    path = tmp_path / "closures.json"
    write_closures(path, report)
    back = read_closures(path)
    assert back == report
    assert [pair.decision for pair in back.pairs[:2]] == [
        Decision(note="look again"),
        Decision(accepted=False, note="only a dune, twice"),
    ]
    assert back.accepted == ()
    assert back.confirmed == ()
    restored = restore_closures(back)
    assert not restored[1].accepted
    assert restored[1].reason == "refused by hand"
    assert restored[0].reason == lost.reason  # a note alone leaves the verdict as it is


def test_a_pair_is_accepted_by_hand_below_the_threshold(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    found = replace(result.closures[1], accepted=False, reason="score 2 < 3")
    pair = found.query_id, found.database_id
    report = report_closures(
        dataset,
        replace(result, closures=(found,)),
        PipelineParams(),
        decisions={pair: Decision(accepted=True)},
    )
    write_closures(tmp_path / "a.json", report)
    back = read_closures(tmp_path / "a.json")
    assert back.confirmed == (pair,)
    (closure,) = restore_closures(back)
    assert closure.accepted
    assert closure.reason == "accepted by hand"


@pytest.mark.parametrize(
    ("decision", "said"),
    [
        ("yes", "'decision' must be an object, got 'yes'"),
        ({"accepted": "yes"}, "'accepted' must be true or false, got 'yes'"),
        ({"accepted": 1}, "'accepted' must be true or false"),
        ({"note": 3}, "'note' must be a text"),
        ({"note": "two\nlines"}, "'note' must be one line of at most 200 letters"),
        ({"note": 201 * "x"}, "'note' must be one line of at most 200 letters"),
    ],
)
def test_a_decision_that_is_none_is_refused_by_name(
    decision: object, said: str, dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "closures.json"
    write_closures(path, report_closures(dataset, result, PipelineParams()))
    content = json.loads(path.read_text())
    content["pairs"][1]["decision"] = decision
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"pairs\[1\](, decision|: 'decision')") as raised:
        read_closures(path)
    assert said in str(raised.value)


def test_nothing_cannot_be_accepted_by_hand(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "closures.json"
    write_closures(path, report_closures(dataset, result, PipelineParams()))
    content = json.loads(path.read_text())
    content["pairs"][0]["decision"] = {"accepted": True}
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="has no motion"):
        read_closures(path)
    content["pairs"][0]["decision"] = {"accepted": False}
    path.write_text(json.dumps(content))
    assert read_closures(path).pairs[0].decision == Decision(accepted=False)


def test_what_images_say_is_kept_counted_and_checked(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path = tmp_path / "closures.json"
    said = ImageVerdict("contradicted", "another place", 12, 3)
    closures = (*result.closures[:1], replace(result.closures[1], images=said), result.closures[2])
    report = report_closures(dataset, replace(result, closures=closures), PipelineParams())
    write_closures(path, report)
    content = json.loads(path.read_text())
    assert content["pairs"][1]["images"] == {
        "verdict": "contradicted",
        "reason": "another place",
        "num_associations": 12,
        "num_inliers": 3,
    }
    assert "images" not in content["pairs"][0]
    again = read_closures(path)
    assert [pair.images for pair in again.pairs] == [None, said, None]
    assert restore_closures(again)[1].images == said
    assert count_images(pair.images for pair in again.pairs) == (
        "images: 0 confirmed, 1 contradicted, 0 silent"
    )
    assert count_images([None, None]) == ""
    content["pairs"][1]["images"]["verdict"] = "maybe"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="'verdict' must be one of confirmed, contradicted, sil"):
        read_closures(path)


def test_a_table_has_no_digits_that_nobody_knows_and_no_negative_zero(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    lost, found, _ = result.closures
    motion = SE2(-0.0, 4.9, 0.0)
    registration = replace(
        found.registration, dissimilarity=994881405123.0, T_database_query=motion
    )
    closures = (lost, replace(found, registration=registration))
    report = report_closures(dataset, replace(result, closures=closures), PipelineParams())
    write_closure_table(tmp_path / "closures.csv", report)
    _, _, row = (tmp_path / "closures.csv").read_text().splitlines()
    assert row == "004,000,true,44,9,20,9.94881405e+11,0,4.9,0,9 inliers >= 8"
    write_closures(tmp_path / "closures.json", report)
    assert "-0.0" not in (tmp_path / "closures.json").read_text()


def test_each_submaps_own_numbers_are_kept_and_checked(
    dataset: Dataset, result: DetectionResult, tmp_path: Path
) -> None:
    path, own = tmp_path / "closures.json", {"002": Hyperparameters(0.5, 0.25, 0.0125)}
    compared = [
        replace(one, registration=replace(one.registration, mean_dissimilarity=2.5 * k or math.inf))
        for k, one in enumerate(result.closures)
    ]
    result = replace(result, closures=tuple(compared), hyperparameters=own)
    report = report_closures(dataset, result, PipelineParams(), method="paper")
    write_closures(path, report)
    content = json.loads(path.read_text())
    assert content["submaps"][0] == {"id": "000", "num_points": 10}
    numbers = {"length_scale": 0.5, "signal_std": 0.25, "noise_std": 0.0125}
    assert content["submaps"][1] == {"id": "002", "num_points": 10, **numbers}
    assert ["mean_dissimilarity" in pair for pair in content["pairs"]] == [False, True, True]
    read = read_closures(path)
    assert read.hyperparameters == own
    assert [pair.mean_dissimilarity for pair in read.pairs] == [None, 2.5, 5.0]
    content["submaps"][1]["noise_std"] = "much"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"noise_std"):
        read_closures(path)
