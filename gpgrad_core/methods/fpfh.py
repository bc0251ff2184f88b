"""Fast point feature histograms with RANSAC, or with fast global registration (Open3D)."""

from threading import Lock

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.detection import PipelineParams
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.described_clouds import (
    DescribedCloud,
    mutual_matches,
    register_by_ransac,
    thinned,
)
from gpgrad_core.methods.rival import CloudDetector, seen_from_above, unchecked
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Registration, Submap

VOXEL = 0.5
"""Side of a voxel [length-scales]: 15 cm with the default length-scale of 0.3 m."""
NORMAL_RADIUS = 2.0
FEATURE_RADIUS = 5.0
"""Radii for normals and for features [voxels], as in Open3D's examples."""
FEATURE_NEIGHBOURS = 100

_open3d_random = Lock()


def fpfh_detector(params: PipelineParams, memo: Memo) -> CloudDetector[DescribedCloud]:
    """Make FPFH with RANSAC."""
    return CloudDetector(describe_fpfh, register_by_ransac, params, memo)


def fgr_detector(params: PipelineParams, memo: Memo) -> CloudDetector[DescribedCloud]:
    """Make FPFH with fast global registration (Zhou 2016)."""
    return CloudDetector(describe_fpfh, register_by_fgr, params, memo)


def describe_fpfh(submap: Submap, params: PipelineParams) -> DescribedCloud:
    """Describe every voxel of a submap."""
    voxel = VOXEL * params.map.terrain.length_scale
    cloud = thinned(submap, voxel, NORMAL_RADIUS * voxel)
    o3d = load_library("open3d")
    search = o3d.geometry.KDTreeSearchParamHybrid(
        radius=FEATURE_RADIUS * voxel, max_nn=FEATURE_NEIGHBOURS
    )
    features = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)
    return DescribedCloud(
        np.asarray(cloud.points).copy(),
        np.asarray(features.data, dtype=np.float32).T.copy(),
        submap.points.mean(axis=0, keepdims=True),
    )


def register_by_fgr(
    query: DescribedCloud, database: DescribedCloud, params: PipelineParams
) -> Registration:
    """Register by fast global registration over mutual associations.

    It has no score of its own, so its inliers are counted as RANSAC's are.
    """
    pairs = mutual_matches(query, database)
    if len(pairs) < 3:
        return unchecked(None, np.zeros(len(pairs), bool))
    radius = params.registration.radius(None)
    o3d = load_library("open3d")
    option = o3d.pipelines.registration.FastGlobalRegistrationOption(
        use_absolute_scale=True, maximum_correspondence_distance=radius
    )
    arguments = (
        _cloud(query.points),
        _cloud(database.points),
        o3d.utility.Vector2iVector(pairs.astype(np.int32)),
        option,
    )
    with _open3d_random:  # Open3D has one random generator for the whole process
        o3d.utility.random.seed(params.registration.seed)
        solution = o3d.pipelines.registration.registration_fgr_based_on_correspondence(*arguments)
    motion = np.array(solution.transformation, dtype=np.float64)
    moved = query.points[pairs[:, 0]] @ motion[:3, :3].T + motion[:3, 3]
    inliers = np.linalg.norm(moved - database.points[pairs[:, 1]], axis=1) <= radius
    return unchecked(seen_from_above(motion, query.middle), inliers)


def _cloud(points: Float[Array, "n 3"]) -> object:
    o3d = load_library("open3d")
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points)))
