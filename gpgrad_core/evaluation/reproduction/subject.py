"""What the figures of one dataset show: its verdicts, and one loop closure in all detail."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.experiment import detect_kept
from gpgrad_core.evaluation.judge import Evaluation, evaluate
from gpgrad_core.evaluation.overlap import measure_pairs
from gpgrad_core.evaluation.rules import EvaluationParams
from gpgrad_core.matching import match_features
from gpgrad_core.methods import Method
from gpgrad_core.pipeline import DetectionResult, PipelineParams
from gpgrad_core.pipeline.all_pairs import SearchableDetector
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.store import Store
from gpgrad_core.se2 import Pose
from gpgrad_core.types import Dataset, GradientMap, LoopClosure, Matches, Submap

TITLES = {
    1: "Two submaps of one place, and their gradient maps",
    3: "From a point cloud to its gradient map",
    4: "The check of a loop closure",
    6: "Where the rover drove",
    8: "Precision and recall",
    9: "Precision against the least number of inliers",
    10: "A loop closure among all submaps",
}
"""Titles of the figures by their numbers in the paper."""
VERDICTS = frozenset({1, 3, 4, 8, 9, 10})
"""Figures that need verdicts on the pairs; the third shows a submap of the best of them."""
DETAILS = frozenset({1, 3, 4, 10})
"""Figures of one loop closure."""


@dataclass(frozen=True, eq=False)
class Shown:
    """The pair that the figures show, or one submap if there is no pair.

    Attributes:
        query: The query submap.
        query_map: Its gradient map.
        mask: The threshold of the variance mask, as in `GradientMap.trusted`.
        database: The database submap; None if there is no pair.
        database_map: Its gradient map.
        matches: The associations of their keypoints.
        closure: The verdict on the pair.
        right: Whether the true poses say that the pair is true and its motion right; None if they
            are not known.
    """

    query: Submap
    query_map: GradientMap
    mask: float
    database: Submap | None = None
    database_map: GradientMap | None = None
    matches: Matches | None = None
    closure: LoopClosure | None = None
    right: bool | None = None


@dataclass(frozen=True, eq=False)
class Subject:
    """A dataset and all that its figures show.

    Attributes:
        dataset: The dataset.
        method: The first method, whose maps are shown.
        shown: The pair that is shown; None if no figure needs it.
        evaluation: The methods, judged by the true poses; None if these are not known, or if no
            figure needs it.
        notes: What was left out and why, one line each.
    """

    dataset: Dataset
    method: Method
    shown: Shown | None = None
    evaluation: Evaluation | None = None
    notes: tuple[str, ...] = ()


def has_truth(dataset: Dataset) -> bool:
    """Tell whether at least two submaps have a true pose."""
    return sum(submap.pose_true is not None for submap in dataset.submaps) >= 2


def poses_of(dataset: Dataset) -> tuple[dict[str, Pose], str]:
    """Give the poses by which the submaps are drawn in one frame, and say which these are.

    Returns:
        The true poses by id if there are two or more, or else those of odometry, or none; and
        their name.
    """
    true = {one.id: one.pose_true for one in dataset.submaps if one.pose_true is not None}
    if len(true) >= 2:
        return true, "true poses"
    odometry = {
        one.id: one.pose_odometry for one in dataset.submaps if one.pose_odometry is not None
    }
    return (odometry, "odometry") if len(odometry) >= 2 else ({}, "")


def check_method(method: Method) -> None:
    """Check that a method has the maps and keypoints that the figures show.

    Raises:
        InputError: If it has none.
    """
    if not _has_maps(method):
        raise InputError(
            f"--method {method.name}: has no gradient maps, and the first method must have them; "
            "name paper, gradient, elevation or smoothed first"
        )


def _has_maps(method: Method) -> bool:
    detector = method.detector(method.ready(PipelineParams()), Memo())
    return isinstance(detector, SearchableDetector)


def study(
    dataset: Dataset,
    methods: Sequence[Method],
    params: PipelineParams,
    judging: EvaluationParams,
    numbers: frozenset[int],
    *,
    store: Store | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Subject:
    """Find out what the figures of one dataset need.

    Args:
        dataset: The dataset.
        methods: The methods; all figures but the eighth are of the first one.
        params: Parameters, which each method adapts to its needs.
        judging: When a pair is true.
        numbers: The figures' numbers in the paper.
        store: Keeps the verdict on each pair, so that a stopped run goes on where it was.
        executor: Threads or processes that share the work.
        progress: Called from this thread with the fraction done; may raise Cancelled.

    Raises:
        InputError: If a submap cannot be used by the first method. Another method is left out
            then, with a note.
    """
    leading, *others = methods
    if not numbers & VERDICTS:
        progress(1.0)
        return Subject(dataset, leading)
    judged = has_truth(dataset)
    wanted = [leading, *(others if judged and 8 in numbers else ())]
    fits, notes = Memo(store=store), list[str]()
    results: dict[str, DetectionResult] = {}
    settled = params
    for k, method in enumerate(wanted):
        hook = part(progress, 0.95 * k / len(wanted), 0.95 * (k + 1) / len(wanted))
        try:
            adapted = method.settle(dataset.submaps, params, fits)
            results[method.name] = detect_kept(
                dataset, method, adapted, store, executor=executor, progress=hook
            )
        except InputError as error:
            if method is leading:
                raise
            notes.append(f"{dataset.name}: {method.name} is left out: {error}")
            continue
        if method is leading:
            settled = adapted
    evaluation = None
    if judged:
        evaluation = evaluate(
            dataset,
            results,
            judging,
            pairs=measure_pairs(dataset),
            seed=params.registration.seed,
        )
        notes += [f"{dataset.name}: {note}" for note in evaluation.pairs.notes]
    shown = None
    if numbers & DETAILS:
        closure = choose(dataset, results[leading.name].closures, evaluation)
        shown = _show(dataset, leading, settled, closure, evaluation, store)
    progress(1.0)
    return Subject(dataset, leading, shown, evaluation, tuple(notes))


def choose(
    dataset: Dataset, closures: Sequence[LoopClosure], evaluation: Evaluation | None
) -> LoopClosure | None:
    """Choose the pair to show: right if that is known, accepted, no neighbours, most inliers.

    Args:
        dataset: The dataset.
        closures: The verdicts of the first method.
        evaluation: The verdicts, judged; the first method is the one that is meant.

    Returns:
        The pair; None if no pair has a motion.
    """
    place = {submap.id: k for k, submap in enumerate(dataset.submaps)}

    def worth(closure: LoopClosure) -> tuple[object, ...]:
        found = closure.registration
        return (
            is_right(closure, evaluation) or False,
            closure.accepted,
            place[closure.query_id] - place[closure.database_id] > 1,
            found.num_inliers,
            found.score,
        )

    moved = [one for one in closures if one.registration.T_database_query is not None]
    return max(moved, key=worth, default=None)  # of equals, the first


def is_right(closure: LoopClosure, evaluation: Evaluation | None) -> bool | None:
    """Tell whether a pair is true by the first rule and its motion right; None if not known."""
    if evaluation is None:
        return None
    row = evaluation.pairs.rows.get(frozenset((closure.query_id, closure.database_id)))
    if row is None:
        return None
    overlap = evaluation.rules[0].measured(evaluation.pairs)[row]
    near = evaluation.methods[0].errors.near[row]
    return bool(overlap > evaluation.rules[0].threshold and near)


def _show(
    dataset: Dataset,
    method: Method,
    params: PipelineParams,
    closure: LoopClosure | None,
    evaluation: Evaluation | None,
    store: Store | None,
) -> Shown:
    detector = method.detector(params, Memo(store=store))
    assert isinstance(detector, SearchableDetector)
    mask = params.features.max_std_ratio
    if closure is None:
        submap = dataset.submaps[0]
        return Shown(submap, _map_of(detector.infer(submap)), mask)
    query, database = dataset.submap(closure.query_id), dataset.submap(closure.database_id)
    inferred = [detector.infer(submap) for submap in (query, database)]
    keypoints = [detector.keypoints(detector.extract(one)) for one in inferred]
    query_map, database_map = map(_map_of, inferred)
    matches = match_features(keypoints[0], keypoints[1], params.matching)
    assert len(matches) == len(closure.registration.inliers)
    right = is_right(closure, evaluation)
    return Shown(query, query_map, mask, database, database_map, matches, closure, right)


def _map_of(inferred: Any) -> GradientMap:
    """Give the gradient map of what a detector infers: the map alone, or more with it."""
    return inferred if isinstance(inferred, GradientMap) else inferred.gradient_map


def trusted_range(
    gradient_map: GradientMap, values: np.ndarray, mask: float, low: float, high: float
) -> tuple[float, float]:
    """Give percentiles of a field over the trusted cells, or over all if there are none."""
    trusted = gradient_map.trusted(mask)
    some = values[trusted] if trusted.any() else values.ravel()
    first, last = np.percentile(some, [low, high])
    return float(first), float(max(last, np.nextafter(first, np.inf)))
