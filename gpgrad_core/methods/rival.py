"""What the rivals share, and the simplest of them: a random score."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.detection import PipelineParams, StagedDetector
from gpgrad_core.run.memo import Memo
from gpgrad_core.run.progress import Progress, silent
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration, Submap

D = TypeVar("D")

LEAST_INLIERS = 8
"""Smallest number of inliers of a rival's loop closure; parameters can only raise it."""


@dataclass(frozen=True, eq=False)
class CloudDetector(StagedDetector[Submap, D]):
    """A detector made of two functions of a module, so that it can be pickled."""

    # makes everything that the comparison needs of a submap: a frozen dataclass
    describe: Callable[[Submap, PipelineParams], D]
    # registers its first argument, the query, to its second
    register: Callable[[D, D, PipelineParams], Registration]
    params: PipelineParams  # the parameters that both functions get
    memo: Memo  # keeps the descriptions; it is empty at first in another process

    def extract(self, made: Submap, progress: Progress = silent) -> D:
        described = self.memo(self.describe, made, self.params)
        progress(1.0)
        return described

    def compare(self, query: D, database: D) -> Registration:
        return self.register(query, database, self.params)


def whole_submap(submap: Submap, params: PipelineParams) -> Submap:  # noqa: ARG001 - as others
    """Describe a submap by itself, for a comparison that needs its points."""
    return submap


def unchecked(
    motion: SE2 | None, inliers: Bool[NDArray[np.bool_], "m"], score: float | None = None
) -> Registration:
    """Make a registration without a dense check; a score of None is the inliers' number."""
    value = float(np.sum(inliers)) if score is None else float(score)
    return Registration(motion, inliers, np.inf, 0.0, 0.0, value)


def judged_by_inliers(params: PipelineParams) -> PipelineParams:
    """Let the number of inliers decide, because another method's score has another scale."""
    num = max(params.closure.min_inliers, LEAST_INLIERS)
    return replace(params, closure=replace(params.closure, min_inliers=num, min_score=0.0))


def planar_motion(T_database_query: Float[Array, "4 4"], query_points: Float[Array, "n 3"]) -> SE2:
    """Reduce a motion between gravity-aligned frames to the plane, by the closest yaw.

    The offset is that of the query's middle; the origin's would turn a far tilt into a shift.
    """
    rotation, translation = T_database_query[:3, :3], T_database_query[:3, 3]
    yaw = float(np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1]))
    middle = query_points.mean(axis=0)
    there = (rotation @ middle + translation)[:2]
    turned = SE2(0.0, 0.0, yaw).apply(middle[None, :2])[0]
    return SE2(float(there[0] - turned[0]), float(there[1] - turned[1]), yaw)


def chance_detector(params: PipelineParams, memo: Memo) -> CloudDetector[Submap]:
    """Make a detector that guesses; the same pair and seed give the same guess."""
    return CloudDetector(whole_submap, _guess, params, memo)


def _guess(query: Submap, database: Submap, params: PipelineParams) -> Registration:
    pair = [int(submap.fingerprint, 16) % 2**63 for submap in (query, database)]
    rng = np.random.default_rng([*pair, params.registration.seed])
    yaw = float(rng.uniform(-np.pi, np.pi))
    return unchecked(SE2(0.0, 0.0, yaw), np.zeros(0, bool), float(rng.uniform()))
