"""Rivals from libraries: FPFH of Open3D, and the extra ``peers``: KISS-Matcher and MapClosures."""

from threading import Lock

import numpy as np

from gpgrad_core.detection import PipelineParams
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.rivals import (
    DescribedCloud,
    mutual_matches,
    open3d_cloud,
    planar_motion,
    thinned,
    unchecked,
)
from gpgrad_core.types import Registration, Submap

KISS_VOXEL = 0.5
"""Side of a voxel [length-scales]: 15 cm with the default length-scale of 0.3 m."""
DENSITY_CELL = 1 / 6
"""Side of a cell of MapClosures [length-scales]: 5 cm with the default length-scale."""
VOXEL = 0.5
"""Side of a voxel [length-scales]: 15 cm with the default length-scale of 0.3 m."""
NORMAL_RADIUS = 2.0
FEATURE_RADIUS = 5.0
"""Radii for normals and for features [voxels], as in Open3D's examples."""
_open3d_random = Lock()


def register_by_kiss_matcher(
    query: Submap, database: Submap, params: PipelineParams
) -> Registration:
    """Associate and solve by KISS-Matcher (Lim 2025); the score is the number of final inliers."""
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
    return unchecked(planar_motion(motion, query.points), inliers)


def register_by_map_closures(
    query: Submap, database: Submap, params: PipelineParams
) -> Registration:
    """Search for the query in one map by MapClosures (Gupta 2024); the score is the inliers."""
    module = load_library("map_closures.map_closures", "gpgrad[peers]")
    config = module.MapClosuresConfig(
        density_map_resolution=DENSITY_CELL * params.map.terrain.length_scale
    )
    finder = module.MapClosures(config)
    # It refuses read-only arrays, and does not compare maps with numbers close to each other.
    finder.get_closures(0, np.array(database.points))
    candidates = finder.get_top_k_closures(100, np.array(query.points), 1)
    if not candidates:
        return unchecked(None, np.zeros(0, bool))
    # The package's pose maps the older map, the database, into the query.
    pose = candidates[0].pose
    T_database_query = np.linalg.inv(np.asarray(pose)).astype(np.float64)
    inliers = np.ones(candidates[0].number_of_inliers, bool)
    return unchecked(planar_motion(T_database_query, query.points), inliers)


def describe_fpfh(submap: Submap, params: PipelineParams) -> DescribedCloud:
    """Describe every voxel of a submap by FPFH."""
    voxel = VOXEL * params.map.terrain.length_scale
    cloud = thinned(submap, voxel, NORMAL_RADIUS * voxel)
    o3d = load_library("open3d")
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=FEATURE_RADIUS * voxel, max_nn=100)
    features = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)
    return DescribedCloud(
        np.asarray(cloud.points).copy(),
        np.asarray(features.data, dtype=np.float32).T.copy(),
        submap.points.mean(axis=0, keepdims=True),
    )


def register_by_fgr(
    query: DescribedCloud, database: DescribedCloud, params: PipelineParams
) -> Registration:
    """Register by fast global registration (Zhou 2016); inliers count as RANSAC's."""
    pairs = mutual_matches(query, database)
    if len(pairs) < 3:
        return unchecked(None, np.zeros(len(pairs), bool))
    radius = params.registration.radius(None)
    o3d = load_library("open3d")
    option = o3d.pipelines.registration.FastGlobalRegistrationOption(
        use_absolute_scale=True, maximum_correspondence_distance=radius
    )
    arguments = (
        open3d_cloud(query.points),
        open3d_cloud(database.points),
        o3d.utility.Vector2iVector(pairs.astype(np.int32)),
        option,
    )
    with _open3d_random:  # Open3D has one random generator for the whole process
        o3d.utility.random.seed(params.registration.seed)
        solution = o3d.pipelines.registration.registration_fgr_based_on_correspondence(*arguments)
    motion = np.array(solution.transformation, dtype=np.float64)
    moved = query.points[pairs[:, 0]] @ motion[:3, :3].T + motion[:3, 3]
    inliers = np.linalg.norm(moved - database.points[pairs[:, 1]], axis=1) <= radius
    return unchecked(planar_motion(motion, query.middle), inliers)
