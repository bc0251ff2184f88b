"""Compares the motions of pairs with the true ones."""

from dataclasses import dataclass
from itertools import pairwise
from math import radians

import numpy as np
from jaxtyping import Bool, Float

from gpgrad_core.arrays import Mask
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array

MAX_OFFSET, MAX_TURN = 0.5, 5.0
"""A motion is right within this distance [m] and this angle [degrees], unless others are given."""


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """The error of each pair's motion; infinite if the pair has no motion."""

    offset: Float[Array, "p"]  # distance between the estimated and the true position (p,) [m]
    turn: Float[Array, "p"]  # angle between the estimated and the true heading (p,) [rad]
    max_offset: float = MAX_OFFSET  # largest distance at which a motion is right [m]
    max_turn: float = radians(MAX_TURN)  # largest angle at which a motion is right [rad]

    @property
    def near(self) -> Bool[Mask, "p"]:
        """Which pairs have a right motion (p,)."""
        return (self.offset <= self.max_offset) & (self.turn <= self.max_turn)


@dataclass(frozen=True)
class PoseErrorSummary:
    """Errors of some pairs; all but the count are None if there is no pair."""

    count: int  # number of pairs
    median_offset: float | None  # median of the distances [m]
    high_offset: float | None  # 95th percentile of the distances [m]
    median_turn: float | None  # median of the angles [rad]
    high_turn: float | None  # 95th percentile of the angles [rad]
    near: float | None  # share of the pairs whose motion is right


@dataclass(frozen=True)
class Bin:
    """Counts of the pairs whose overlap, or relative yaw, lies between low and high."""

    low: float  # lower edge
    high: float  # upper edge
    pairs: int  # number of pairs
    accepted: int  # number of accepted pairs
    near: int  # number of pairs whose motion is right, accepted or not
    accepted_near: int  # number of accepted pairs whose motion is right


def pose_errors(
    estimated: tuple[SE2 | None, ...],
    true: tuple[SE2, ...],
    max_offset: float = MAX_OFFSET,
    max_turn: float = radians(MAX_TURN),
    *,
    centres: Float[Array, "p 2"] | None = None,
) -> PoseErrors:
    """Compare motions ``T_database_query`` with the true ones; None if nothing was estimated.

    The offset is the distance of the query's centre from its true position, and the turn is the
    error of the heading. A motion is right within the largest offset [m] and turn [rad]. The
    centres are `Submap.centre` of each query [m], or else the origins.
    """
    at = np.zeros((len(true), 2)) if centres is None else centres
    offset, turn = np.full(len(true), np.inf), np.full(len(true), np.inf)
    for k, (motion, truth) in enumerate(zip(estimated, true, strict=True)):
        if motion is not None:
            away = motion.apply(at[k][None]) - truth.apply(at[k][None])
            offset[k] = np.linalg.norm(away)
            turn[k] = abs((truth.inverse() @ motion).yaw)
    return PoseErrors(offset, turn, max_offset, max_turn)


@dataclass(frozen=True, eq=False)
class MotionClasses:
    """What a pair would do to a pose graph if it were accepted; each pair is in one class."""

    right: Bool[Mask, "p"]  # which pairs have surfaces that touch, and the right motion (p,)
    wrong_motion: Bool[Mask, "p"]  # which pairs have surfaces that touch, but a wrong motion (p,)
    no_overlap: Bool[Mask, "p"]  # which pairs have surfaces that do not touch (p,)


def classify_motions(errors: PoseErrors, surface_overlap: Float[Array, "p"]) -> MotionClasses:
    """Sort pairs by their motion and their true overlap of the surfaces, from 0 to 1."""
    touching = surface_overlap > 0
    return MotionClasses(touching & errors.near, touching & ~errors.near, ~touching)


def summarise_errors(errors: PoseErrors, chosen: Bool[Mask, "p"]) -> PoseErrorSummary:
    """Summarise the errors of the chosen pairs; a pair without a motion has an infinite error."""
    count = int(np.sum(chosen))
    if count == 0:
        return PoseErrorSummary(0, None, None, None, None, None)
    # Interpolation with an infinite error gives NaN, so take the value above if there is one.
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
    """Count pairs in bins of a value; an edge belongs to the bin below, the first to the first."""
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
