"""By which rules pairs count as the same place, and their motions as right."""

from dataclasses import dataclass
from itertools import pairwise
from math import radians
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from typing_extensions import Doc

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.overlap import CELL, TruePairs
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, read_only

MAX_OFFSET, MAX_TURN = 0.5, 5.0
"""A motion is right within this distance [m] and this angle [degrees], unless others are given."""


@dataclass(frozen=True)
class EvaluationParams:
    """Parameters of the evaluation."""

    min_overlap: Annotated[
        float,
        Bounds(0.0, 0.99, 0.05, "", slider=(0.0, 0.9)),
        Doc("A pair is true if its boxes' intersection over union (Eq. 8) is above this."),
    ] = 0.3
    min_surface_overlap: Annotated[
        float,
        Bounds(0.0, 0.99, 0.05, "", slider=(0.0, 0.9)),
        Doc("By the second rule, a pair is true if its surfaces share more than this."),
    ] = 0.2
    neighbours: Annotated[
        int,
        Bounds(0, 100_000, 1, "", slider=(0, 10)),
        Doc("Pairs whose numbers differ by at most this are left out. 0 keeps all."),
    ] = 1
    count_grey: Annotated[
        bool,
        Doc("Pairs that touch without being true count as false, instead of being left out."),
    ] = False
    max_offset_error: Annotated[
        float,
        Bounds(0.01, 1000.0, 0.05, "m", slider=(0.05, 2.0)),
        Doc(
            "Largest distance of the query's middle from its true position at which a motion is "
            "right."
        ),
    ] = MAX_OFFSET
    max_turn_error: Annotated[
        float,
        Bounds(0.1, 180.0, 0.5, "deg", slider=(0.5, 30.0)),
        Doc("Largest angle to the true heading at which a motion is right."),
    ] = MAX_TURN
    num_resamples: Annotated[
        int,
        Bounds(0, 100_000, 100, ""),
        Doc("Number of resamples of the submaps for the 95 % intervals. 0 makes no intervals."),
    ] = 1000

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def rules(self) -> tuple["Rule", "Rule"]:
        """The paper's rule on boxes, and the second rule on surfaces."""
        return (
            Rule("box", self.min_overlap, self.neighbours, self.count_grey),
            Rule("surface", self.min_surface_overlap, self.neighbours, self.count_grey),
        )


@dataclass(frozen=True, eq=False)
class Labels:
    """The label that a rule gives every pair."""

    positive: Bool[Mask, "p"]  # pairs that are true and judged (p,)
    judged: Bool[Mask, "p"]  # pairs that are neither neighbours nor grey (p,)
    grey: Bool[Mask, "p"]  # pairs that touch without being true, and are left out (p,)

    def __post_init__(self) -> None:
        read_only(self.positive, self.judged, self.grey)

    @property
    def negative(self) -> Bool[Mask, "p"]:
        """Pairs that are false and judged (p,)."""
        return self.judged & ~self.positive


@dataclass(frozen=True)
class Rule:
    """When a pair of submaps counts as the same place."""

    # ``box`` is the paper's Eq. (8). Boxes may overlap although the submaps hardly share ground, so
    # ``surface`` is the share of the smaller submap's cells that are common.
    measure: Literal["box", "surface"]
    threshold: float  # a pair is true if the measure is above this
    neighbours: int = 1  # pairs whose numbers differ by at most this are left out
    count_grey: bool = False  # whether pairs that touch without being true count as false

    @property
    def name(self) -> str:
        what = "box IoU" if self.measure == "box" else "surface overlap"
        return f"{what} > {self.threshold:g}"

    @property
    def statement(self) -> str:
        if self.measure == "box":
            true = f"the boxes' intersection over union (Eq. 8) is above {self.threshold:g}"
        else:
            true = (
                f"the submaps share more than {self.threshold:g} of the {100 * CELL:g} cm cells of "
                "the smaller one"
            )
        if self.count_grey:
            false = "every other pair is false"
        else:
            false = "false if the boxes do not touch; pairs between are grey and left out"
        band = (
            f"pairs with |i - j| <= {self.neighbours} are left out"
            if self.neighbours
            else "neighbours are counted too"
        )
        return f"A pair is true if {true}; {false}; {band}."

    def measured(self, pairs: TruePairs) -> Float[Array, "p"]:
        """Return the overlap of each pair that the rule uses (p,)."""
        return pairs.box_iou if self.measure == "box" else pairs.surface_overlap

    def label(self, pairs: TruePairs) -> Labels:
        far = pairs.steps > self.neighbours
        true = self.measured(pairs) > self.threshold
        between = ~true & (pairs.box_iou > 0)
        if self.count_grey:
            return Labels(true & far, far, np.zeros_like(far))
        return Labels(true & far, far & ~between, far & between)


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

    The offset is that of the query's centre [m], by default its origin, and the turn that of its
    heading [rad]. A motion is right within the largest of both.
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
    place = np.maximum(np.searchsorted(edges, values), 1)

    def count(mask: Bool[Mask, "p"]) -> list[int]:
        return np.bincount(place[mask], minlength=len(edges) + 1)[1 : len(edges)].tolist()

    right = chosen & errors.near
    counts = map(count, (chosen, chosen & accepted, right, right & accepted))
    return tuple(Bin(*ends, *some) for ends, *some in zip(pairwise(edges), *counts, strict=True))
