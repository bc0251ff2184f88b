"""SHOT with the colours of the points as well as their normals: CSHOT-1344 (Tombari 2011)."""

import cv2
import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.methods.cloud_detector import CloudDetector
from gpgrad_core.methods.described_clouds import DescribedCloud, register_by_ransac
from gpgrad_core.methods.neighbours import neighbours_within
from gpgrad_core.methods.shot import (
    curved_surface,
    local_frames,
    sector_histograms,
    sectors_of,
    shot,
)
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Submap

COLOR_DIFFERENCES = 31
LAB_RANGE = np.array([100.0, 120.0, 120.0])
"""Ranges of L, a and b, by which they are divided, as in the Point Cloud Library."""


def cshot_detector(params: PipelineParams, memo: Memo) -> CloudDetector[DescribedCloud]:
    """Make CSHOT on keypoints of high curvature, with RANSAC, for coloured clouds."""
    return CloudDetector(describe_cshot, register_by_ransac, params, memo)


def describe_cshot(submap: Submap, params: PipelineParams) -> DescribedCloud:
    """Describe a submap's keypoints by CSHOT-1344.

    Raises:
        InputError: If the submap's points have no colours.
    """
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
    """Describe keypoints by how much the colours around them differ from their own.

    This is like `shot`, with the L1 distance of CIELab colours in place of the cosine of the
    normals.

    Args:
        points: Points of the cloud (n, 3) [m]; the keypoints are among them.
        colors: Red, green and blue of the points (n, 3) in [0, 1].
        keypoints: The keypoints (k, 3) [m].
        radius: Radius of the support [m].

    Returns:
        Descriptors of unit length (k, 992).
    """
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
