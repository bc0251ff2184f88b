"""KISS-Matcher (Lim 2025): faster point feature histograms and a solver without RANSAC."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.libraries import load_library
from gpgrad_core.methods.cloud_detector import CloudDetector
from gpgrad_core.methods.outcome import outcome, seen_from_above
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.types import Registration, Submap

PACKAGE = "kiss_matcher"
VOXEL = 0.5
"""Side of a voxel [length-scales]: 15 cm with the default length-scale of 0.3 m."""


@dataclass(frozen=True, eq=False)
class KissMatcherCloud:
    """The points of a submap in the form that the package needs.

    Attributes:
        points: Points (n, 3) [m].
        middle: Their mean (1, 3) [m].
    """

    points: Float[NDArray[np.float32], "n 3"]
    middle: Float[NDArray[np.float64], "1 3"]


def kiss_matcher_detector(params: PipelineParams, memo: Memo) -> CloudDetector[KissMatcherCloud]:
    """Make KISS-Matcher; the package must be installed."""
    return CloudDetector(_cloud, _register, params, memo)


def _cloud(submap: Submap, params: PipelineParams) -> KissMatcherCloud:  # noqa: ARG001 - as all rivals
    return KissMatcherCloud(
        submap.points.astype(np.float32), submap.points.mean(axis=0, keepdims=True)
    )


def _register(
    query: KissMatcherCloud, database: KissMatcherCloud, params: PipelineParams
) -> Registration:
    """Associate and solve; the score is the number of the final inliers."""
    package: Any = load_library(PACKAGE, "gpgrad[peers]")
    # Quatro rotates about the vertical only, because both clouds are gravity-aligned.
    config = package.KISSMatcherConfig(VOXEL * params.map.terrain.length_scale, use_quatro=True)
    matcher = package.KISSMatcher(config)
    solution = matcher.estimate(query.points, database.points)
    num_inliers = matcher.get_num_final_inliers()
    inliers = np.arange(len(matcher.get_initial_correspondences())) < num_inliers
    if not solution.valid or num_inliers == 0:
        return outcome(None, inliers)
    motion = np.eye(4)
    motion[:3, :3] = np.asarray(solution.rotation)
    motion[:3, 3] = np.asarray(solution.translation).ravel()
    return outcome(seen_from_above(motion, query.middle), inliers)
