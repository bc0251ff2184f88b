"""What the rivals share: described clouds, associations, RANSAC in space; and a random score."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import log
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from gpgrad_core.arrays import Array, Indices, Mask, NDArray, Singles
from gpgrad_core.detection import PipelineParams, StagedDetector
from gpgrad_core.libraries import load_library
from gpgrad_core.run import Progress, silent
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration, Submap

D = TypeVar("D")

LEAST_INLIERS = 8
"""Smallest number of inliers of a rival's loop closure."""


@dataclass(frozen=True, eq=False)
class CloudDetector(StagedDetector[Submap, D]):
    """A detector made of two functions of a module, so that it can be pickled."""

    # makes everything that the comparison needs of a submap: a frozen dataclass
    describe: Callable[[Submap, PipelineParams], D]
    # registers its first argument, the query, to its second
    register: Callable[[D, D, PipelineParams], Registration]
    params: PipelineParams  # the parameters that both functions get
    memo: Memo  # keeps the descriptions; it is empty at first in another process

    def extract(self, inferred: Submap, progress: Progress = silent) -> D:
        described = self.memo(self.describe, inferred, self.params)
        progress(1.0)
        return described

    def compare(self, query: D, database: D) -> Registration:
        return self.register(query, database, self.params)


def whole_submap(submap: Submap, params: PipelineParams) -> Submap:  # noqa: ARG001 - as others
    """Describe a submap by itself, for a comparison that needs its points."""
    return submap


def unchecked(
    motion: SE2 | None, inliers: Bool[Mask, "m"], score: float | None = None
) -> Registration:
    """Make a registration without a dense check; a score of None is the inliers' number."""
    value = float(np.sum(inliers)) if score is None else float(score)
    return Registration(motion, inliers, np.inf, 0.0, 0.0, value)


def judged_by_inliers(params: PipelineParams) -> PipelineParams:
    """Let the number of inliers decide, because another method's score has another scale."""
    num = max(params.closure.min_inliers, LEAST_INLIERS)
    return replace(params, closure=replace(params.closure, min_inliers=num, min_score=0.0))


def planar_motion(T_database_query: Float[Array, "4 4"], query_points: Float[Array, "n 3"]) -> SE2:
    """Reduce a motion between gravity-aligned frames to the plane, by the closest yaw."""
    rotation, translation = T_database_query[:3, :3], T_database_query[:3, 3]
    yaw = float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))
    middle = query_points.mean(axis=0)
    there = (rotation @ middle + translation)[:2]
    turned = SE2(0.0, 0.0, yaw).apply(middle[None, :2])[0]
    return SE2(float(there[0] - turned[0]), float(there[1] - turned[1]), yaw)


def guess(query: Submap, database: Submap, params: PipelineParams) -> Registration:
    """Guess a score; the same pair and seed give the same one."""
    pair = [int(submap.fingerprint, 16) % 2**63 for submap in (query, database)]
    rng = np.random.default_rng([*pair, params.registration.seed])
    yaw = float(rng.uniform(-np.pi, np.pi))
    return unchecked(SE2(0.0, 0.0, yaw), np.zeros(0, bool), float(rng.uniform()))


CONFIDENCE = 0.99
"""RANSAC stops when it has drawn a sample without outliers with this probability (the paper's)."""
MAX_TRIALS = 50_000
BATCH = 5_000
SIMILAR_EDGES = 0.9
"""Least share that the shorter of two sides of similar triangles has of the longer one."""


@dataclass(frozen=True, eq=False)
class DescribedCloud:
    """Keypoints of a cloud with their descriptors."""

    points: Float[Array, "k 3"]  # the keypoints (k, 3) [m]
    descriptors: Float[Singles, "k d"]  # their descriptors (k, d)
    middle: Float[Array, "1 3"]  # mean of the whole cloud (1, 3) [m]


def open3d_cloud(points: Float[Array, "n 3"], **beside: Float[Array, "n 3"] | None) -> Any:
    """Make a cloud of Open3D, which may have ``normals`` or ``colors``."""
    o3d = load_library("open3d")
    # Open3D refuses arrays that are read-only.
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points)))
    for name, values in beside.items():
        if values is not None:
            setattr(cloud, name, o3d.utility.Vector3dVector(np.array(values)))
    return cloud


def thinned(submap: Submap, voxel: float, normal_radius: float) -> Any:
    """Thin a cloud to one mean per voxel [m], with upward normals fitted within a radius [m]."""
    o3d = load_library("open3d")
    cloud = open3d_cloud(submap.points, colors=submap.colors).voxel_down_sample(voxel)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=normal_radius, max_nn=30))
    cloud.orient_normals_to_align_with_direction(np.array([0.0, 0.0, 1.0]))
    return cloud


def height_between(
    query: Float[Array, "k 3"],
    database: Float[Array, "n 3"],
    T_database_query: Float[Array, "4 4"],
    reach: float,
) -> float:
    """Find how much higher the database's ground lies than the query's after a motion [m]."""
    moved = query @ T_database_query[:3, :3].T + T_database_query[:3, 3]
    gap, nearest = map(np.asarray, cKDTree(database[:, :2]).query(moved[:, :2]))
    near = gap <= reach
    if not near.any():
        return 0.0
    return float(np.median(database[nearest[near], 2] - moved[near, 2]))


def mutual_matches(
    query: DescribedCloud, database: DescribedCloud, max_distance: float = np.inf
) -> Int[Indices, "m 2"]:
    """Associate keypoints that are the nearest of each other, at most a distance (L2) apart."""
    if len(query.points) == 0 or len(database.points) == 0:
        return np.zeros((0, 2), np.intp)
    a, b = query.descriptors, database.descriptors
    squared = (b * b).sum(axis=1) - 2 * (a @ b.T)
    nearest = squared.argmin(axis=1)
    # The lengths of the query's descriptors matter only for the neighbours of the database.
    squared += (a * a).sum(axis=1)[:, None]
    rows = np.arange(len(a))
    accepted = squared.argmin(axis=0)[nearest] == rows
    accepted &= squared[rows, nearest] <= max_distance**2
    return np.column_stack([rows, nearest])[accepted]


def register_by_ransac(
    query: DescribedCloud,
    database: DescribedCloud,
    params: PipelineParams,
    max_distance: float = np.inf,
) -> Registration:
    """Make mutual associations, find the motion by RANSAC, and score it by its inliers."""
    pairs = mutual_matches(query, database, max_distance)
    consensus = ransac_se3(
        query.points[pairs[:, 0]],
        database.points[pairs[:, 1]],
        params.registration.radius(None),
        params.registration.seed,
    )
    if consensus is None:
        return unchecked(None, np.zeros(len(pairs), bool))
    motion, inliers = consensus
    return unchecked(planar_motion(motion, query.middle), inliers)


def ransac_se3(
    query: Float[Array, "m 3"], database: Float[Array, "m 3"], radius: float, seed: int
) -> tuple[Float[Array, "4 4"], Bool[Mask, "m"]] | None:
    """Find the motion (4, 4) with the most inliers within the radius [m]; None without three."""
    num = len(query)
    if num < 3:
        return None
    rng = np.random.default_rng(seed)
    best, most = None, 2
    needed, tried = float(MAX_TRIALS), 0
    while tried < needed:
        tried += BATCH
        triples = _similar_triples(rng.integers(num, size=(BATCH, 3)), query, database)
        if len(triples) == 0:
            continue
        motions = fit_rigid(query[triples], database[triples])
        counts = np.count_nonzero(_errors(motions, query, database) <= radius**2, axis=1)
        k = int(np.argmax(counts))
        if counts[k] > most:
            best, most = motions[k], int(counts[k])
            good_sample = (most / num) ** 3
            needed = min(MAX_TRIALS, log(1 - CONFIDENCE) / log(max(1 - good_sample, 1e-12)))
    return None if best is None else _refitted(best, query, database, radius)


def _similar_triples(
    triples: NDArray[np.int64], query: Float[Array, "m 3"], database: Float[Array, "m 3"]
) -> NDArray[np.int64]:
    similar = np.ones(len(triples), bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        first, second = triples[:, a], triples[:, b]
        in_query = np.linalg.norm(query[first] - query[second], axis=1)
        in_database = np.linalg.norm(database[first] - database[second], axis=1)
        shorter, longer = np.minimum(in_query, in_database), np.maximum(in_query, in_database)
        similar &= (shorter >= SIMILAR_EDGES * longer) & (shorter > 0)
    return triples[similar]


def fit_rigid(
    query: Float[Array, "t k 3"], database: Float[Array, "t k 3"]
) -> Float[Array, "t 4 4"]:
    """Fit t rigid motions to k associations [m] each by least squares (SVD, Arun 1987)."""
    middle_query, middle_database = query.mean(axis=1), database.mean(axis=1)
    covariance = np.einsum(
        "tki,tkj->tij", query - middle_query[:, None], database - middle_database[:, None]
    )
    u, _, vt = np.linalg.svd(covariance)
    v, ut = vt.transpose(0, 2, 1).copy(), u.transpose(0, 2, 1)
    v[:, :, 2] *= np.sign(np.linalg.det(v @ ut))[:, None]  # a rotation, not a reflection
    motions = np.broadcast_to(np.eye(4), (len(query), 4, 4)).copy()
    motions[:, :3, :3] = v @ ut
    motions[:, :3, 3] = middle_database - np.einsum("tij,tj->ti", v @ ut, middle_query)
    return motions


def _errors(
    motions: Float[Array, "t 4 4"], query: Float[Array, "m 3"], database: Float[Array, "m 3"]
) -> Float[Array, "t m"]:
    moved = np.einsum("tij,mj->tmi", motions[:, :3, :3], query) + motions[:, None, :3, 3]
    return np.sum((moved - database) ** 2, axis=2)


def _refitted(
    motion: Float[Array, "4 4"],
    query: Float[Array, "m 3"],
    database: Float[Array, "m 3"],
    radius: float,
) -> tuple[Float[Array, "4 4"], Bool[Mask, "m"]] | None:
    inliers = np.zeros(len(query), bool)
    for _ in range(3):
        inliers = _errors(motion[None], query, database)[0] <= radius**2
        if np.sum(inliers) < 3:
            return None
        motion = fit_rigid(query[inliers][None], database[inliers][None])[0]
    return motion, inliers
