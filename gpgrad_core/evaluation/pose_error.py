"""How well the pairs that were found are placed on one another."""

from dataclasses import dataclass
from itertools import pairwise
from math import radians

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Mask
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array

MAX_OFFSET, MAX_TURN = 0.5, 5.0
"""A motion is right within this distance [m] and this angle [degrees], unless others are asked."""


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """How far each pair's motion is from the true one; infinite where there is none.

    Attributes:
        offset: Distance to the true place [m].
        turn: Angle to the true heading [rad].
        max_offset: Up to this distance a motion is right [m].
        max_turn: Up to this angle a motion is right [rad].
    """

    offset: Float[Array, "p"]
    turn: Float[Array, "p"]
    max_offset: float = MAX_OFFSET
    max_turn: float = radians(MAX_TURN)

    @property
    def near(self) -> Bool[Mask, "p"]:
        """Which pairs are placed right."""
        return (self.offset <= self.max_offset) & (self.turn <= self.max_turn)


@dataclass(frozen=True)
class PoseErrorSummary:
    """Errors of some pairs; None where there is no pair to tell of."""

    count: int
    median_offset: float | None  # [m]
    high_offset: float | None  # 95th percentile [m]
    median_turn: float | None  # [rad]
    high_turn: float | None  # 95th percentile [rad]
    near: float | None  # share placed right


@dataclass(frozen=True)
class Bin:
    """What became of the pairs whose overlap, or relative yaw, lies in low … high.

    Attributes:
        low: Lower edge.
        high: Upper edge.
        pairs: Number of pairs.
        accepted: How many of them were accepted.
        near: How many are placed right, accepted or not.
        accepted_near: How many are accepted and placed right.
    """

    low: float
    high: float
    pairs: int
    accepted: int
    near: int
    accepted_near: int


def pose_errors(
    found: tuple[SE2 | None, ...],
    true: tuple[SE2, ...],
    max_offset: float = MAX_OFFSET,
    max_turn: float = radians(MAX_TURN),
) -> PoseErrors:
    """Compare motions with the true ones.

    The error is the motion ``T_true⁻¹ T_found`` that is left: its length, which is how far the
    query's origin lies from where it belongs, and its angle.

    Args:
        found: ``T_database_query`` of every pair, None where nothing was estimated.
        true: The same from the true poses.
        max_offset: Up to this distance a motion is right [m].
        max_turn: Up to this angle a motion is right [rad].
    """
    offset, turn = np.full(len(true), np.inf), np.full(len(true), np.inf)
    for k, (motion, truth) in enumerate(zip(found, true, strict=True)):
        if motion is not None:
            left = truth.inverse() @ motion
            offset[k], turn[k] = np.hypot(left.x, left.y), abs(left.yaw)
    return PoseErrors(offset, turn, max_offset, max_turn)


def summarise_errors(errors: PoseErrors, chosen: Bool[Mask, "p"]) -> PoseErrorSummary:
    """Sum up the errors of some pairs; those without a motion count as infinitely far."""
    count = int(np.sum(chosen))
    if count == 0:
        return PoseErrorSummary(0, None, None, None, None, None)
    # A blend with an infinity is not a number: where there are some, take the value above.
    method = "linear" if np.isfinite(errors.offset[chosen]).all() else "higher"
    (median_offset, high_offset), (median_turn, high_turn) = (
        np.quantile(error[chosen], [0.5, 0.95], method=method)
        for error in (errors.offset, errors.turn)
    )
    return PoseErrorSummary(
        count,
        float(median_offset),
        float(high_offset),
        float(median_turn),
        float(high_turn),
        float(np.mean(errors.near[chosen])),
    )


def break_down(
    values: Float[Array, "p"],
    edges: tuple[float, ...],
    chosen: Bool[Mask, "p"],
    accepted: Bool[Mask, "p"],
    errors: PoseErrors,
) -> tuple[Bin, ...]:
    """Count what became of pairs, by a value of theirs.

    Args:
        values: What to sort the pairs by.
        edges: Ends of the bins, ascending; a value on an edge belongs to the bin below it, and
            one on the first edge to the first bin.
        chosen: Which pairs to count.
        accepted: Which are accepted.
        errors: Where they were placed.
    """
    near = errors.near
    bins: list[Bin] = []
    for low, high in pairwise(edges):
        above = values >= low if low == edges[0] else values > low
        inside = chosen & above & (values <= high)
        bins.append(
            Bin(
                low,
                high,
                int(np.sum(inside)),
                int(np.sum(inside & accepted)),
                int(np.sum(inside & near)),
                int(np.sum(inside & accepted & near)),
            )
        )
    return tuple(bins)
