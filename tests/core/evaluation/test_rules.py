"""Which pairs are true, false, grey or neighbours."""

import numpy as np
import pytest

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation import EvaluationParams, Rule, measure_pairs
from gpgrad_core.types import Dataset


def named(mask: np.ndarray, dataset: Dataset) -> set[str]:
    pairs = measure_pairs(dataset)
    return {f"{pairs.database[k]}{pairs.query[k]}" for k in np.flatnonzero(mask)}


def test_the_papers_rule(dataset: Dataset) -> None:
    labels = Rule("box", 0.3).label(measure_pairs(dataset))
    assert named(labels.positive, dataset) == {"03"}
    assert named(labels.grey, dataset) == {"04"}  # a quarter common is an IoU of 0.13
    assert named(labels.negative, dataset) == {"02", "13", "14", "24"}


def test_the_rule_of_surfaces(dataset: Dataset) -> None:
    labels = Rule("surface", 0.2).label(measure_pairs(dataset))
    assert named(labels.positive, dataset) == {"03", "04"}
    assert not labels.grey.any()
    assert named(labels.negative, dataset) == {"02", "13", "14", "24"}


def test_grey_pairs_can_count_as_false(dataset: Dataset) -> None:
    labels = Rule("box", 0.3, count_grey=True).label(measure_pairs(dataset))
    assert named(labels.negative, dataset) == {"02", "04", "13", "14", "24"}
    assert not labels.grey.any()


@pytest.mark.parametrize(("neighbours", "judged"), [(0, 10), (1, 6), (2, 3), (9, 0)])
def test_neighbours_are_left_out(dataset: Dataset, neighbours: int, judged: int) -> None:
    labels = Rule("box", 0.0, neighbours).label(measure_pairs(dataset))
    assert labels.judged.sum() == judged
    assert not (labels.positive & ~labels.judged).any()


def test_a_threshold_is_exceeded_not_met(dataset: Dataset) -> None:
    pairs = measure_pairs(dataset)
    exactly = float(pairs.box_iou.max())
    assert not Rule("box", exactly, 0).label(pairs).positive.any()
    assert Rule("box", exactly - 1e-12, 0).label(pairs).positive.sum() == 1


def test_a_rule_says_what_it_does() -> None:
    box, surface = EvaluationParams(min_overlap=0.1, neighbours=3).rules
    assert box.name == "box IoU > 0.1"
    assert "above 0.1" in box.statement
    assert "|i - j| <= 3 are left out" in box.statement
    assert "10 cm cells" in surface.statement
    assert "neighbours are counted" in EvaluationParams(neighbours=0).rules[0].statement
    assert "every other pair is false" in EvaluationParams(count_grey=True).rules[0].statement


def test_bounds_are_checked() -> None:
    with pytest.raises(InputError, match=r"min_overlap must be from 0 to 0\.99, got 1\.5"):
        EvaluationParams(min_overlap=1.5)
