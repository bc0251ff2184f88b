"""A coarse map in little time, to show while a slider moves and the full map is being made."""

from dataclasses import replace

import numpy as np

from gpgrad_core.detection.stages import FIT, SAMPLE, PipelineParams, Stages
from gpgrad_core.gp.cloud import bin_points
from gpgrad_core.gp.solution import ROUGH, Posterior
from gpgrad_core.mapping.gradient_map import (
    MapParams,
    TerrainParams,
    fit_terrain,
    kept_rows,
    map_grid,
    sample_map,
    signal_std_of,
)
from gpgrad_core.run.helper import Helper, beside
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.types import GradientMap, Submap, read_only

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
        rows = kept_rows(submap, params.max_points)
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
    rows = kept_rows(submap, params.max_points)
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
        made, other = (infer_quick_map(side, params, memo, progress) for side in (query, database))
        return made, other
    here, there = (query, params, memo), (database, params, Memo())
    return beside(helper, infer_coarse_map, here, there, progress)


def infer_quick_map(
    submap: Submap, params: MapParams, memo: Memo, progress: Progress = silent
) -> GradientMap:
    """Give the full map if the memo has it, otherwise a coarse one."""
    stages = Stages(PipelineParams(map=params), memo)
    if stages.holds(SAMPLE, submap):
        return stages.run(SAMPLE, submap)
    return infer_coarse_map(submap, params, memo, progress)
