"""Associations between two sets of keypoints: brute force, as the paper's Sec. V."""

from dataclasses import dataclass
from typing import Annotated

from typing_extensions import Doc

from gpgrad_core.bounds import Bounds, check_bounds


@dataclass(frozen=True)
class MatchParams:
    """Which nearest descriptors count as associations."""

    ratio: Annotated[
        float,
        Bounds(0.1, 1.0, 0.01),
        Doc("Keep a match if its distance is at most this share of the second best; 1 keeps all."),
    ] = 1.0
    mutual: Annotated[bool, Doc("Keep a match only if each keypoint is the other's nearest.")] = True

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)
