"""How well pairs rank on real terrain, and how long it takes: ``pytest tests/quality -n 0 -s``.

Outside the default run: it takes a minute or two, and needs the real datasets.
"""

import time
from math import degrees
from pathlib import Path

import numpy as np
import pytest

from gpgrad_core.datasets import load_dataset
from gpgrad_core.evaluation import Evaluation, EvaluationParams, RuleVerdict, evaluate
from gpgrad_core.pipeline import detect_loop_closures
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers

LEAST_AVERAGE_PRECISION = {"marsyard2021": 0.95, "sthelens": 0.90, "apollo15": 0.97}
MOST_SECONDS = 60.0


@pytest.mark.parametrize("name", LEAST_AVERAGE_PRECISION)
def test_pairs_rank_as_well_as_promised(name: str, real_data: Path) -> None:
    dataset = load_dataset(real_data / name)
    num_pairs = len(dataset.submaps) * (len(dataset.submaps) - 1) // 2
    start = time.perf_counter()
    with workers(num_workers(), num_pairs) as executor:
        result = detect_loop_closures(dataset, executor=executor)
    seconds = time.perf_counter() - start
    strict = evaluate(dataset, {"gradient": result}, EvaluationParams(min_overlap=0.3))
    loose = evaluate(dataset, {"gradient": result}, EvaluationParams(min_overlap=0.1))
    lines = [f"\n{name}: {len(dataset.submaps)} submaps, {seconds:.1f} s"]
    lines += [tell(strict, 0), tell(loose, 0), tell(strict, 1)]
    ranking = strict.methods[0].ranking
    apart = strict.pairs.box_iou == 0
    lines.append(
        f"  accepted {ranking.accepted.sum()}, of these {(ranking.accepted & apart).sum()} that do "
        f"not meet; highest score of such {ranking.score[apart].max():.2f}"
    )
    print("\n".join(lines))
    ranked = strict.methods[0].rules[0].ranked
    assert ranked is not None
    assert ranked.average_precision.value >= LEAST_AVERAGE_PRECISION[name]
    assert not np.any(ranking.accepted & apart)
    assert seconds <= MOST_SECONDS


def tell(evaluation: Evaluation, rule: int) -> str:
    verdict: RuleVerdict = evaluation.methods[0].rules[rule]
    ranked, errors = verdict.ranked, verdict.pose_error
    assert ranked is not None
    assert errors.median_offset is not None
    assert errors.high_offset is not None
    assert errors.median_turn is not None
    assert errors.high_turn is not None
    return (
        f"  {evaluation.rules[rule].name:21} AP {ranked.average_precision.value:.3f}  "
        f"R100 {ranked.recall_at_full_precision.value:.3f}  "
        f"(by inliers {ranked.average_precision_by_inliers:.3f}, "
        f"{ranked.recall_at_full_precision_by_inliers:.3f})  "
        f"{evaluation.labels[rule].positive.sum():3} true, {verdict.accepted_true:3} accepted: "
        f"median {100 * errors.median_offset:.1f} cm, {degrees(errors.median_turn):.2f} deg; "
        f"95 % {100 * errors.high_offset:.1f} cm, {degrees(errors.high_turn):.2f} deg"
    )
