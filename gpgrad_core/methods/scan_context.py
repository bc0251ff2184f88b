"""Scan Context (Kim 2018): polar images of the largest heights, compared column by column."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, Mask, Singles
from gpgrad_core.detection import PipelineParams
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.rivals import (
    height_between,
    open3d_cloud,
    planar_motion,
    thinned,
    unchecked,
)
from gpgrad_core.types import Registration, Submap

RINGS, SECTORS = 20, 60
"""Numbers of rings and of sectors, as in the paper."""
RING = 1.0
"""Width of a ring [length-scales]; the paper's, for cities, are 4 m wide."""
SHIFT = 2.0
"""Distance from one root to the next [length-scales]."""
SHIFTS = 6
"""Number of roots on either side of the middle, along each axis."""
ROOTS_COMPARED = 40
"""Number of roots that the ring key leaves over."""
VOXEL = 0.5
NORMAL_RADIUS = 2.0
"""Side of a voxel [length-scales] and radius for normals [voxels] of the clouds to align."""
LEAST_SCORE = 0.86
"""Lowest score of a loop closure."""
COARSE, FINE = 4.0, 1.0
"""Largest distances of associated points in the two rounds of the alignment [inlier radii]."""


@dataclass(frozen=True, eq=False)
class ContextCloud:
    """A submap's scan contexts, one for each root, and its thinned cloud."""

    # positions of the roots (r, 2) [m]; the first one is the middle of the submap
    roots: Float[Array, "r 2"]
    # scan context of each root, its columns of length 1 (r, sectors, rings)
    contexts: Float[Singles, "r sectors rings"]
    ring_keys: Float[Singles, "r rings"]  # ring key of each root (r, rings)
    points: Float[Array, "k 3"]  # thinned cloud (k, 3) [m]
    normals: Float[Array, "k 3"]  # its normals (k, 3)


def judged_by_context(params: PipelineParams) -> PipelineParams:
    """Let the similarity of the contexts decide, as in the paper."""
    return replace(params, closure=replace(params.closure, min_score=LEAST_SCORE))


def describe_contexts(submap: Submap, params: PipelineParams) -> ContextCloud:
    """Make the scan contexts of a submap about many roots around the middle of its points."""
    scale = params.map.terrain.length_scale
    middle = submap.points.mean(axis=0)
    steps = SHIFT * scale * np.arange(-SHIFTS, SHIFTS + 1)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    roots = middle[:2] + grid[np.argsort(np.hypot(*grid.T), kind="stable")]
    voxel = VOXEL * scale
    cloud = thinned(submap, voxel, NORMAL_RADIUS * voxel)
    points, normals = np.array(cloud.points), np.array(cloud.normals)
    levelled = points - [0.0, 0.0, middle[2]]
    images = [scan_context(levelled, root, RING * scale) for root in roots]
    lengths = [np.linalg.norm(image, axis=1, keepdims=True) for image in images]
    columns = [
        np.divide(image, length, out=np.zeros_like(image), where=length > 0)
        for image, length in zip(images, lengths, strict=True)
    ]
    return ContextCloud(
        roots,
        np.array(columns, np.float32),
        np.array([ring_key(image) for image in images], np.float32),
        points,
        normals,
    )


def scan_context(
    points: Float[Array, "n 3"], root: Float[Array, "2"], ring: float
) -> Float[Array, "sectors rings"]:
    """Make the scan context (sectors, rings) [m] about a root (2,) [m], with rings this wide [m].

        φ(P_ij) = max z(p) over the points p in ring i and sector j    Kim 2018, Sec. III-A

    An empty bin is 0, as in the paper. Here that is the mean height, because heights above a common
    0 make all columns of open ground alike.
    """
    x, y = (points[:, :2] - root).T
    distance = (np.hypot(x, y) / ring).astype(np.intp)
    inside = distance < RINGS
    angle = np.arctan2(y[inside], x[inside]) / (2 * np.pi) + 0.5
    sector = np.minimum((SECTORS * angle).astype(np.intp), SECTORS - 1)
    image = np.full(SECTORS * RINGS, -np.inf)
    np.maximum.at(image, sector * RINGS + distance[inside], points[inside, 2])
    image[np.isneginf(image)] = 0.0
    return image.reshape(SECTORS, RINGS)


def ring_key(context: Float[Array, "sectors rings"]) -> Float[Array, "rings"]:
    """Describe each ring by its mean height, which does not change as the submap turns."""
    return context.mean(axis=0)


def distances(
    query: Float[Singles, "r sectors rings"], database: Float[Singles, "sectors rings"]
) -> Float[Array, "r sectors"]:
    """Compare scan contexts at every shift of their columns, which have length 1 or 0.

        d(I_q, I_c) = 1 / N_s · Σ_j (1 - c_j(q) · c_j(c) / (|c_j(q)| |c_j(c)|))    Kim 2018, III-B

    It gives the distance (r, k) of each context, whose column j + k is compared with column j.
    """
    alike = query @ database.T  # column of the query, column of the database
    column = np.arange(SECTORS)
    later = (column[:, None] + column) % SECTORS  # (shift, column of the database)
    return 1.0 - alike[:, later, column].mean(axis=2).astype(np.float64)


def register_by_context(
    query: ContextCloud, database: ContextCloud, params: PipelineParams
) -> Registration:
    """Find the root and the shift at which two submaps agree most, and align them from there."""
    gap = np.linalg.norm(query.ring_keys - database.ring_keys[0], axis=1)
    near = np.argsort(gap, kind="stable")[:ROOTS_COMPARED]
    apart = distances(query.contexts[near], database.contexts[0])
    best, shift = np.unravel_index(int(np.argmin(apart)), apart.shape)
    motion = np.eye(4)
    yaw = -2 * np.pi * int(shift) / SECTORS
    c, s = np.cos(yaw), np.sin(yaw)
    motion[:2, :2] = [[c, -s], [s, c]]
    motion[:2, 3] = database.roots[0] - motion[:2, :2] @ query.roots[near[best]]
    motion, inliers = _align(query, database, motion, params.registration.radius(None))
    middle = query.points.mean(axis=0, keepdims=True)
    return unchecked(planar_motion(motion, middle), inliers, 1.0 - float(apart[best, shift]))


def _align(
    query: ContextCloud, database: ContextCloud, motion: Float[Array, "4 4"], radius: float
) -> tuple[Float[Array, "4 4"], Bool[Mask, "k"]]:
    """Align two clouds by ICP; gives the motion, and the points that have a partner."""
    tools = load_library("open3d").pipelines.registration
    source, target = (open3d_cloud(one.points, normals=one.normals) for one in (query, database))
    motion = motion.copy()
    motion[2, 3] = height_between(query.points, database.points, motion, radius)
    to_planes, inliers = tools.TransformationEstimationPointToPlane(), np.zeros(0, bool)
    for reach in (COARSE, FINE):
        aligned = tools.registration_icp(source, target, reach * radius, motion, to_planes)
        motion = np.array(aligned.transformation, dtype=np.float64)
        inliers = np.zeros(len(query.points), bool)
        inliers[np.asarray(aligned.correspondence_set)[:, 0]] = True
    return motion, inliers
