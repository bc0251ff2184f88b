"""The paper to the letter: its tuning, its map, its keypoints, and its Algorithm 1 with n and h.

If the paper leaves a number or a step open, `paper_params` says what is used. The pipeline differs
from the paper by its detector, its noise, its one-to-one inliers and its dense check.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from jaxtyping import Bool, Int

from gpgrad_core.arrays import Indices, Mask
from gpgrad_core.detection import (
    PairResult,
    PipelineParams,
    StagedDetector,
    check_affordable,
    extract_keypoints,
    fit_submap,
    fixed_hyperparameters,
    infer_map,
    judge_pair,
)
from gpgrad_core.detection.verdict import ClosureParams
from gpgrad_core.features import DetectorParams, FeatureParams
from gpgrad_core.features.detection import interpolate
from gpgrad_core.gp.likelihood import Hyperparameters
from gpgrad_core.mapping.gradient_map import MapParams, TerrainParams
from gpgrad_core.matching import MatchParams, match_features
from gpgrad_core.registration import RegistrationParams
from gpgrad_core.registration.candidates import draw_pairs
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2, fit_se2
from gpgrad_core.types import Features, GradientMap, Matches, Registration, Submap

P = TypeVar("P")

START_LENGTH_SCALE = 0.316
"""√0.1 m: Eq. (6) prints 2 l_k in place of the usual 2 l², and l_k is about 0.1 (Sec. VI-B)."""
START_NOISE_STD = 0.05
"""Start of the fit's noise [m]; the paper's "typical elevation accuracy" has no number."""
PAPER = PipelineParams(
    map=MapParams(max_points=5000, resolution=0.03),
    features=FeatureParams(max_keypoints=20_000, detector=DetectorParams("surf")),
    matching=MatchParams(ratio=1.0, mutual=True),
    registration=RegistrationParams(inlier_radius=0.15, trials=5000),
    closure=ClosureParams(min_inliers=5, min_score=0.0, others="off"),
)
"""The paper's parameters, with `paper_params`' choices where the paper has no number."""


def paper_params(params: PipelineParams) -> PipelineParams:
    """Replace the parameters that are left at their default by the paper's (Secs. V to VII)."""
    return _with_defaults(params, PipelineParams(), PAPER)


def _with_defaults(params: P, usual: P, replacement: P) -> P:
    """Replace each value that is the usual one by the wanted one."""
    changes: dict[str, object] = {}
    for field in fields(cast("Any", params)):
        value, default, paper = (
            getattr(group, field.name) for group in (params, usual, replacement)
        )
        if is_dataclass(value):
            changes[field.name] = _with_defaults(value, default, paper)
        elif value == default:
            changes[field.name] = paper
    return cast("P", replace(cast("Any", params), **changes))


def paper_start(params: MapParams) -> TerrainParams:
    """The terrain's parameters at which the fit of every submap starts (Sec. VI-B)."""
    return params.starting_at(START_LENGTH_SCALE, START_NOISE_STD).terrain


def tune(
    submap: Submap, params: MapParams, memo: Memo, progress: Progress = silent
) -> TerrainParams:
    """Fit a submap's terrain parameters that are None; the memo, with a store, keeps the fit."""
    start, fixed = paper_start(params), fixed_hyperparameters(params)
    if {"length_scale", "noise"} <= set(fixed):
        return start
    return memo.lasting(fit_submap, submap, start, fixed, progress=progress).params


@dataclass(frozen=True, eq=False)
class TunedMap:
    """A gradient map, with the parameters that were fitted to its submap."""

    gradient_map: GradientMap  # the map
    terrain: TerrainParams  # its own parameters, with which it was made


@dataclass(frozen=True, eq=False)
class PaperSubmap(TunedMap):
    """What the paper's comparison needs of one submap."""

    features: Features  # its keypoints


@dataclass(frozen=True, eq=False)
class PaperPair(PairResult):
    """The results of all stages of the paper for one pair of submaps."""

    query_terrain: TerrainParams  # the terrain's parameters that were fitted to the query
    database_terrain: TerrainParams  # those that were fitted to the database


def infer_tuned(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> TunedMap:
    """Fit the terrain's parameters to a submap, and make its map; the memo keeps each step."""
    check_affordable(submap, params)  # refused before the long work
    terrain = tune(submap, params.map, memo, part(progress, 0.0, 0.6))
    gradient_map = infer_map(submap, with_terrain(params, terrain), memo, part(progress, 0.6, 1.0))
    return TunedMap(gradient_map, terrain)


def with_terrain(params: PipelineParams, terrain: TerrainParams) -> PipelineParams:
    """Replace the pipeline's terrain parameters by those of one submap."""
    names = ("length_scale", "noise_std", "noise_growth", "noise_factor", "signal_std")
    own = {name: getattr(terrain, name) for name in names}
    return replace(params, map=replace(params.map, **own))


def register_paper_pair(
    query: Submap, database: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> PaperPair:
    """Run the paper's stages for one pair; what the memo has is not computed again."""
    detector = PaperDetector(params, memo)
    query_side = detector.extract(detector.infer(query, part(progress, 0.0, 0.4)))
    database_side = detector.extract(detector.infer(database, part(progress, 0.4, 0.8)))
    matches, registration = detector.match_and_register(query_side, database_side)
    progress(1.0)
    return PaperPair(
        query_side.gradient_map,
        database_side.gradient_map,
        query_side.features,
        database_side.features,
        matches,
        registration,
        judge_pair(query, database, registration, params, memo),
        query_side.terrain,
        database_side.terrain,
    )


@dataclass(frozen=True, eq=False)
class PaperDetector(StagedDetector[TunedMap, PaperSubmap]):
    """The paper as a `LoopDetector`: a tuning for every submap, SURF, Algorithm 1 as printed."""

    params: PipelineParams  # the parameters from `paper_params`
    memo: Memo  # keeps the results of each submap; it is empty at first in another process

    def infer(self, submap: Submap, progress: Progress = silent) -> TunedMap:
        return infer_tuned(submap, self.params, self.memo, progress)

    def extract(self, inferred: TunedMap, progress: Progress = silent) -> PaperSubmap:
        features = extract_keypoints(inferred.gradient_map, self.params, self.memo)
        progress(1.0)
        return PaperSubmap(inferred.gradient_map, inferred.terrain, features)

    def keypoints(self, extracted: PaperSubmap) -> Features:
        return extracted.features

    def hyperparameters(self, extracted: PaperSubmap) -> Hyperparameters:
        gradient_map = extracted.gradient_map
        return Hyperparameters(
            gradient_map.length_scale, gradient_map.signal_std, extracted.terrain.noise_std
        )

    def compare(self, query: PaperSubmap, database: PaperSubmap) -> Registration:
        return self.match_and_register(query, database)[1]

    def match_and_register(
        self, query: PaperSubmap, database: PaperSubmap
    ) -> tuple[Matches, Registration]:
        matches = self.memo(match_features, query.features, database.features, self.params.matching)
        params = self.params.registration
        return matches, self.memo(
            register_as_printed,
            query.gradient_map,
            database.gradient_map,
            matches,
            params.radius(None),
            params.trials,
            params.seed,
            limits_in_loop(self.params.closure),
        )


def limits_in_loop(closure: ClosureParams) -> ClosureParams | None:
    """Keep what the loop of Algorithm 1 needs to accept a motion by h; None if nothing."""
    if closure.max_dissimilarity is None and closure.max_mean_dissimilarity is None:
        return None
    return ClosureParams(
        min_inliers=closure.min_inliers,
        max_dissimilarity=closure.max_dissimilarity,
        max_mean_dissimilarity=closure.max_mean_dissimilarity,
    )


def register_as_printed(
    query: GradientMap,
    database: GradientMap,
    matches: Matches,
    inlier_radius: float,
    iterations: int,
    seed: int,
    limits: ClosureParams | None = None,
) -> Registration:
    """Run Algorithm 1 line by line.

    The loop keeps an accepted motion only if it has more inliers than all before, so it ends with
    the first of the accepted motions with the most. That one is found here from the most inliers
    downwards, and the expensive h is computed until one is accepted.

    ``inlier_radius`` is the distance threshold of GetInliers [m], ``iterations`` is Max Nb
    Iterations, and ``seed`` is for SelectRandomAsso. ``limits`` are those of AcceptTransformation
    on n and h; None accepts every motion.

    The result has the motion T, n as inliers and score, and h as dissimilarity. T is None if no
    iteration has two inliers. If none is accepted, it is the motion with the most inliers, so that
    it can be shown, with a score of 0.
    """
    best = Registration(None, np.zeros(len(matches), bool), np.inf, 0.0, 0.0, 0.0)
    if len(matches) < 2:
        return best
    pairs = np.column_stack(draw_pairs(len(matches), iterations, seed))
    inliers_of_all = _inliers_of_all(pairs, matches, inlier_radius)
    counts = np.count_nonzero(inliers_of_all, axis=1)
    tried: set[bytes] = set()
    for k in np.argsort(-counts, kind="stable"):
        inliers, count = inliers_of_all[k], int(counts[k])
        if count < 2 or (tried and limits is not None and count < limits.min_inliers):
            break
        if inliers.tobytes() in tried:
            continue
        tried.add(inliers.tobytes())
        # GetSE2Transform(A_i), the motion fitted to all inliers.
        motion = fit_se2(matches.query_xy[inliers], matches.database_xy[inliers])
        h, num_cells = ssd_metric(query, database, motion)
        mean = h / num_cells if num_cells else np.inf
        accepted = limits is None or not limits.too_dissimilar(h, mean)
        if accepted or best.T_database_query is None:
            area = num_cells * database.grid.resolution**2
            score = float(count) if accepted else 0.0
            best = Registration(motion, inliers, h, area, 0.0, score, mean_dissimilarity=mean)
        if accepted:
            break
    return best


def ssd_metric(
    query: GradientMap, database: GradientMap, T_database_query: SE2
) -> tuple[float, int]:
    """Compute the paper's ComputeSSDMetric, and the number of common cells.

        h = Σ (I_g^q - I_g^d)² / (I_v^q I_v^d)

    The sum goes over the cells of the database's map that lie in both; infinite without any.
    """
    there = T_database_query.inverse().apply(database.grid.positions)
    pixels = query.grid.to_pixel(there)
    common = ((pixels >= 0) & (pixels <= np.array(query.grid.shape[::-1]) - 1)).all(axis=1)
    if not common.any():
        return np.inf, 0
    image = np.dstack([query.gradient, query.variance]).astype(np.float32)
    gradient, variance = interpolate(image, pixels[common][:, None])[:, 0].astype(np.float64).T
    difference = gradient - database.gradient.ravel()[common]
    h = np.sum(difference**2 / (variance * database.variance.ravel()[common]))
    return float(h), int(common.sum())


def _inliers_of_all(
    pairs: Int[Indices, "t 2"], matches: Matches, radius: float
) -> Bool[Mask, "t m"]:
    """Compute GetSE2Transform of each pair, in closed form, and GetInliers."""
    query, database = (xy[:, 0] + 1j * xy[:, 1] for xy in (matches.query_xy, matches.database_xy))
    spans = [np.diff(points[pairs])[:, 0] for points in (query, database)]
    turn = np.exp(1j * np.angle(spans[1] * np.conj(spans[0])))
    offset = database[pairs].mean(axis=1) - turn * query[pairs].mean(axis=1)
    errors = turn[:, None] * query + offset[:, None] - database
    return np.abs(errors) <= radius
