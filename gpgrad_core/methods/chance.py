"""Chance: a random score, like the paper's random classifier."""

from dataclasses import dataclass

import numpy as np

from gpgrad_core.methods.cloud_detector import CloudDetector
from gpgrad_core.methods.outcome import outcome
from gpgrad_core.pipeline import PipelineParams
from gpgrad_core.run.memo import Memo
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Registration, Submap


@dataclass(frozen=True, eq=False)
class Name:
    """A number that stands for a submap.

    Attributes:
        seed: The number, from the submap's fingerprint.
    """

    seed: int


def chance_detector(params: PipelineParams, memo: Memo) -> CloudDetector[Name]:
    """Make a detector that guesses; the same pair and seed give the same guess."""
    return CloudDetector(_name, _guess, params, memo)


def _name(submap: Submap, params: PipelineParams) -> Name:  # noqa: ARG001 - as all rivals
    return Name(int(submap.fingerprint, 16) % 2**63)


def _guess(query: Name, database: Name, params: PipelineParams) -> Registration:
    rng = np.random.default_rng([query.seed, database.seed, params.registration.seed])
    yaw = float(rng.uniform(-np.pi, np.pi))
    return outcome(SE2(0.0, 0.0, yaw), np.zeros(0, bool), float(rng.uniform()))
