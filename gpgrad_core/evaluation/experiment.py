"""Runs methods, reads files of closures, and studies a dataset for the figures of the paper."""

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.detection import (
    AnyDetector,
    DetectionResult,
    Pairs,
    PipelineParams,
    as_detector,
    detect_loop_closures,
)
from gpgrad_core.detection.consistency import own_registration
from gpgrad_core.detection.shortlist import Candidates
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.judge import Evaluation, evaluate
from gpgrad_core.evaluation.rules import EvaluationParams
from gpgrad_core.io.records.closures import ClosureReport, read_closures, report_closures
from gpgrad_core.matching import match_features
from gpgrad_core.methods import Method
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.store import Store, key_of
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    LoopClosure,
    Matches,
    PairOfIds,
    Registration,
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


def run_methods(
    dataset: Dataset,
    methods: Sequence[Method],
    params: PipelineParams | None = None,
    *,
    candidates: Candidates = "automatic",
    executor: Executor | None = None,
    store: Store | None = None,
    progress: Progress = silent,
    only: Collection[tuple[str, str]] | None = None,
) -> dict[str, ClosureReport]:
    """Detect the loop closures of a dataset with each of several methods."""
    params = params or PipelineParams()
    names = [method.name for method in methods]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"method {name!r} is given twice; give it once")
    for method in methods:
        method.check_searchable(candidates)  # before the work of any
    reports: dict[str, ClosureReport] = {}
    fits = Memo(store=store)
    for k, method in enumerate(methods):
        adapted = method.resolve(dataset.submaps, params, fits)
        result = detect_loop_closures(
            dataset,
            adapted,
            detector=method.detector(adapted, Memo(store=store)),
            candidates=candidates,
            executor=executor,
            progress=part(progress, k / len(methods), (k + 1) / len(methods)),
            only=only,
        )
        reports[method.name] = report_closures(dataset, result, adapted, method=method.name)
    return reports


def detect_stored(
    dataset: Dataset,
    method: Method,
    params: PipelineParams,
    store: Store | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> DetectionResult:
    """Compare all pairs by any method, and store the verdicts, but for those of images."""
    detector = as_detector(method.detector(params, Memo(store=store)))
    if detector.is_ordered or params.closure.images != "off":
        store = None

    def key(query: Submap, database: Submap) -> str:
        return key_of("verdict", method.name, query.id, database.id, query, database, params)

    registered: dict[PairOfIds, Registration] = {}
    missing: set[PairOfIds] = set()
    for database, query in combinations(dataset.submaps, 2):
        stored = None if store is None else store.get(key(query, database))
        if isinstance(stored, LoopClosure):
            registered[stored.pair] = own_registration(stored)
        else:
            missing.add((query.id, database.id))

    def keep(verdict: LoopClosure) -> None:
        if store is not None:
            store.put(key(*map(dataset.submap, verdict.pair)), verdict)

    alone = replace(params, closure=replace(params.closure, others="off"))
    pairs = Pairs.of(dataset.submaps, registered, alone, detector)
    if missing:
        pairs.compare(missing, executor, progress, on_verdict=keep)
    progress(1.0)
    return pairs.result(pairs.judge(params.closure))


def read_rivals(paths: Sequence[Path], taken: Collection[str] = ()) -> dict[str, ClosureReport]:
    """Read files of closures by any tool, each by a name not `taken`; InputError if one is none."""
    reports = [read_closures(path) for path in paths]
    methods = [*taken, *(report.method for report in reports)]
    rivals: dict[str, ClosureReport] = {}
    for path, report in zip(paths, reports, strict=True):
        alone = methods.count(report.method) == 1
        name = report.method if alone else f"{report.method} ({path})"
        if name in rivals:
            raise InputError(f"{path}: is given twice; give it once")
        rivals[name] = report
    return rivals


@dataclass(frozen=True, eq=False)
class ShownSubmap:
    """A submap that a figure shows."""

    submap: Submap
    map: GradientMap
    mask: float  # the threshold of the variance mask, as in `GradientMap.trusted`

    def trusted_range(
        self, values: Float[Array, "rows columns"], low: float, high: float
    ) -> tuple[float, float]:
        """Percentiles of a field over the trusted cells, or over all if there are none."""
        trusted = self.map.trusted(self.mask)
        some = values[trusted] if trusted.any() else values.ravel()
        first, last = np.percentile(some, [low, high])
        return float(first), float(max(last, np.nextafter(first, np.inf)))


@dataclass(frozen=True, eq=False)
class ShownPair:
    """The pair of submaps that the figures show."""

    query: ShownSubmap
    database: ShownSubmap
    matches: Matches  # the associations of their keypoints
    closure: LoopClosure  # the verdict on the pair
    motion: SE2  # ``T_database_query``
    # whether the true poses say that the pair is true and its motion right; None if they are not
    # known
    right: bool | None = None


@dataclass(frozen=True, eq=False)
class FigureData:
    """A dataset and all that its figures show."""

    dataset: Dataset
    method: Method  # the first method, whose maps are shown
    # a submap that is shown, the query of the pair if there is one; None if no figure needs it
    shown: ShownSubmap | None = None
    # the pair that is shown; None if no figure needs it, or if no pair has a motion
    pair: ShownPair | None = None
    # the methods, judged by the true poses; None if these are not known, or if no figure needs it
    evaluation: Evaluation | None = None
    notes: tuple[str, ...] = ()  # what was left out and why, one line each


def poses_of(dataset: Dataset) -> tuple[dict[str, Pose], str]:
    """The poses by which submaps are drawn in one frame, and their name."""
    for name, poses in (("true poses", dataset.true_poses), ("odometry", dataset.odometry)):
        if len(poses) >= 2:
            return poses, name
    return {}, ""


def check_method(method: Method) -> None:
    """Check that a method has the maps and keypoints that the figures show."""
    detector = as_detector(method.detector(method.ready(PipelineParams()), Memo()))
    if not detector.has_keypoints:
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
) -> FigureData:
    """Find out what the figures of one dataset need; all but the eighth are of the first method."""
    leading, *others = methods
    if not numbers & VERDICTS:
        progress(1.0)
        return FigureData(dataset, leading)
    judged = len(dataset.true_poses) >= 2
    selected = [leading, *(others if judged and 8 in numbers else ())]
    fits, notes = Memo(store=store), list[str]()
    results: dict[str, DetectionResult] = {}
    resolved = params
    for k, method in enumerate(selected):
        hook = part(progress, 0.95 * k / len(selected), 0.95 * (k + 1) / len(selected))
        try:
            adapted = method.resolve(dataset.submaps, params, fits)
            results[method.name] = detect_stored(
                dataset, method, adapted, store, executor=executor, progress=hook
            )
        except InputError as error:
            if method is leading:
                raise
            notes.append(f"{dataset.name}: {method.name} is left out: {error}")
            continue
        if method is leading:
            resolved = adapted
    evaluation = None
    if judged:
        evaluation = evaluate(dataset, results, judging, seed=params.registration.seed)
        notes += [f"{dataset.name}: {note}" for note in evaluation.pairs.notes]
    shown = pair = None
    if numbers & DETAILS:
        closure = choose(dataset, results[leading.name].closures, evaluation)
        detector = as_detector(leading.detector(resolved, Memo(store=store)))
        if closure is None:
            shown, _ = _show(dataset.submaps[0], detector, resolved)
        else:
            pair = _show_pair(dataset, closure, evaluation, detector, resolved)
            shown = pair.query
    progress(1.0)
    return FigureData(dataset, leading, shown, pair, evaluation, tuple(notes))


def choose(
    dataset: Dataset, closures: Sequence[LoopClosure], evaluation: Evaluation | None
) -> LoopClosure | None:
    """Choose the pair to show: right if that is known, accepted, no neighbours, most inliers."""
    index = dataset.index

    def worth(closure: LoopClosure) -> tuple[object, ...]:
        return (
            is_right(closure, evaluation) or False,
            closure.accepted,
            index[closure.query_id] - index[closure.database_id] > 1,
            closure.registration.num_inliers,
            closure.registration.score,
        )

    moved = [closure for closure in closures if closure.registration.T_database_query is not None]
    return max(moved, key=worth, default=None)  # of equals, the first


def is_right(closure: LoopClosure, evaluation: Evaluation | None) -> bool | None:
    """Whether a pair is true by the first rule and its motion right; None if not known."""
    if evaluation is None:
        return None
    row = evaluation.pairs.rows.get(frozenset(closure.pair))
    if row is None:
        return None
    overlap = evaluation.rules[0].measured(evaluation.pairs)[row]
    near = evaluation.methods[0].errors.near[row]
    return bool(overlap > evaluation.rules[0].threshold and near)


def _show_pair(
    dataset: Dataset,
    closure: LoopClosure,
    evaluation: Evaluation | None,
    detector: AnyDetector,
    params: PipelineParams,
) -> ShownPair:
    (query, query_features), (database, database_features) = (
        _show(dataset.submap(name), detector, params) for name in closure.pair
    )
    matches = match_features(query_features, database_features, params.matching)
    registration = closure.registration
    assert len(matches) == len(registration.inliers)
    assert registration.T_database_query is not None  # of a pair that was chosen
    right = is_right(closure, evaluation)
    return ShownPair(query, database, matches, closure, registration.T_database_query, right)


def _show(
    submap: Submap, detector: AnyDetector, params: PipelineParams
) -> tuple[ShownSubmap, Features]:
    """Make a submap's map again, from the store, and give its keypoints too."""
    inferred = detector.infer(submap)
    # The map alone, or more with it.
    gradient_map = inferred if isinstance(inferred, GradientMap) else inferred.gradient_map
    shown = ShownSubmap(submap, gradient_map, params.features.max_std_ratio)
    return shown, detector.keypoints(detector.extract(inferred))
