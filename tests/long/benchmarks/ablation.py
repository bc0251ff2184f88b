"""What each part of the method buys, as a table: ``python -m tests.long.benchmarks.ablation``.

Rows leave one part out each, or are rivals without a GP. The blur of the smoothed grid is chosen
for each set by the truth, so that it is an upper bound of what any blur could do. Columns are the
real datasets (``GPGRAD_DATA``), whole, thinned and noisy, and steep hills simulated from the air.
One draw of the noise can favour one or the other; ``--draws 5`` gives the mean precision and recall
of five, and what was accepted in all of them.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

from gpgrad_core.detection import PipelineParams, detect_loop_closures
from gpgrad_core.evaluation import EvaluationParams, TruePairs, evaluate, measure_pairs
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.methods import METHODS
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.store import Store
from gpgrad_core.run.threads import num_workers
from gpgrad_core.simulation.simulate import simulate_dataset
from gpgrad_core.types import Dataset
from tests.long.quality.degraded import SETS, load_degraded
from tests.long.quality.test_hard_ground import KINDS, SCANS

BLURS = (0.15, 0.3, 0.6, 1.0, 1.6)
"""Length-scales that the smoothed grid is tried with [m]; its blur is 0.4 of each."""
FINER = 0.84
"""Share of the scale of comparison that one row is compared at: half a step of `rounded_scale`."""

Change = Callable[[PipelineParams], PipelineParams]


def _unfitted(params: PipelineParams) -> PipelineParams:
    return replace(params, map=replace(params.map, length_scale=0.3, noise_std=0.05))


def _compared_at_the_length_scale(params: PipelineParams) -> PipelineParams:
    return replace(params, map=replace(params.map, scale=params.map.length_scale))


def _compared_finer(params: PipelineParams) -> PipelineParams:
    assert params.map.scale is not None  # it was fitted
    return replace(params, map=replace(params.map, scale=FINER * params.map.scale))


def _unmasked(params: PipelineParams) -> PipelineParams:
    return replace(params, features=replace(params.features, max_std_ratio=1.0))


@dataclass(frozen=True)
class Figures:
    """How one row does on one set."""

    average_precision: float
    recall_at_full_precision: float
    right: int
    wrong: int

    def __str__(self) -> str:
        """As a cell of the table."""
        return (
            f"{self.average_precision:.3f} / {self.recall_at_full_precision:.2f}, "
            f"{self.right} + {self.wrong}"
        )


def over_draws(each: Sequence[Figures]) -> Figures:
    """Take the mean of the ranking, and the sum of what was accepted."""
    return Figures(
        fmean(one.average_precision for one in each),
        fmean(one.recall_at_full_precision for one in each),
        sum(one.right for one in each),
        sum(one.wrong for one in each),
    )


def run(
    dataset: Dataset,
    pairs: TruePairs,
    method_name: str = "gradient",
    given: PipelineParams | None = None,
    change: Change | None = None,
    *,
    by_inliers: bool = False,
) -> Figures:
    """Detect with one row's method and judge it by the surface rule.

    Args:
        dataset: The set.
        pairs: Its true pairs.
        method_name: As of ``--method``.
        given: What is given before the fit.
        change: What is changed after it.
        by_inliers: Whether pairs are ranked by their inliers alone.
    """
    method = METHODS[method_name]
    params = method.resolve(dataset.submaps, given or PipelineParams(), Memo(store=Store()))
    params = change(params) if change else params
    count = len(dataset.submaps)
    with workers(num_workers(), count * (count - 1) // 2) as executor:
        result = detect_loop_closures(
            dataset, params, detector=method.detector(params, Memo()), executor=executor
        )
    judged = evaluate(dataset, {"row": result}, EvaluationParams(num_resamples=0), pairs=pairs)
    verdict, surface = judged.methods[0], 1
    ranked, accepted = verdict.rules[surface].ranked, verdict.accepted
    if ranked is None:
        raise SystemExit(f"{dataset.name}: no pair of it is true by the rule on surfaces")
    wrong = accepted.wrong_motion + accepted.no_overlap
    if by_inliers:
        return Figures(
            ranked.average_precision_by_inliers,
            ranked.recall_at_full_precision_by_inliers,
            accepted.right,
            wrong,
        )
    return Figures(
        ranked.average_precision.value,
        ranked.recall_at_full_precision.value,
        accepted.right,
        wrong,
    )


def best_blur(dataset: Dataset, pairs: TruePairs) -> Figures:
    """Give the smoothed grid the blur that suits the set best, by the truth."""
    found = [
        run(
            dataset,
            pairs,
            "smoothed",
            replace(PipelineParams(), map=replace(PipelineParams().map, length_scale=length)),
        )
        for length in BLURS
    ]
    return max(found, key=lambda one: (one.average_precision, one.recall_at_full_precision))


ROWS: dict[str, Callable[[Dataset, TruePairs], Figures]] = {
    "smoothed grid, best blur of each set": best_blur,
    "keypoints of the elevation image": lambda d, p: run(d, p, "elevation"),
    "**gradient, all parts**": run,
    "without fitted parameters (0.3 m, 5 cm)": lambda d, p: run(
        d, p, given=_unfitted(PipelineParams())
    ),
    "compared at the kernel's length-scale": lambda d, p: run(
        d, p, change=_compared_at_the_length_scale
    ),
    f"compared at {FINER} of the scale": lambda d, p: run(d, p, change=_compared_finer),
    "without the evidence (ranked by inliers)": lambda d, p: run(d, p, by_inliers=True),
    "without the variance mask": lambda d, p: run(d, p, change=_unmasked),
}


def main() -> None:
    """Print each cell as soon as it is known, and the table at the end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", nargs="*", default=list(SETS), choices=SETS)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--scans", nargs="*", default=list(SCANS), choices=list(SCANS))
    parser.add_argument("--draws", type=int, default=1, help="of points and noise")
    parser.add_argument("--rows", nargs="*", default=list(ROWS), choices=list(ROWS))
    asked = parser.parse_args()
    columns: dict[str, dict[str, str]] = {}
    for name, draws, pairs in _columns(asked):
        columns[name] = {}
        for row in asked.rows:
            each = [ROWS[row](dataset, pairs) for dataset in draws]
            columns[name][row] = str(over_draws(each))
            print(f"{name}: {row}: {columns[name][row]}", file=sys.stderr, flush=True)  # noqa: T201
    print("AP / R100 by the surface rule, accepted right + wrong motions.\n")  # noqa: T201
    print("| | " + " | ".join(columns) + " |")  # noqa: T201
    print("|---|" + "---|" * len(columns))  # noqa: T201
    for row in asked.rows:
        cells = " | ".join(cells[row] for cells in columns.values())
        print(f"| {row} | {cells} |")  # noqa: T201


def _columns(asked: argparse.Namespace) -> Iterator[tuple[str, list[Dataset], TruePairs]]:
    """Load or simulate the sets, one at a time, each as often as it is drawn."""
    folder = Path(os.environ.get("GPGRAD_DATA", "../shared/data"))
    for name in asked.sets:
        pairs = measure_pairs(load_dataset(folder / name))
        for kind in asked.kinds:
            draws = range(1 if kind == "whole" else asked.draws)
            sets = [load_degraded(folder / name, *KINDS[kind], draw) for draw in draws]
            yield f"{name}, {kind}", sets, pairs
    for kind in asked.scans:
        simulated = simulate_dataset(SCANS[kind])
        yield f"hills, {kind}", [simulated], measure_pairs(simulated)


if __name__ == "__main__":
    main()
