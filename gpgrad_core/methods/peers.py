"""Rivals that are packages of their own, of the extra ``peers``: KISS-Matcher and MapClosures."""

import numpy as np

from gpgrad_core.detection import PipelineParams
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.rival import CloudDetector, seen_from_above, unchecked, undescribed
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Registration, Submap

KISS_VOXEL = 0.5
"""Side of a voxel [length-scales]: 15 cm with the default length-scale of 0.3 m."""
DENSITY_CELL = 1 / 6
"""Side of a cell of MapClosures [length-scales]: 5 cm with the default length-scale. The package's
own default, for cities, is 50 cm. Cells of 7.5 cm raise its AP on two of three datasets, to 0.32,
but miss an easy closure."""
DATABASE_ID, QUERY_ID = 0, 100
"""Numbers of two maps; MapClosures does not compare maps with numbers close to each other."""


def kiss_matcher_detector(params: PipelineParams, memo: Memo) -> CloudDetector[Submap]:
    """Make KISS-Matcher (Lim 2025): faster point feature histograms, a solver without RANSAC."""
    return CloudDetector(undescribed, _register_by_kiss, params, memo)


def _register_by_kiss(query: Submap, database: Submap, params: PipelineParams) -> Registration:
    """Associate and solve; the score is the number of the final inliers."""
    package = load_library("kiss_matcher", "gpgrad[peers]")
    # Quatro rotates about the vertical only, because both clouds are gravity-aligned.
    config = package.KISSMatcherConfig(
        KISS_VOXEL * params.map.terrain.length_scale, use_quatro=True
    )
    matcher = package.KISSMatcher(config)
    solution = matcher.estimate(query.points.astype(np.float32), database.points.astype(np.float32))
    num_inliers = matcher.get_num_final_inliers()
    inliers = np.arange(len(matcher.get_initial_correspondences())) < num_inliers
    if not solution.valid or num_inliers == 0:
        return unchecked(None, inliers)
    motion = np.eye(4)
    motion[:3, :3] = np.asarray(solution.rotation)
    motion[:3, 3] = np.asarray(solution.translation).ravel()
    return unchecked(seen_from_above(motion, query.points), inliers)


def map_closures_detector(params: PipelineParams, memo: Memo) -> CloudDetector[Submap]:
    """Make MapClosures (Gupta 2024): ORB on images of the point density, RANSAC in the plane."""
    return CloudDetector(undescribed, _register_by_density, params, memo)


def _register_by_density(query: Submap, database: Submap, params: PipelineParams) -> Registration:
    """Search for the query in a database of one map; the score is the number of inliers."""
    module = load_library("map_closures.map_closures", "gpgrad[peers]")
    config = module.MapClosuresConfig(
        density_map_resolution=DENSITY_CELL * params.map.terrain.length_scale
    )
    finder = module.MapClosures(config)
    finder.get_closures(DATABASE_ID, np.array(database.points))  # it refuses read-only arrays
    candidates = finder.get_top_k_closures(QUERY_ID, np.array(query.points), 1)
    if not candidates:
        return unchecked(None, np.zeros(0, bool))
    # The package's pose maps the older map, the database, into the query.
    pose = candidates[0].pose
    T_database_query = np.linalg.inv(np.asarray(pose)).astype(np.float64)
    inliers = np.ones(candidates[0].number_of_inliers, bool)
    return unchecked(seen_from_above(T_database_query, query.points), inliers)
