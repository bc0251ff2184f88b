"""Accepts or refuses a registration, and gives the reason."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from typing_extensions import Doc

from gpgrad_core.params.bounds import Bounds
from gpgrad_core.params.fields import check_bounds
from gpgrad_core.types import Agreement, ImageVerdict, LoopClosure, Registration


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

    def too_dissimilar(self, dissimilarity: float, mean: float) -> str:
        """Give the reason why a motion is refused by the paper's h, or nothing if it is not.

        Args:
            dissimilarity: h under the motion.
            mean: The same divided by the number of common cells.
        """
        of_whole, of_mean = self.max_dissimilarity, self.max_mean_dissimilarity
        if of_whole is not None and dissimilarity > of_whole:
            return f"dissimilarity {dissimilarity:.3g} > {of_whole:g}"
        if of_mean is not None and mean > of_mean:
            return f"dissimilarity of a cell {mean:.3g} > {of_mean:g}"
        return ""


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
    num, score = registration.num_inliers, registration.score
    std = _worst_std(registration)
    dissimilar = params.too_dissimilar(registration.dissimilarity, registration.mean_dissimilarity)
    accepted, reason = False, ""
    if registration.T_database_query is None:
        reason = "no motion was found: the maps have too little in common"
        if registration.nothing_trusted:
            reason = "cannot judge: the variance mask trusts no cell of one of the maps"
    elif num < params.min_inliers:
        reason = f"{num} inliers < {params.min_inliers}"
    elif dissimilar:
        reason = dissimilar
    elif score < params.min_score:
        reason = f"score {score:.3g} < {params.min_score:g}" + _why(registration)
    elif std is not None and std > params.max_std:
        reason = (
            f"the position is too uncertain in one direction: its standard deviation is {std:.2g} "
            f"m (at most {params.max_std:g} m)"
        )
    else:
        accepted = True
        met = [f"{num} inliers >= {params.min_inliers}"] if params.min_inliers > 0 else []
        met += [f"score {score:.3g} >= {params.min_score:g}"] if params.min_score > 0 else []
        reason = ", ".join(met) or "no threshold is set"
    return LoopClosure(query_id, database_id, registration, accepted, reason)


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


SMALL_OVERLAP = 8.0
"""An overlap of fewer patches of 2π scale² holds too few features to decide [patches]."""
IMPOSSIBLE = 1.5
"""If the heights differ by more than this many times the standard deviation that the uncertainty
explains, they speak against the motion."""
SMOOTH = 4.0
"""Ground whose relief is less than this many times the maps' uncertainty looks alike everywhere."""


def _worst_std(registration: Registration) -> float | None:
    """Compute the standard deviation of the position in its least certain direction [m]."""
    if registration.covariance is None or not np.isfinite(registration.covariance).all():
        return None
    return float(np.sqrt(max(np.linalg.eigvalsh(registration.covariance[:2, :2])[-1], 0.0)))


def _why(registration: Registration) -> str:
    """Explain a low score, if the ground was compared."""
    found, area, scale = registration.agreement, registration.overlap_area, registration.scale
    if found is None or scale is None:
        return f": the maps share only {area:.2g} m² of ground" if area > 0 else ""
    if found.difference > explained(found):
        return (
            f": over {area:.0f} m² of common ground the heights differ by "
            f"{describe_length(found.difference)}, and their uncertainty explains at most "
            f"{describe_length(explained(found))}"
        )
    if area < SMALL_OVERLAP * 2 * np.pi * scale**2:
        return f": the maps share only {area:.2g} m² of ground, too little to decide"
    if found.relief < SMOOTH * found.possible:
        return (
            ": the ground is too smooth to decide: its relief is "
            f"{describe_length(found.relief)}, and the maps' uncertainty is "
            f"{describe_length(found.possible)}"
        )
    return (
        f": over {area:.0f} m² of common ground the heights agree to "
        f"{describe_length(found.difference)}, but with {registration.num_inliers} inliers "
        "unrelated ground can agree as well"
    )


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
