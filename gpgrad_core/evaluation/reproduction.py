"""What the figures of one dataset show: its verdicts, and one loop closure in all detail."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.detection import DetectionResult, PipelineParams
from gpgrad_core.detection.all_pairs import SearchableDetector
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.experiment import detect_kept
from gpgrad_core.evaluation.judge import Evaluation, evaluate
from gpgrad_core.evaluation.overlap import measure_pairs
from gpgrad_core.evaluation.rules import EvaluationParams
from gpgrad_core.matching import match_features
from gpgrad_core.methods import Method
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, part, silent
from gpgrad_core.run.store import Store
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    LoopClosure,
    LoopDetector,
    Matches,
    Submap,
)

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
class ShownSubmap:
    """A submap that a figure shows.

    Attributes:
        submap: The submap.
        map: Its gradient map.
        mask: The threshold of the variance mask, as in `GradientMap.trusted`.
    """

    submap: Submap
    map: GradientMap
    mask: float

    def trusted_range(
        self, values: Float[Array, "rows columns"], low: float, high: float
    ) -> tuple[float, float]:
        """Give percentiles of a field over the trusted cells, or over all if there are none."""
        trusted = self.map.trusted(self.mask)
        some = values[trusted] if trusted.any() else values.ravel()
        first, last = np.percentile(some, [low, high])
        return float(first), float(max(last, np.nextafter(first, np.inf)))


@dataclass(frozen=True, eq=False)
class ShownPair:
    """The pair of submaps that the figures show.

    Attributes:
        query: The query submap.
        database: The database submap.
        matches: The associations of their keypoints.
        closure: The verdict on the pair.
        motion: ``T_database_query``.
        right: Whether the true poses say that the pair is true and its motion right; None if they
            are not known.
    """

    query: ShownSubmap
    database: ShownSubmap
    matches: Matches
    closure: LoopClosure
    motion: SE2
    right: bool | None = None


@dataclass(frozen=True, eq=False)
class Subject:
    """A dataset and all that its figures show.

    Attributes:
        dataset: The dataset.
        method: The first method, whose maps are shown.
        shown: A submap that is shown, the query of the pair if there is one; None if no figure
            needs it.
        pair: The pair that is shown; None if no figure needs it, or if no pair has a motion.
        evaluation: The methods, judged by the true poses; None if these are not known, or if no
            figure needs it.
        notes: What was left out and why, one line each.
    """

    dataset: Dataset
    method: Method
    shown: ShownSubmap | None = None
    pair: ShownPair | None = None
    evaluation: Evaluation | None = None
    notes: tuple[str, ...] = ()


def poses_of(dataset: Dataset) -> tuple[dict[str, Pose], str]:
    """Give the poses by which the submaps are drawn in one frame, and say which these are.

    Returns:
        The true poses by id if there are two or more, or else those of odometry, or none; and
        their name.
    """
    submaps = dataset.submaps
    for name, poses in (
        ("true poses", {submap.id: submap.pose_true for submap in submaps}),
        ("odometry", {submap.id: submap.pose_odometry for submap in submaps}),
    ):
        measured = {submap: pose for submap, pose in poses.items() if pose is not None}
        if len(measured) >= 2:
            return measured, name
    return {}, ""


def check_method(method: Method) -> None:
    """Check that a method has the maps and keypoints that the figures show.

    Raises:
        InputError: If it has none.
    """
    detector = method.detector(method.ready(PipelineParams()), Memo())
    if not isinstance(detector, SearchableDetector):
        raise InputError(
            f"--method {method.name}: has no gradient maps, and the first method must have them; "
            "name paper, gradient, elevation or smoothed first"
        )


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
    judged = sum(submap.pose_true is not None for submap in dataset.submaps) >= 2
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
    shown = pair = None
    if numbers & DETAILS:
        closure = choose(dataset, results[leading.name].closures, evaluation)
        detector = leading.detector(settled, Memo(store=store))
        if closure is None:
            shown, _ = _show(dataset.submaps[0], detector, settled)
        else:
            pair = _show_pair(dataset, closure, evaluation, detector, settled)
            shown = pair.query
    progress(1.0)
    return Subject(dataset, leading, shown, pair, evaluation, tuple(notes))


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
        return (
            is_right(closure, evaluation) or False,
            closure.accepted,
            place[closure.query_id] - place[closure.database_id] > 1,
            closure.registration.num_inliers,
            closure.registration.score,
        )

    moved = [closure for closure in closures if closure.registration.T_database_query is not None]
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


def _show_pair(
    dataset: Dataset,
    closure: LoopClosure,
    evaluation: Evaluation | None,
    detector: LoopDetector,
    params: PipelineParams,
) -> ShownPair:
    (query, query_features), (database, database_features) = (
        _show(dataset.submap(name), detector, params)
        for name in (closure.query_id, closure.database_id)
    )
    matches = match_features(query_features, database_features, params.matching)
    registration = closure.registration
    assert len(matches) == len(registration.inliers)
    assert registration.T_database_query is not None  # of a pair that was chosen
    right = is_right(closure, evaluation)
    return ShownPair(query, database, matches, closure, registration.T_database_query, right)


def _show(
    submap: Submap, detector: LoopDetector, params: PipelineParams
) -> tuple[ShownSubmap, Features]:
    """Make a submap's map again, from the store, and give its keypoints too."""
    assert isinstance(detector, SearchableDetector)
    inferred = detector.infer(submap)
    # The map alone, or more with it.
    made = inferred if isinstance(inferred, GradientMap) else inferred.gradient_map
    shown = ShownSubmap(submap, made, params.features.max_std_ratio)
    return shown, detector.keypoints(detector.extract(inferred))
