"""Runs the stages: for one submap, for a pair, coarsely; and as a `StagedDetector`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.detection.automatic import resolve_parameters
from gpgrad_core.detection.engine import StagedDetector
from gpgrad_core.detection.images import extract_images, judge_by_images, some_of
from gpgrad_core.detection.stages import (
    DETECT,
    FIT,
    MATCH,
    PREPARE,
    REGISTER,
    SAMPLE,
    SEARCH,
    SELECT,
    PipelineParams,
    Stage,
    Stages,
)
from gpgrad_core.detection.verdict import classify, with_images
from gpgrad_core.display import card
from gpgrad_core.features import check_detector
from gpgrad_core.gp.cloud import bin_points
from gpgrad_core.gp.solution import ROUGH, Posterior
from gpgrad_core.mapping.gradient_map import (
    MapParams,
    TerrainParams,
    check_num_points,
    fit_terrain,
    map_grid,
    sample_map,
    sample_rows,
    signal_std_of,
)
from gpgrad_core.registration import Prepared
from gpgrad_core.run import Progress, part, silent
from gpgrad_core.run.helper import Helper, beside
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import (
    Array,
    Context,
    Features,
    GradientMap,
    LoopClosure,
    Matches,
    Registration,
    Submap,
    read_only,
)

FIT_SHARE = 0.1
"""Share of the progress that fitting the parameters takes up."""


@dataclass(frozen=True, eq=False)
class PairResult:
    """The results of all stages for one pair of submaps.

    Attributes:
        query_map: Gradient map of the query.
        database_map: Gradient map of the database.
        query_features: Keypoints of the query's map.
        database_features: Keypoints of the database's map.
        matches: Associations between the keypoints.
        registration: The registration of the query to the database.
        closure: The verdict.
    """

    query_map: GradientMap
    database_map: GradientMap
    query_features: Features
    database_features: Features
    matches: Matches
    registration: Registration
    closure: LoopClosure

    @property
    def maps(self) -> tuple[GradientMap, GradientMap]:
        """Maps of (query, database)."""
        return self.query_map, self.database_map

    @property
    def features(self) -> tuple[Features, Features]:
        """Keypoints of (query, database)."""
        return self.query_features, self.database_features

    def _repr_html_(self) -> str:
        closure = self.closure
        shown = self.query_map.pictures(closure.query_id)
        shown += self.database_map.pictures(closure.database_id)
        rows = self.registration.in_words
        return card(closure.title, rows, pictures=shown, note=closure.reason)


def infer_gradient_map(
    submap: Submap, params: MapParams | None = None, progress: Progress = silent
) -> GradientMap:
    """Infer elevation, variance and slopes over the submap's bounding box, Eqs. (2)-(5).

    Args:
        submap: Gravity-aligned points [m].
        params: Parameters of the GP and the grid; None takes the defaults. If length-scale or noise
            are automatic, all that is automatic is fitted to this submap, as `resolve_parameters`
            does.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        The gradient map, with elevations in metres and slopes in m/m.

    Raises:
        InputError: If the grid or the GP would be too large, or if the GP cannot be solved.
    """
    params = params or MapParams()
    map_grid(submap, params.resolution)  # refuse a cloud that is too wide before the long work
    params, progress = _with_numbers(submap, params, progress)
    posterior = fit_terrain(submap, params.terrain, progress=progress)
    return sample_map(submap, posterior, params.resolution, params.scale)


def infer_slope_variance(
    submap: Submap, params: MapParams | None = None, progress: Progress = silent
) -> Float[Array, "rows columns 2"]:
    """Infer the variance of the slopes of `infer_gradient_map`.

    The paper does not have it. Eq. (3) is differentiated as Eqs. (4) and (5) differentiate Eq. (2),
    with D the diagonal matrix of the points' noise variances:

        var(∂z/∂x) = ∂²k/∂x∂x' - ∂K(x, X)/∂x [K(X, X) + D]⁻¹ ∂K(X, x')/∂x'

    Args:
        submap: Gravity-aligned points [m].
        params: Parameters of the GP and the grid, as in `infer_gradient_map`.
        progress: Called with the fraction done; may raise Cancelled.

    Returns:
        Posterior variance of the slope along x and along y (rows, columns, 2) [m²/m²].

    Raises:
        InputError: If the grid or the GP would be too large, or if the GP cannot be solved.
    """
    params = params or MapParams()
    grid = map_grid(submap, params.resolution)
    params, progress = _with_numbers(submap, params, progress)
    return fit_terrain(submap, params.terrain, progress=progress).sample_slope_variance(grid)


def _with_numbers(
    submap: Submap, params: MapParams, progress: Progress
) -> tuple[MapParams, Progress]:
    if params.has_numbers:
        return params, progress
    requested = PipelineParams(map=params)
    fitted = resolve_parameters([submap], requested, progress=part(progress, 0.0, 0.5))
    return fitted.map, part(progress, 0.5, 1.0)


def infer_map(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """Make a submap's gradient map; the memo keeps the fitted GP and the map separately."""
    map_grid(submap, params.map.resolution)  # refuses a cloud that is too wide, before the fit
    return Stages(params, memo).run(SAMPLE, submap, progress=progress)


def check_affordable(submap: Submap, params: PipelineParams) -> None:
    """Raise InputError if a submap's map is too large, or the detector cannot search it."""
    check_num_points(submap, params.map.max_points)
    check_detector(map_grid(submap, params.map.resolution), params.features.detector)


def infer_features(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> Features:
    """Make a submap's keypoints."""
    check_affordable(submap, params)
    return Stages(params, memo).run(SELECT, submap, progress=progress)


def extract_keypoints(gradient_map: GradientMap, params: PipelineParams, memo: Memo) -> Features:
    """Extract a map's keypoints; the memo keeps all of them for another mask."""
    stages = Stages(params, memo)
    return stages.apply(SELECT, stages.apply(DETECT, gradient_map))


LONG_STAGES: tuple[Stage[object], ...] = (FIT, SAMPLE, DETECT, PREPARE)
"""Stages of one submap that are worth another process."""


def _run_long_stages(
    submap: Submap, params: PipelineParams, memo: Memo, progress: Progress = silent
) -> tuple[object, ...]:
    stages = Stages(params, memo)
    return tuple(stages.run(stage, submap, progress=progress) for stage in LONG_STAGES)


def register_pair(
    query: Submap,
    database: Submap,
    params: PipelineParams,
    memo: Memo,
    progress: Progress = silent,
    helper: Helper | None = None,
) -> PairResult:
    """Run all stages for one pair; what the memo has is not computed again.

    Args:
        query: The submap to be placed.
        database: The submap on which it is placed.
        params: Parameters of all stages. If length-scale or noise are automatic, all that is
            automatic is fitted to the two submaps.
        memo: Shared by all calls that may need the same results.
        progress: Called with the fraction done; may raise Cancelled.
        helper: Takes over one of the submaps if both are new; the result is the same.

    Raises:
        InputError: If a submap's map cannot be made.
    """
    for submap in (query, database):
        check_affordable(submap, params)  # refused before the long work on either
    if not params.map.has_numbers:
        params = resolve_parameters((query, database), params, memo, part(progress, 0.0, FIT_SHARE))
        progress = part(progress, FIT_SHARE, 1.0)
    stages = Stages(params, memo)
    if helper is not None and not (stages.holds(FIT, query) or stages.holds(FIT, database)):
        here, there = (query, params, memo), (database, params, Memo())
        _, results = beside(helper, _run_long_stages, here, there, part(progress, 0.0, 0.8))
        for stage, result in zip(LONG_STAGES, results, strict=True):
            stages.keep(result, stage, database)
    query_map = stages.run(SAMPLE, query, progress=part(progress, 0.0, 0.4))
    database_map = stages.run(SAMPLE, database, progress=part(progress, 0.4, 0.8))
    query_features, database_features = (stages.run(SELECT, side) for side in (query, database))
    matches = stages.run(MATCH, query, database)
    registration = stages.run(REGISTER, query, database, progress=part(progress, 0.8, 1.0))
    closure = judge_pair(query, database, registration, params, memo)
    return PairResult(
        query_map, database_map, query_features, database_features, matches, registration, closure
    )


def judge_pair(
    query: Submap,
    database: Submap,
    registration: Registration,
    params: PipelineParams,
    memo: Memo,
    context: Context | None = None,
) -> LoopClosure:
    """Accept or refuse a registration by its terrain, and then by images if they count."""
    closure = classify(
        registration, params.closure, query_id=query.id, database_id=database.id, context=context
    )
    motion = registration.T_database_query
    if params.closure.images == "off" or not closure.accepted or motion is None:
        return closure
    images = None
    if query.images and database.images:
        images = judge_by_images(
            memo(extract_images, some_of(query.images)),
            memo(extract_images, some_of(database.images)),
            motion,
            params.registration.seed,
        )
    return with_images(closure, images, params.closure)


MapMaker: TypeAlias = Callable[[Submap, PipelineParams, Memo, Progress], GradientMap]


@dataclass(frozen=True, eq=False)
class ExtractedSubmap:
    """What the comparison needs of one submap; processes exchange it."""

    features: Features  # keypoints of its map
    prepared: Prepared  # its map, prepared for registration


@dataclass(frozen=True, eq=False)
class MapDetector(StagedDetector[GradientMap, ExtractedSubmap]):
    """The pipeline as a `LoopDetector`; with other maps or images, it is some of its rivals."""

    params: PipelineParams
    memo: Memo
    make_map: MapMaker = infer_map
    # makes the map whose ``gradient`` is the image for the keypoints; None takes the map itself
    drawn_from: Callable[[GradientMap], GradientMap] | None = None

    def infer(self, submap: Submap, progress: Progress = silent) -> GradientMap:
        if self.make_map is infer_map:
            check_affordable(submap, self.params)
        return self.make_map(submap, self.params, self.memo, progress)

    def extract(self, inferred: GradientMap, progress: Progress = silent) -> ExtractedSubmap:
        image = inferred if self.drawn_from is None else self.memo(self.drawn_from, inferred)
        features = extract_keypoints(image, self.params, self.memo)
        progress(1.0)
        return ExtractedSubmap(features, Stages(self.params, self.memo).apply(PREPARE, inferred))

    def keypoints(self, extracted: ExtractedSubmap) -> Features:
        return extracted.features

    def compare(self, query: ExtractedSubmap, database: ExtractedSubmap) -> Registration:
        stages, prepared = Stages(self.params, self.memo), (query.prepared, database.prepared)
        matches = stages.apply(MATCH, query.features, database.features)
        return stages.apply(REGISTER, *prepared, matches, stages.apply(SEARCH, *prepared))


COARSER = 3.0
"""Side of a cell of the coarse map, in cells of the full map."""
THINNED_TO = 0.7
"""Side of the cells that keep one point each, in length-scales."""
FEWEST_CELLS = 50
"""Least number of these cells along the longer side."""
BENT = 0.25
"""Least standard deviation of the mean of a cell of one length-scale, in those of the terrain: what
the ground bends within the cell."""
LEAST_SIGNAL_STD = 0.001
"""Smallest value that the parameters allow [m]."""


def infer_coarse_map(
    submap: Submap, params: MapParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """Infer the map from fewer points on larger cells, or from the full fit if the memo has it."""
    resolution = COARSER * params.resolution
    map_grid(submap, resolution)  # refuses a cloud that is too wide, before the long work
    stages = Stages(PipelineParams(map=params), memo)
    if stages.holds(FIT, submap):
        posterior = stages.run(FIT, submap)
    else:
        rows = sample_rows(submap, params.max_points)
        signal_std = signal_std_of(submap.points[rows], params.terrain)
        fewer = replace(
            params.terrain,
            signal_std=max(signal_std, LEAST_SIGNAL_STD),
            max_points=None,
            noise_model="file",
            noise_factor=1.0,
        )
        thinned = memo(thin_evenly, submap, params.terrain)
        posterior = memo(fit_roughly, thinned, fewer, progress=progress)
    return memo(sample_map, submap, posterior, resolution, params.scale)


def fit_roughly(submap: Submap, params: TerrainParams, progress: Progress = silent) -> Posterior:
    """Fit the GP with reduced accuracy."""
    return fit_terrain(submap, params, progress, ROUGH)


def thin_evenly(submap: Submap, params: TerrainParams) -> Submap:
    """Replace the points of each cell of `THINNED_TO` length-scales by their weighted mean."""
    rows = sample_rows(submap, params.max_points)
    points, noise_std = submap.points[rows], params.noise.ordinary(submap)[rows]
    longest = float(np.ptp(points[:, :2], axis=0).max())
    cell = min(THINNED_TO * params.length_scale, longest / FEWEST_CELLS)
    means, std_of_mean = bin_points(points, cell, noise_std)
    # The ground bends within a cell, so a mean tells less than its many points do.
    bent = BENT * signal_std_of(points, params) * (cell / params.length_scale) ** 2
    cell_std = np.hypot(std_of_mean, bent)
    read_only(means)
    # This fingerprint is a new key for the memo, without hashing the points again.
    return Submap(submap.id, means, f"{submap.fingerprint}-{hash(params)}", noise_std=cell_std)


def infer_quick_maps(
    query: Submap,
    database: Submap,
    params: MapParams,
    memo: Memo,
    helper: Helper | None = None,
    progress: Progress = silent,
) -> tuple[GradientMap, GradientMap]:
    """Make the `infer_quick_map` of two submaps, side by side if there is a helper."""
    stages = Stages(PipelineParams(map=params), memo)
    if helper is None or stages.holds(FIT, query) or stages.holds(FIT, database):
        first, other = (infer_quick_map(side, params, memo, progress) for side in (query, database))
        return first, other
    here, there = (query, params, memo), (database, params, Memo())
    return beside(helper, infer_coarse_map, here, there, progress)


def infer_quick_map(
    submap: Submap, params: MapParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """The full map if the memo has it, otherwise a coarse one."""
    stages = Stages(PipelineParams(map=params), memo)
    if stages.holds(SAMPLE, submap):
        return stages.run(SAMPLE, submap)
    return infer_coarse_map(submap, params, memo, progress)
