# ruff: noqa: T201 - a command that prints tables
"""The paper's open points, read one way and the other: ``poe bench-paper DATASET …``.

Each row changes one reading of `methods/paper.py` and leaves the others. AP / R100 are those of the
ranking by n, by the rule on boxes (IoU above 0.3) and by the rule on surfaces. *Right motions* are
counted among all pairs whose boxes' IoU is above 0.3, neighbours too. *From 5* are the pairs with
five inliers or more that do not touch, and those that touch but have a wrong motion: the paper has
none of either. The last rows vary the threshold on the distance of SHOT's descriptors; they need
the library Open3D, and without it they are left out.

Before the table stands what the fits of the submaps cost on one core. Without a dataset, it takes
the demo.
"""

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import tyro

from gpgrad_core.detection import PipelineParams, detect_loop_closures, resolve_parameters
from gpgrad_core.evaluation import EvaluationParams, TruePairs, evaluate, measure_pairs
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.mapping.gradient_map import subsample
from gpgrad_core.methods import METHODS
from gpgrad_core.methods.paper import PaperDetector, paper_params, paper_start, tune
from gpgrad_core.methods.rivals import CloudDetector, register_by_ransac
from gpgrad_core.methods.shot import describe_shot
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.threads import at_most_workers, single_threaded_libraries
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, LoopDetector
from tests.long.benchmarks.peers.tables import markdown

SURE = 5
PAPER_POINTS = 5000
"""Of a submap of the paper."""
LARGEST_MEAN = 1e6
"""Threshold on h for a cell [1/m⁴]: between what right and wrong motions have on the demo."""
SHOT_DISTANCES = (0.4, 0.3, 0.2)
"""Of two descriptors of length 1; the farthest are 1.4 apart."""

Change = Callable[[PipelineParams], PipelineParams]


@dataclass(frozen=True)
class Options:
    """The paper's open points, read one way and the other."""

    datasets: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Dataset folders with true poses. None: the demo."""


def _of_map(**changes: float) -> Change:
    return lambda params: replace(params, map=replace(params.map, **changes))


def _of_matching(**changes: object) -> Change:
    return lambda params: replace(params, matching=replace(params.matching, **changes))


def _of_closure(**changes: object) -> Change:
    return lambda params: replace(params, closure=replace(params.closure, **changes))


UNTUNED = _of_map(length_scale=paper_start(PipelineParams().map).length_scale, noise_std=0.05)
READINGS: dict[str, Change] = {
    "**as taken**": lambda params: params,
    "not tuned: √0.1 m and 5 cm for every submap": UNTUNED,
    "not tuned, l_k of Eq. (6) as a length-scale: 0.1 m": _of_map(length_scale=0.1, noise_std=0.05),
    "matching: each keypoint of the query has its nearest": _of_matching(mutual=False),
    "matching: with Lowe's ratio of 0.8": _of_matching(ratio=0.8),
    "not tuned and with the ratio (as gpgrad had it before)": lambda params: _of_matching(
        ratio=0.8
    )(UNTUNED(params)),
    "accepted by n and by h: at most 1e6 a cell": _of_closure(
        max_mean_dissimilarity=LARGEST_MEAN, min_inliers=2
    ),
}


def detectors(dataset: Dataset, memo: Memo) -> Iterator[tuple[str, PipelineParams, LoopDetector]]:
    """Give the detector of each row, with its parameters."""
    for name, change in READINGS.items():
        params = change(paper_params(PipelineParams()))
        yield name, params, PaperDetector(params, memo)
    if METHODS["shot"].installed:
        params = METHODS["shot"].adapt(resolve_parameters(dataset.submaps, memo=memo))
        for most in (np.inf, *SHOT_DISTANCES):
            compare = partial(register_by_ransac, max_distance=most)
            limit = "any distance" if most == np.inf else f"distance at most {most:g}"
            yield f"SHOT, {limit}", params, CloudDetector(describe_shot, compare, params, memo)


def row(
    name: str, dataset: Dataset, pairs: TruePairs, params: PipelineParams, detector: LoopDetector
) -> list[str]:
    """Detect with one reading, and judge it."""
    result = detect_loop_closures(dataset, params, detector=detector, candidates="all")
    judged = evaluate(dataset, {name: result}, EvaluationParams(num_resamples=0), pairs=pairs)
    (method,) = judged.methods
    ranked = [rule.ranked for rule in method.rules]
    true, near = pairs.box_iou > EvaluationParams().min_overlap, method.errors.near
    # A motion that h refuses has no score, whatever its inliers.
    sure = method.ranking.score >= SURE
    apart = pairs.box_iou == 0
    return [
        name,
        *(
            "-"
            if one is None
            else _figures(one.average_precision.value, one.recall_at_full_precision.value)
            for one in ranked
        ),
        f"{np.sum(true & near)} of {np.sum(true)}",
        f"{np.sum(sure)}: {np.sum(sure & apart)} apart, {np.sum(sure & ~apart & ~near)} wrong",
    ]


def _figures(average_precision: float, recall: float) -> str:
    return f"{average_precision:.3f} / {recall:.2f}"


def fit_cost(dataset: Dataset, memo: Memo) -> str:
    """Fit every submap on one core, thinned as the paper's, and say what that took."""
    params, seconds = paper_params(PipelineParams()).map, list[float]()
    for submap in (subsample(submap, PAPER_POINTS) for submap in dataset.submaps):
        with at_most_workers(1), single_threaded_libraries():
            start = time.perf_counter()
            tune(submap, params, memo)
            seconds.append(time.perf_counter() - start)
    return (
        f"Fits on one core: {len(seconds)} submaps in {sum(seconds):.1f} s, the median "
        f"{np.median(seconds):.2f} s, the longest {max(seconds):.2f} s."
    )


def main(options: Options) -> None:
    """Print a table for each dataset."""
    head = ("reading", "boxes", "surfaces", "right motions", f"from {SURE}")
    for path in options.datasets or (demo_path(),):
        dataset, memo = load_dataset(path), Memo()
        print(f"\n{dataset.name}. {fit_cost(dataset, memo)}\n", flush=True)
        pairs, rows = measure_pairs(dataset), list[list[str]]()
        for name, params, detector in detectors(dataset, memo):
            rows.append(row(name, dataset, pairs, params, detector))
            print(": ".join((dataset.name, *rows[-1])), file=sys.stderr, flush=True)
        print(markdown(head, rows), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
