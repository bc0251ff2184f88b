# ruff: noqa: T201 - a command that prints a table
"""All methods with the same refinement: ``poe bench-refined DATASET …``.

Methods differ in how they find a place, and in how they polish the motion in the end. Here every
motion of a true pair is polished once more, by GICP of the library small_gicp with the same
settings for all, so that what is left is how well a place is found.

A pair is true by the rule on surfaces, without neighbours. AP is the average precision of the
ranking by score, which a refinement does not change. *AP of motions* also wants the right motion
(0.5 m and 5 degrees): a true pair with a wrong motion counts as a false one, and as missed. The
errors are medians over the true pairs whose motion is right.

It needs the extra `bench`, and `peers` for some methods; those that are not installed are left
out. `cshot` and `appearance` need colours and images, and run only if they are named. Without a
dataset, it takes the demo.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import small_gicp
import tyro

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.evaluation import (
    EvaluationParams,
    Labels,
    PoseErrors,
    TruePairs,
    average_precision,
    measure_pairs,
    pose_errors,
    rank_pairs,
    run_methods,
)
from gpgrad_core.evaluation.precision_recall import precision_recall
from gpgrad_core.io.folder import load_dataset
from gpgrad_core.methods import METHODS, Method, find_method
from gpgrad_core.methods.rivals import height_between, planar_motion
from gpgrad_core.params import preferred_parameters
from gpgrad_core.run.parallel import workers
from gpgrad_core.run.threads import num_workers
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.simulation.demo import demo_path
from gpgrad_core.types import Dataset, Submap
from tests.long.benchmarks.peers.tables import markdown

RESOLUTION = 0.1
"""Side of the voxels to which clouds are thinned for GICP [m]."""
REACH = 0.5
"""Largest distance of two associated points [m]: as far as a motion may be off to be right."""
NEIGHBOURS, ITERATIONS = 20, 50
NOT_EVERYWHERE = ("cshot", "appearance")


@dataclass(frozen=True)
class Options:
    """All methods with the same refinement."""

    datasets: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Dataset folders with true poses. None: the demo."""
    method: tuple[str, ...] = ()
    """Methods to compare. None: all that are installed."""


@dataclass(frozen=True, eq=False)
class Refiner:
    """GICP between the submaps of a dataset, each prepared once."""

    submaps: dict[str, Submap]
    prepared: dict[str, Any]

    @classmethod
    def of(cls, submaps: Sequence[Submap]) -> "Refiner":
        """Thin the clouds, and estimate the covariances of their points."""
        prepared = {
            submap.id: small_gicp.preprocess_points(
                np.array(submap.points), RESOLUTION, NEIGHBOURS, num_threads=1
            )
            for submap in submaps
        }
        return cls({submap.id: submap for submap in submaps}, prepared)

    def refine(self, query: str, database: str, motion: SE2) -> SE2:
        """Polish a motion from the query to the database; it stays if GICP does not converge."""
        points, base = self.submaps[query].points, self.submaps[database].points
        start = _matrix(motion)
        start[2, 3] = height_between(points, base, start, RESOLUTION)
        source, _ = self.prepared[query]
        target, tree = self.prepared[database]
        result = small_gicp.align(
            target,
            source,
            tree,
            start,
            registration_type="GICP",
            max_correspondence_distance=REACH,
            max_iterations=ITERATIONS,
            num_threads=1,
        )
        found = np.array(result.T_target_source)
        if not result.converged or not np.isfinite(found).all():
            return motion
        return planar_motion(found, points)


def _matrix(motion: SE2) -> Array:
    pose = Pose.from_planar(motion)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.translation
    return matrix


def main(options: Options) -> int:
    """Measure and print."""
    methods = [find_method(name) for name in options.method or _installed()]
    rows: list[list[str]] = []
    for path in options.datasets or (demo_path(),):
        dataset = load_dataset(path)
        for row in compare(dataset, methods):
            rows.append([dataset.name, *row])
            print(" | ".join(rows[-1]), file=sys.stderr, flush=True)
    both = ("before", "after")
    head = ["set", "method", "AP", *(f"AP of motions {one}" for one in both)]
    head += [*(f"right {one}" for one in both), *(f"offset {one}" for one in both)]
    print(markdown([*head, *(f"turn {one}" for one in both)], rows))
    return 0


def _installed() -> list[str]:
    return [
        name
        for name, method in METHODS.items()
        if method.installed and name not in (*NOT_EVERYWHERE, "chance")
    ]


def compare(dataset: Dataset, methods: Sequence[Method]) -> list[list[str]]:
    """Run the methods on a dataset, refine their motions, and give a row for each."""
    pairs = measure_pairs(dataset)
    labels = EvaluationParams().rules[1].label(pairs)
    params = preferred_parameters(dataset, PipelineParams())
    with workers(num_workers(), len(pairs) * len(methods)) as executor:
        reports = run_methods(dataset, methods, params, candidates="all", executor=executor)
    refiner = Refiner.of(dataset.submaps)
    rows: list[list[str]] = []
    for name, report in reports.items():
        ranking = rank_pairs(report, dataset, pairs, name)
        before = ranking.T_database_query
        after = tuple(
            refiner.refine(pairs.ids[pairs.query[k]], pairs.ids[pairs.database[k]], motion)
            if motion is not None and labels.positive[k]
            else motion
            for k, motion in enumerate(before)
        )
        errors = [pose_errors(motions, pairs.T_database_query) for motions in (before, after)]
        rows.append([name, *_cells(ranking.score, labels, pairs, errors)])
    return rows


def _cells(
    score: Array, labels: Labels, pairs: TruePairs, errors: Sequence[PoseErrors]
) -> list[str]:
    judged, positive = labels.judged, labels.positive
    ranked = average_precision(precision_recall(score[judged], positive[judged]))
    cells = [f"{ranked:.3f}"]
    cells += [
        f"{precision_of_motions(score[judged], positive[judged], one.near[judged]):.3f}"
        for one in errors
    ]
    right = [positive & one.near for one in errors]
    cells += [f"{chosen.sum()} of {positive.sum()}" for chosen in right]
    for values, unit in (
        ([100 * one.offset for one in errors], "cm"),
        ([np.degrees(one.turn) for one in errors], "°"),
    ):
        for value, chosen in zip(values, right, strict=True):
            cells.append(f"{np.median(value[chosen]):.2g} {unit}" if chosen.any() else "-")
    if pairs.positions_only:  # the true headings are not known
        cells[-2:] = ["-", "-"]
    return cells


def precision_of_motions(score: Array, positive: Array, right: Array) -> float:
    """Compute the average precision where only true pairs with the right motion are hits.

    Args:
        score: Scores of the judged pairs (p,).
        positive: Which of them are true (p,).
        right: Which have the right motion (p,).
    """
    hits = positive & right
    if not hits.any():
        return 0.0
    share = float(hits.sum() / positive.sum())  # the curve's recall is that of the hits
    return share * average_precision(precision_recall(score, hits))


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options, description=__doc__)))
