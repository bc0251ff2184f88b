"""The order of the stages; the only file that knows it."""

from dataclasses import dataclass, field
from time import perf_counter

from gpgrad_core.features import FeatureParams, detect_features, select_trusted
from gpgrad_core.gradient_map import MapParams, fit_terrain, map_grid, sample_map
from gpgrad_core.loop_closure import ClosureParams, classify
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.memo import Memo
from gpgrad_core.progress import Progress, part, silent
from gpgrad_core.registration import RegistrationParams, register
from gpgrad_core.types import (
    Dataset,
    Features,
    GradientMap,
    LoopClosure,
    Matches,
    Registration,
    Submap,
)


@dataclass(frozen=True)
class PipelineParams:
    """All parameters, a group a stage."""

    map: MapParams = field(default_factory=MapParams)
    features: FeatureParams = field(default_factory=FeatureParams)
    matching: MatchParams = field(default_factory=MatchParams)
    registration: RegistrationParams = field(default_factory=RegistrationParams)
    closure: ClosureParams = field(default_factory=ClosureParams)


@dataclass(frozen=True, eq=False)
class PairResult:
    """Everything between two submaps and the verdict on them, for whoever wants to look."""

    query_map: GradientMap
    database_map: GradientMap
    query_features: Features
    database_features: Features
    matches: Matches
    registration: Registration
    closure: LoopClosure


@dataclass(frozen=True, eq=False)
class DetectionResult:
    """All pairs of a dataset, each with its verdict.

    Attributes:
        closures: Every unordered pair once; the database submap is the earlier one.
        seconds: Time spent, by stage: maps, features, pairs, total.
    """

    closures: tuple[LoopClosure, ...]
    seconds: dict[str, float]


def infer_map(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """Make a submap's gradient map, keeping the fitted GP and the map apart."""
    map_grid(submap, params.map.resolution)  # refuse a cloud that is too wide before the long work
    posterior = memo(fit_terrain, submap, params.map.terrain, progress=progress)
    return memo(sample_map, submap, posterior, params.map.resolution)


def infer_features(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> Features:
    """Make a submap's keypoints, keeping the untrusted ones apart for when the mask moves."""
    gradient_map = infer_map(submap, params, memo, progress)
    detected = memo(detect_features, gradient_map, params.features.detector)
    return memo(select_trusted, detected, params.features)


def register_pair(
    query: Submap,
    database: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
) -> PairResult:
    """Run every stage for one pair; what is in the memo is not run again.

    Args:
        query: Submap to be placed.
        database: Submap it is placed on.
        params: Of all stages.
        memo: Shared by all calls that may ask for the same again.
        progress: Called with the fraction done; may raise Cancelled.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    query_features = infer_features(query, params, memo, part(progress, 0.0, 0.4))
    database_features = infer_features(database, params, memo, part(progress, 0.4, 0.8))
    query_map = infer_map(query, params, memo)
    database_map = infer_map(database, params, memo)
    matches = memo(match_features, query_features, database_features, params.matching)
    registration = memo(
        register,
        query_map,
        database_map,
        matches,
        params.registration,
        progress=part(progress, 0.8, 1.0),
    )
    closure = classify(registration, params.closure, query_id=query.id, database_id=database.id)
    return PairResult(
        query_map,
        database_map,
        query_features,
        database_features,
        matches,
        registration,
        closure,
    )


def detect_loop_closures(
    dataset: Dataset,
    params: PipelineParams | None = None,
    *,
    memo: Memo | None = None,
    progress: Progress = silent,
) -> DetectionResult:
    """Compare every submap with all earlier ones.

    Args:
        dataset: Submaps in order.
        params: Of all stages.
        memo: To share results with other calls; None keeps what this call needs.
        progress: Called once a map and once a pair; may raise Cancelled.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    params = params or PipelineParams()
    memo = memo or Memo()
    submaps = dataset.submaps
    start = perf_counter()
    for k, submap in enumerate(submaps):
        infer_map(submap, params, memo, part(progress, *_share(k, len(submaps), 0.0, 0.4)))
    maps_done = perf_counter()
    for k, submap in enumerate(submaps):
        infer_features(submap, params, memo)
        progress(_share(k, len(submaps), 0.4, 0.5)[1])
    features_done = perf_counter()
    pairs = [(query, database) for i, query in enumerate(submaps) for database in submaps[:i]]
    closures: list[LoopClosure] = []
    for k, (query, database) in enumerate(pairs):
        closures.append(register_pair(query, database, params, memo).closure)
        progress(_share(k, len(pairs), 0.5, 1.0)[1])
    done = perf_counter()
    seconds = {
        "maps": maps_done - start,
        "features": features_done - maps_done,
        "pairs": done - features_done,
        "total": done - start,
    }
    return DetectionResult(tuple(closures), seconds)


def _share(k: int, count: int, start: float, stop: float) -> tuple[float, float]:
    """Stretch of the whole that step k of count takes up."""
    return start + (stop - start) * k / count, start + (stop - start) * (k + 1) / count
