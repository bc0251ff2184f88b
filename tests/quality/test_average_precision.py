"""How well pairs rank on real terrain, and how long it takes: ``pytest tests/quality -s``.

Outside the default run: it takes a minute or two, and needs the real datasets.
"""

import csv
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gpgrad_core.datasets import load_dataset
from gpgrad_core.pipeline import DetectionResult, detect_loop_closures

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_AVERAGE_PRECISION = {"marsyard2021": 0.95, "sthelens": 0.90, "apollo15": 0.97}
MOST_SECONDS = 60.0


@dataclass(frozen=True)
class Pairs:
    """All pairs of a dataset that are not neighbours on the traverse."""

    score: Array
    accepted: Mask
    box_overlap: Array  # intersection over union of the boxes, Eq. (8)
    surface_overlap: Array  # common share of the smaller submap's surface

    @classmethod
    def of(cls, result: DetectionResult, truth: Path) -> "Pairs":
        with truth.open(newline="") as rows:
            overlaps = {
                frozenset((int(row["i"]), int(row["j"]))): (
                    float(row["iou_aabb"]),
                    float(row["cell_overlap_min"]),
                )
                for row in csv.DictReader(rows)
            }
        kept = [
            (closure.registration.score, closure.accepted, *overlaps[frozenset((i, j))])
            for closure in result.closures
            if abs((i := int(closure.query_id)) - (j := int(closure.database_id))) > 1
        ]
        score, accepted, box_overlap, surface_overlap = np.array(kept, dtype=float).T
        return cls(score, accepted.astype(bool), box_overlap, surface_overlap)

    def rank(self, positive: Mask) -> tuple[float, float]:
        """Average precision and recall at full precision; grey pairs are left out.

        Pairs of the same score stand or fall together.
        """
        judged = positive | (self.box_overlap == 0)
        order = np.argsort(-self.score[judged], kind="stable")
        score, label = self.score[judged][order], positive[judged][order]
        last_of_score = np.r_[score[1:] != score[:-1], True]
        found = np.cumsum(label)[last_of_score]
        named = np.arange(1, len(label) + 1)[last_of_score]
        precision, recall = found / named, found / label.sum()
        average = float(np.sum(np.diff(np.r_[0.0, recall]) * precision))
        return average, float(recall[precision == 1].max(initial=0.0))


@pytest.mark.parametrize("name", LEAST_AVERAGE_PRECISION)
def test_pairs_rank_as_well_as_promised(name: str, real_data: Path) -> None:
    dataset = load_dataset(real_data / name)
    start = time.perf_counter()
    result = detect_loop_closures(dataset)
    seconds = time.perf_counter() - start
    pairs = Pairs.of(result, real_data / name / "pairs_iou.csv")
    rules = {
        "IoU > 0.3": pairs.box_overlap > 0.3,
        "IoU > 0.1": pairs.box_overlap > 0.1,
        "surface > 0.2": pairs.surface_overlap > 0.2,
    }
    print(f"\n{name}: {len(dataset.submaps)} submaps, {seconds:.1f} s")  # noqa: T201
    for rule, positive in rules.items():
        average, recall = pairs.rank(positive)
        print(f"  {rule:14} AP {average:.3f}  R100 {recall:.3f}  ({positive.sum()})")  # noqa: T201
    apart = pairs.box_overlap == 0
    print(  # noqa: T201
        f"  accepted {pairs.accepted.sum()}, of these {(pairs.accepted & apart).sum()} that do "
        f"not meet; highest score of such {pairs.score[apart].max():.2f}"
    )
    assert pairs.rank(rules["IoU > 0.3"])[0] >= LEAST_AVERAGE_PRECISION[name]
    assert not (pairs.accepted & apart).any()
    assert seconds <= MOST_SECONDS


def test_ranking_is_scored_as_by_hand() -> None:
    nan = np.zeros(5, bool)
    overlap = np.array([0.5, 0.0, 0.6, 0.2, 0.0])
    pairs = Pairs(np.array([5.0, 4.0, 3.0, 9.0, 1.0]), nan, overlap, overlap)
    # Grey left out: right, wrong, right, wrong.
    assert pairs.rank(overlap > 0.3) == (pytest.approx(0.5 * 1 + 0.5 * 2 / 3), 0.5)
    tied = Pairs(np.array([5.0, 5.0, 3.0, 9.0, 1.0]), nan, overlap, overlap)
    assert tied.rank(overlap > 0.3) == (pytest.approx(0.5 * 0.5 + 0.5 * 2 / 3), 0.0)
