"""The paper's protocol beside ours, counted by hand."""

import pytest

from gpgrad_core.detection import DetectionResult
from gpgrad_core.evaluation import EvaluationParams, describe_protocol, evaluate
from gpgrad_core.types import Dataset


def test_both_protocols_are_counted_side_by_side(dataset: Dataset, result: DetectionResult) -> None:
    """000-003 overlaps by 0.6, the neighbours 003-004 by 0.33, and 000-004 by 0.14."""
    detections = {"mine": result}
    judged = evaluate(dataset, detections, EvaluationParams(num_resamples=0))
    section = describe_protocol(dataset, detections, judged)
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


def test_nothing_true_has_no_precision(dataset: Dataset) -> None:
    apart = Dataset("apart", dataset.submaps[:3])
    detections = {"mine": DetectionResult((), {})}
    judged = evaluate(apart, detections, EvaluationParams(num_resamples=0))
    text = describe_protocol(apart, detections, judged).text
    assert "| mine | 0 | 3 | 0 | n/a | n/a | none | n/a | n/a | 0 | 0 |" in text
