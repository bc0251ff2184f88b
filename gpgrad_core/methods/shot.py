"""SHOT-352 of the normals around keypoints (Tombari 2010), and CSHOT-1344 of colours too (2011)."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

from gpgrad_core.arrays import Array, Indices, NDArray
from gpgrad_core.detection import PipelineParams
from gpgrad_core.errors import InputError
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.rivals import DescribedCloud, thinned
from gpgrad_core.types import Submap

VOXEL = 0.4
NORMAL_RADIUS = 1.2
CURVATURE_RADIUS = 0.9
KEYPOINT_SPACING = 0.45
SUPPORT_RADIUS = 5.0
"""All in length-scales: 12, 36, 27, 14 and 150 cm with the default length-scale of 0.3 m."""
MAX_KEYPOINTS = 600

AZIMUTHS, ELEVATIONS, SHELLS = 8, 2, 2
COSINES = 11
SECTORS = AZIMUTHS * ELEVATIONS * SHELLS
MIN_NEIGHBOURS = 5
"""A keypoint with fewer has no descriptor, as in the Point Cloud Library."""
COLOR_DIFFERENCES = 31
LAB_RANGE = np.array([100.0, 120.0, 120.0])
"""Ranges of L, a and b, by which they are divided, as in the Point Cloud Library."""


@dataclass(frozen=True, eq=False)
class CurvedSurface:
    """A thinned cloud and its keypoints."""

    points: Float[Array, "n 3"]  # points (n, 3) [m]
    normals: Float[Array, "n 3"]  # unit normals of the points (n, 3)
    # red, green and blue of the points (n, 3) in [0, 1]; None if the cloud has none
    colors: Float[Array, "n 3"] | None
    keypoints: Float[Array, "k 3"]  # keypoints (k, 3) [m]
    radius: float  # radius of the descriptors' support [m]


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Pairs (query, neighbour), sorted by query and then by the neighbour's index."""

    query: Int[NDArray[np.int64], "p"]  # index of the query of each pair (p,)
    index: Int[NDArray[np.int64], "p"]  # index of the neighbour of each pair (p,)
    counts: Int[NDArray[np.int64], "q"]  # number of neighbours of each query (q,)

    def sum_up(self, values: Float[Array, "p c"]) -> Float[Array, "q c"]:
        """Sum values of the pairs (p, c) for each query (q, c)."""
        columns = [
            np.bincount(self.query, column, len(self.counts)).astype(np.float64)
            for column in values.T
        ]
        return np.column_stack(columns)


def describe_shot(submap: Submap, params: PipelineParams) -> DescribedCloud:
    """Describe a submap's keypoints with SHOT-352."""
    surface = curved_surface(submap, params)
    described = shot(surface.points, surface.normals, surface.keypoints, surface.radius)
    middle = submap.points.mean(axis=0, keepdims=True)
    return DescribedCloud(surface.keypoints, described.astype(np.float32), middle)


def curved_surface(submap: Submap, params: PipelineParams) -> CurvedSurface:
    """Thin a submap and choose its keypoints."""
    scale = params.map.terrain.length_scale
    cloud = thinned(submap, VOXEL * scale, NORMAL_RADIUS * scale)
    points = np.array(cloud.points, dtype=np.float64)
    chosen = curved_keypoints(
        points, CURVATURE_RADIUS * scale, KEYPOINT_SPACING * scale, MAX_KEYPOINTS
    )
    return CurvedSurface(
        points,
        np.array(cloud.normals, dtype=np.float64),
        np.array(cloud.colors, dtype=np.float64) if cloud.has_colors() else None,
        points[chosen],
        SUPPORT_RADIUS * scale,
    )


def shot(
    points: Float[Array, "n 3"],
    normals: Float[Array, "n 3"],
    keypoints: Float[Array, "k 3"],
    radius: float,
) -> Float[Array, "k 352"]:
    """Describe keypoints [m] by the positions and normals of their neighbours, as unit vectors."""
    near = neighbours_within(points, keypoints, radius)
    frames = local_frames(points, keypoints, near, radius)
    cosine = np.einsum("pi,pi->p", normals[near.index], frames[near.query, 2])
    sectors = sectors_of(points, keypoints, near, frames, radius)
    return sector_histograms(near, sectors, (np.clip(cosine, -1, 1) + 1) / 2 * COSINES, COSINES)


def local_frames(
    points: Float[Array, "n 3"], keypoints: Float[Array, "k 3"], near: Neighbours, radius: float
) -> Float[Array, "k 3 3"]:
    """Find the local frame of each keypoint; its rows are x, y and z."""
    offsets = points[near.index] - keypoints[near.query]
    weights = radius - np.linalg.norm(offsets, axis=1)
    products = weights[:, None, None] * offsets[:, :, None] * offsets[:, None, :]
    total = np.maximum(near.sum_up(weights[:, None]), 1e-12)
    covariance = (near.sum_up(products.reshape(-1, 9)) / total).reshape(-1, 3, 3)
    _, vectors = np.linalg.eigh(covariance)
    z, x = (_to_the_many(vectors[:, :, k], offsets, near) for k in (0, 2))
    return np.stack([x, np.cross(z, x), z], axis=1)


def _to_the_many(
    axis: Float[Array, "k 3"], offsets: Float[Array, "p 3"], near: Neighbours
) -> Float[Array, "k 3"]:
    side = np.sign(np.einsum("pi,pi->p", offsets, axis[near.query]))
    return np.where(near.sum_up(side[:, None]) >= 0, axis, -axis)


def sectors_of(
    points: Float[Array, "n 3"],
    keypoints: Float[Array, "k 3"],
    near: Neighbours,
    frames: Float[Array, "k 3 3"],
    radius: float,
) -> Float[Array, "p 3"]:
    """Compute the sector of each neighbour: (azimuth, elevation, shell) [bins]."""
    offsets = points[near.index] - keypoints[near.query]
    x, y, z = np.einsum("pij,pj->ip", frames[near.query], offsets)
    distance = np.maximum(np.linalg.norm(offsets, axis=1), 1e-12)
    azimuth = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * AZIMUTHS
    elevation = (np.arcsin(np.clip(z / distance, -1, 1)) / np.pi + 0.5) * ELEVATIONS
    return np.column_stack([azimuth, elevation, distance / radius * SHELLS])


def sector_histograms(
    near: Neighbours, sectors: Float[Array, "p 3"], values: Float[Array, "p"], num_values: int
) -> Float[Array, "k d"]:
    """Count neighbours by sector and value; each is shared among the 16 nearest bins."""
    counted = near.counts[near.query] >= MIN_NEIGHBOURS
    coordinates = np.column_stack([sectors, values])[counted]
    sizes = np.array([AZIMUTHS, ELEVATIONS, SHELLS, num_values])
    low = np.floor(coordinates - 0.5).astype(np.int64)
    share = coordinates - 0.5 - low
    query = near.query[counted]
    length = SECTORS * num_values
    histograms = np.zeros(len(near.counts) * length)
    for corner in np.ndindex(2, 2, 2, 2):
        step = np.array(corner)
        weight = np.where(step, share, 1 - share).prod(axis=1)
        bins = low + step
        bins[:, 0] %= AZIMUTHS  # azimuths wrap around; the others end at their last bin
        bins = np.clip(bins, 0, sizes - 1)
        at = np.ravel_multi_index(tuple(bins.T), tuple(sizes))
        histograms += np.bincount(query * length + at, weight, len(histograms))
    histograms = histograms.reshape(-1, length)
    norms = np.linalg.norm(histograms, axis=1, keepdims=True)
    return histograms / np.maximum(norms, 1e-12)


def describe_cshot(submap: Submap, params: PipelineParams) -> DescribedCloud:
    """Describe a submap's keypoints by CSHOT-1344; InputError if its points have no colours."""
    surface = curved_surface(submap, params)
    if surface.colors is None:
        raise InputError(
            f"{submap.id}: cshot needs the colours of the points, and this cloud has none; "
            "use shot, or clouds with red, green and blue"
        )
    points, keypoints, radius = surface.points, surface.keypoints, surface.radius
    shape = shot(points, surface.normals, keypoints, radius)
    colors = color_shot(points, surface.colors, keypoints, radius)
    described = np.hstack([shape, colors]) / np.sqrt(2)
    middle = submap.points.mean(axis=0, keepdims=True)
    return DescribedCloud(keypoints, described.astype(np.float32), middle)


def color_shot(
    points: Float[Array, "n 3"],
    colors: Float[Array, "n 3"],
    keypoints: Float[Array, "k 3"],
    radius: float,
) -> Float[Array, "k 992"]:
    """Describe keypoints by how much the colours around them differ from their own."""
    lab = cv2.cvtColor(colors.astype(np.float32)[None], cv2.COLOR_RGB2LAB)[0] / LAB_RANGE
    near = neighbours_within(points, keypoints, radius)
    offsets = np.linalg.norm(points[near.index] - keypoints[near.query], axis=1)
    own = np.full(len(keypoints), -1, dtype=np.int64)
    own[near.query[offsets == 0]] = near.index[offsets == 0]
    difference = np.abs(lab[near.index] - lab[own[near.query]]).sum(axis=1) / 3
    frames = local_frames(points, keypoints, near, radius)
    sectors = sectors_of(points, keypoints, near, frames, radius)
    values = np.clip(difference, 0, 1) * COLOR_DIFFERENCES
    return sector_histograms(near, sectors, values, COLOR_DIFFERENCES)


def surface_variation(points: Float[Array, "n 3"], radius: float) -> Float[Array, "n"]:
    """Measure how far each neighbourhood is from flat, in [0, 1/3] (Pauly 2002)."""
    near = neighbours_within(points, points, radius)
    offsets = points[near.index] - points[near.query]
    sums = near.sum_up(offsets)
    products = near.sum_up((offsets[:, :, None] * offsets[:, None, :]).reshape(-1, 9))
    counts = np.maximum(near.counts, 1)[:, None]
    mean = sums / counts
    covariance = (products / counts).reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    values = np.linalg.eigvalsh(covariance)
    total = np.maximum(values.sum(axis=1), 1e-12)
    return np.where(near.counts >= 5, np.maximum(values[:, 0], 0) / total, 0.0)


def curved_keypoints(
    points: Float[Array, "n 3"], radius: float, spacing: float, most: int
) -> Int[Indices, "k"]:
    """Choose the points of highest curvature, at least `spacing` [m] apart, the highest first."""
    curvature = surface_variation(points, radius)
    near = neighbours_within(points, points, spacing)
    highest = np.zeros(len(points))
    np.maximum.at(highest, near.query, curvature[near.index])
    peaks = np.flatnonzero((curvature >= highest) & (curvature > 0))
    return peaks[np.argsort(-curvature[peaks], kind="stable")[:most]]


def neighbours_within(
    points: Float[Array, "n 3"], queries: Float[Array, "q 3"], radius: float
) -> Neighbours:
    """Find the points [m] within a radius of each query, which may be one of them."""
    core = load_library("open3d").core
    search = core.nns.NearestNeighborSearch(core.Tensor(points))
    search.fixed_radius_index(radius)
    neighbours, _, splits = search.fixed_radius_search(core.Tensor(queries), radius, False)
    index, ends = neighbours.numpy().astype(np.int64), splits.numpy().astype(np.int64)
    counts = np.diff(ends)
    query = np.repeat(np.arange(len(queries)), counts)
    order = np.lexsort([index, query])  # the order of the search may depend on its threads
    return Neighbours(query, index[order], counts)
