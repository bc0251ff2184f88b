"""Accepts or refuses a registration, and gives the reason."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Literal, TypeAlias

import numpy as np
from typing_extensions import Doc

from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds
from gpgrad_core.types import Agreement, ImageVerdict, LoopClosure, Registration

SMALL_OVERLAP = 8.0
"""An overlap of fewer patches of 2π scale² holds too few features to decide [patches]."""
IMPOSSIBLE = 1.5
"""If the heights differ by more than this many times the standard deviation that the uncertainty
explains, they speak against the motion."""
SMOOTH = 4.0
"""Ground whose relief is less than this many times the maps' uncertainty looks alike everywhere."""


@dataclass(frozen=True)
class ClosureParams:
    """The thresholds that a registration must meet to count as a loop closure."""

    min_inliers: Annotated[
        int,
        Bounds(0, 1000, 1, "", slider=(0, 40)),
        Doc(
            "Smallest number of inliers of a loop closure, the paper's threshold on n. The score "
            "counts the inliers too."
        ),
    ] = 0
    min_score: Annotated[
        float,
        Bounds(0.0, 1_000_000.0, 0.1, "", slider=(0.0, 12.0)),
        Doc("Lowest score of a loop closure. One in 1000 unrelated pairs reaches a score of 3."),
    ] = 3.0
    max_dissimilarity: Annotated[
        float | None,
        Bounds(0.0, 1e20, 1e7, "1/m⁴", slider=(1e8, 1e13)),
        Doc(
            "Largest dissimilarity of a loop closure, the paper's threshold on h. Automatic: there "
            "is none."
        ),
    ] = None
    max_mean_dissimilarity: Annotated[
        float | None,
        Bounds(0.0, 1e15, 1e3, "1/m⁴", slider=(1e4, 1e9)),
        Doc(
            "Largest dissimilarity divided by the number of common cells, so that a small overlap "
            "has no advantage. Automatic: there is none."
        ),
    ] = None
    max_std: Annotated[
        float,
        Bounds(0.01, 1000.0, 0.01, "m", slider=(0.05, 2.0)),
        Doc("Largest standard deviation of a loop closure's position, in any direction."),
    ] = 0.5
    images: Annotated[
        Literal["off", "show", "veto", "require"],
        Doc(
            "What camera images of both submaps do to a loop closure of the terrain: nothing; show "
            "what they say; refuse it if they contradict; refuse it unless they confirm."
        ),
    ] = "off"

    def __post_init__(self) -> None:
        """Check the bounds."""
        check_bounds(self)

    def too_dissimilar(self, dissimilarity: float, mean: float) -> "Refusal | None":
        """Refuse a motion by the paper's h, or give None.

        Args:
            dissimilarity: h under the motion.
            mean: The same divided by the number of common cells.
        """
        limit, mean_limit = self.max_dissimilarity, self.max_mean_dissimilarity
        if limit is not None and dissimilarity > limit:
            return Refusal("dissimilar", {"value": dissimilarity, "limit": limit})
        if mean_limit is not None and mean > mean_limit:
            return Refusal("dissimilar cells", {"value": mean, "limit": mean_limit})
        return None


RefusalKind: TypeAlias = Literal[
    "nothing trusted",
    "no motion",
    "few inliers",
    "dissimilar",
    "dissimilar cells",
    "no common ground",
    "too little ground",
    "heights differ",
    "small overlap",
    "smooth ground",
    "chance",
    "uncertain position",
]

LOW_SCORE = "score {score:.3g} < {min_score:g}"
REASONS: dict[RefusalKind, str] = {
    "nothing trusted": "cannot judge: the variance mask trusts no cell of one of the maps",
    "no motion": "no motion was found: the maps have too little in common",
    "few inliers": "{value} inliers < {limit}",
    "dissimilar": "dissimilarity {value:.3g} > {limit:g}",
    "dissimilar cells": "dissimilarity of a cell {value:.3g} > {limit:g}",
    "no common ground": LOW_SCORE,
    "too little ground": LOW_SCORE + ": the maps share only {area:.2g} m² of ground",
    "heights differ": LOW_SCORE + ": over {area:.0f} m² of common ground the heights differ by "
    "{difference}, and their uncertainty explains at most {explained}",
    "small overlap": LOW_SCORE
    + ": the maps share only {area:.2g} m² of ground, too little to decide",
    "smooth ground": LOW_SCORE + ": the ground is too smooth to decide: its relief is {relief}, "
    "and the maps' uncertainty is {possible}",
    "chance": LOW_SCORE + ": over {area:.0f} m² of common ground the heights agree to {difference},"
    " but with {num_inliers} inliers unrelated ground can agree as well",
    "uncertain position": "the position is too uncertain in one direction: its standard deviation "
    "is {value:.2g} m (at most {limit:g} m)",
}
"""The reason of a refusal, with its numbers."""
LENGTHS = ("difference", "explained", "relief", "possible")
"""Numbers that are written as lengths."""


@dataclass(frozen=True)
class Refusal:
    """Why a registration is no loop closure.

    Attributes:
        kind: The rule that it breaks; of a low score, what explains it.
        numbers: What the rule compares, by name.
    """

    kind: RefusalKind
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def reason(self) -> str:
        """The reason in one line, with the numbers."""
        lengths = {
            name: describe_length(number)
            for name, number in self.numbers.items()
            if name in LENGTHS
        }
        return REASONS[self.kind].format_map({**self.numbers, **lengths})


def classify(
    registration: Registration,
    params: ClosureParams | None = None,
    *,
    query_id: str = "query",
    database_id: str = "database",
) -> LoopClosure:
    """Decide whether a registration is a loop closure: the paper's AcceptTransformation.

    Args:
        registration: The registration of the query to the database.
        params: The thresholds.
        query_id: Name of the query submap.
        database_id: Name of the database submap.

    Returns:
        The verdict, with its reason in one line.
    """
    params = params or ClosureParams()
    refusal = find_refusal(registration, params)
    reason = _met(registration, params) if refusal is None else refusal.reason
    return LoopClosure(query_id, database_id, registration, refusal is None, reason)


def _met(registration: Registration, params: ClosureParams) -> str:
    """Name the thresholds that an accepted registration meets."""
    num, score = registration.num_inliers, registration.score
    met = [f"{num} inliers >= {params.min_inliers}"] if params.min_inliers > 0 else []
    met += [f"score {score:.3g} >= {params.min_score:g}"] if params.min_score > 0 else []
    return ", ".join(met) or "no threshold is set"


def find_refusal(registration: Registration, params: ClosureParams) -> Refusal | None:
    """Find the first rule that a registration breaks; None accepts it.

    Args:
        registration: The registration of the query to the database.
        params: The thresholds.
    """
    if registration.T_database_query is None:
        return Refusal("nothing trusted" if registration.nothing_trusted else "no motion")
    num = registration.num_inliers
    if num < params.min_inliers:
        return Refusal("few inliers", {"value": num, "limit": params.min_inliers})
    dissimilar = params.too_dissimilar(registration.dissimilarity, registration.mean_dissimilarity)
    if dissimilar is not None:
        return dissimilar
    if registration.score < params.min_score:
        return _explain_score(registration, params.min_score)
    std = _worst_std(registration)
    if std is not None and std > params.max_std:
        return Refusal("uncertain position", {"value": std, "limit": params.max_std})
    return None


def with_images(
    closure: LoopClosure, images: ImageVerdict | None, params: ClosureParams
) -> LoopClosure:
    """Add to a verdict of the terrain what camera images say, and refuse a closure if they must.

    Args:
        closure: The verdict of the terrain.
        images: What the images say; None if a submap has none, or if they were not asked.
        params: Its ``images`` says what they may do.

    Returns:
        The verdict. Images refuse a closure, but never accept a pair.
    """
    closure = replace(closure, images=images)
    says = "silent" if images is None else images.verdict
    refused = (params.images == "veto" and says == "contradicted") or (
        params.images == "require" and says != "confirmed"
    )
    if not (refused and closure.accepted):
        return closure
    said = "there are not images of both submaps" if images is None else images.reason
    verb = "contradict" if says == "contradicted" else "do not confirm"
    return replace(closure, accepted=False, reason=f"the images {verb} the motion: {said}")


def _worst_std(registration: Registration) -> float | None:
    """Compute the standard deviation of the position in its least certain direction [m]."""
    if registration.covariance is None or not np.isfinite(registration.covariance).all():
        return None
    return float(np.sqrt(max(np.linalg.eigvalsh(registration.covariance[:2, :2])[-1], 0.0)))


def _explain_score(registration: Registration, min_score: float) -> Refusal:
    """Explain a low score by what was compared."""
    agreement, area = registration.agreement, registration.overlap_area
    numbers = {"score": registration.score, "min_score": min_score, "area": area}
    if agreement is None or registration.scale is None:
        return Refusal("too little ground" if area > 0 else "no common ground", numbers)
    numbers |= asdict(agreement) | {
        "explained": explained(agreement),
        "num_inliers": registration.num_inliers,
    }
    kind: RefusalKind = "chance"
    if agreement.difference > explained(agreement):
        kind = "heights differ"
    elif has_small_overlap(registration):
        kind = "small overlap"
    elif agreement.relief < SMOOTH * agreement.possible:
        kind = "smooth ground"
    return Refusal(kind, numbers)


def has_small_overlap(registration: Registration) -> bool:
    """Tell whether the overlap holds too few features to decide."""
    scale = registration.scale
    return scale is not None and registration.overlap_area < SMALL_OVERLAP * 2 * np.pi * scale**2


def explained(agreement: Agreement) -> float:
    """Give the largest difference of the heights [m] that does not speak against the motion."""
    return IMPOSSIBLE * agreement.possible


def describe_length(metres: float) -> str:
    """Write a length [m] in millimetres, centimetres or metres.

    >>> describe_length(0.0072), describe_length(0.045), describe_length(1234.5)
    ('7.2 mm', '4.5 cm', '1,234.5 m')
    """
    if metres >= 0.995:
        return f"{metres:,.1f} m"
    return f"{1e3 * metres:.2g} mm" if metres < 0.01 else f"{100 * metres:.2g} cm"
