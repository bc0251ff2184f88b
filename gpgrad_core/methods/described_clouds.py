"""Thinned clouds with normals, and associations, which all methods with 3D descriptors share."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.outcome import outcome, seen_from_above
from gpgrad_core.methods.rigid_ransac import ransac_se3
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.types import Registration, Submap

NORMAL_NEIGHBOURS = 30


@dataclass(frozen=True, eq=False)
class DescribedCloud:
    """Keypoints of a cloud with their descriptors.

    Attributes:
        points: The keypoints (k, 3) [m].
        descriptors: Their descriptors (k, d).
        middle: Mean of the whole cloud (1, 3) [m].
    """

    points: Float[Array, "k 3"]
    descriptors: Float[NDArray[np.float32], "k d"]
    middle: Float[Array, "1 3"]


def thinned(submap: Submap, voxel: float, normal_radius: float) -> Any:
    """Thin a cloud to one mean per voxel, with normals that point up.

    Args:
        submap: The points, and their colours if it has them.
        voxel: Side of a voxel [m].
        normal_radius: Radius of the neighbourhood to which a normal is fitted [m].

    Returns:
        An Open3D cloud.
    """
    o3d: Any = load_library("open3d")
    points = np.array(submap.points)  # Open3D refuses arrays that are read-only
    cloud: Any = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if submap.colors is not None:
        cloud.colors = o3d.utility.Vector3dVector(np.array(submap.colors))
    cloud = cloud.voxel_down_sample(voxel)
    cloud.estimate_normals(
        o3d.geometry.KDTreeSearchParamHybrid(radius=normal_radius, max_nn=NORMAL_NEIGHBOURS)
    )
    cloud.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))
    return cloud


def height_between(
    query: Float[Array, "k 3"],
    database: Float[Array, "n 3"],
    T_database_query: Float[Array, "4 4"],
    reach: float,
) -> float:
    """Find how much higher the database's ground lies than the query's after a motion [m].

    Args:
        query: Points of the query [m].
        database: Points of the database [m].
        T_database_query: The motion.
        reach: Points that are no further apart than this, seen from above, are compared [m].

    Returns:
        The median of the differences; 0 if no points are so near to each other.
    """
    moved = query @ T_database_query[:3, :3].T + T_database_query[:3, 3]
    found = cKDTree(database[:, :2]).query(moved[:, :2])
    gap, nearest = np.asarray(found[0]), np.asarray(found[1], np.intp)
    near = gap <= reach
    if not near.any():
        return 0.0
    return float(np.median(database[nearest[near], 2] - moved[near, 2]))


def mutual_matches(
    query: DescribedCloud, database: DescribedCloud, max_distance: float = np.inf
) -> Int[NDArray[np.intp], "m 2"]:
    """Associate keypoints whose descriptors are the nearest of each other.

    Args:
        query: The keypoints of the query.
        database: The keypoints of the database.
        max_distance: Largest L2 distance of two associated descriptors.

    Returns:
        Indices (query, database) of each association (m, 2).
    """
    if len(query.points) == 0 or len(database.points) == 0:
        return np.zeros((0, 2), np.intp)
    a, b = query.descriptors, database.descriptors
    squared = (b * b).sum(axis=1) - 2 * (a @ b.T)
    nearest = squared.argmin(axis=1)
    # The lengths of the query's descriptors matter only for the neighbours of the database.
    squared += (a * a).sum(axis=1)[:, None]
    rows = np.arange(len(a))
    kept = squared.argmin(axis=0)[nearest] == rows
    kept &= squared[rows, nearest] <= max_distance**2
    return np.column_stack([rows, nearest])[kept]


def register_by_ransac(
    query: DescribedCloud,
    database: DescribedCloud,
    params: PipelineParams,
    max_distance: float = np.inf,
) -> Registration:
    """Make mutual associations, find the motion by RANSAC, and score it by its inliers.

    The paper speaks of thresholds on the descriptors' distance without numbers. The default has
    none; what others give is measured by ``poe bench-paper``.
    """
    pairs = mutual_matches(query, database, max_distance)
    found = ransac_se3(
        query.points[pairs[:, 0]],
        database.points[pairs[:, 1]],
        params.registration.radius(None),
        params.registration.seed,
    )
    if found is None:
        return outcome(None, np.zeros(len(pairs), bool))
    motion, inliers = found
    return outcome(seen_from_above(motion, query.middle), inliers)
