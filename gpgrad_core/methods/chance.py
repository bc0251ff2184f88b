"""Chance: a random score, like the paper's random classifier."""

import numpy as np

from gpgrad_core.detection import PipelineParams
from gpgrad_core.methods.rival import CloudDetector, unchecked, undescribed
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration, Submap


def chance_detector(params: PipelineParams, memo: Memo) -> CloudDetector[Submap]:
    """Make a detector that guesses; the same pair and seed give the same guess."""
    return CloudDetector(undescribed, _guess, params, memo)


def _guess(query: Submap, database: Submap, params: PipelineParams) -> Registration:
    pair = [int(submap.fingerprint, 16) % 2**63 for submap in (query, database)]
    rng = np.random.default_rng([*pair, params.registration.seed])
    yaw = float(rng.uniform(-np.pi, np.pi))
    return unchecked(SE2(0.0, 0.0, yaw), np.zeros(0, bool), float(rng.uniform()))
