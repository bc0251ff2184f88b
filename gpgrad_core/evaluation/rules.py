"""The rules by which pairs count as the same place, or are left out."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Bool, Float
from typing_extensions import Doc

from gpgrad_core.arrays import Mask
from gpgrad_core.evaluation.overlap import CELL, TruePairs
from gpgrad_core.evaluation.pose_error import MAX_OFFSET, MAX_TURN
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.types import Array, read_only


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
        Doc("Largest distance from the true position at which a motion is right."),
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
        """The rule in a few words."""
        what = "box IoU" if self.measure == "box" else "surface overlap"
        return f"{what} > {self.threshold:g}"

    @property
    def statement(self) -> str:
        """The rule in a full sentence."""
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
        """Label every pair as true, false or left out."""
        far = pairs.steps > self.neighbours
        true = self.measured(pairs) > self.threshold
        between = ~true & (pairs.box_iou > 0)
        if self.count_grey:
            return Labels(true & far, far, np.zeros_like(far))
        return Labels(true & far, far & ~between, far & between)
