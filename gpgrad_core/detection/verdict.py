"""Accepts or refuses a registration, and gives the reason."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from typing_extensions import Doc

from gpgrad_core.detection.consistency import in_context, score_against
from gpgrad_core.errors import told_apart
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.types import (
    Agreement,
    Context,
    ImageVerdict,
    LoopClosure,
    Refusal,
    RefusalKind,
    Registration,
)

SMALL_OVERLAP = 8.0
"""An overlap of fewer patches of 2π scale² holds too few features to decide [patches]."""
IMPOSSIBLE = 1.5
"""Heights that differ by more than this many times what uncertainty explains contradict the
motion."""
LEAST_LENGTH = 1e-12
"""Least length by which something is divided [m]."""
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
        Doc(
            "Largest standard deviation of a loop closure's position, in any direction, in the "
            "middle of the overlap."
        ),
    ] = 0.2
    others: Annotated[
        Literal["off", "terrain", "odometry"],
        Doc(
            "Whether the other pairs of the dataset change a score. off: each pair is judged "
            "alone. terrain: closures that lead to the same motion raise it; better ones that lead "
            "elsewhere lower it, and so do heights that differ more than is usual. odometry: the "
            "same, and odometry from one submap to the next counts as a closure."
        ),
    ] = "terrain"
    images: Annotated[
        Literal["off", "show", "veto", "require"],
        Doc(
            "What camera images of both submaps do to a loop closure of the terrain: nothing; show "
            "what they say; refuse it if they contradict; refuse it unless they confirm."
        ),
    ] = "off"

    def __post_init__(self) -> None:
        check_bounds(self)

    def too_dissimilar(self, dissimilarity: float, mean: float) -> Refusal | None:
        """Refuse a motion by the paper's h or its mean over the common cells."""
        limit, mean_limit = self.max_dissimilarity, self.max_mean_dissimilarity
        if limit is not None and dissimilarity > limit:
            return Refusal("dissimilar", {"value": dissimilarity, "limit": limit})
        if mean_limit is not None and mean > mean_limit:
            return Refusal("dissimilar cells", {"value": mean, "limit": mean_limit})
        return None


RULES: dict[RefusalKind, str] = {
    "nothing trusted": "cannot judge",
    "no motion": "no motion was found",
    "few inliers": "{count} inliers < {least}",
    "dissimilar": "dissimilarity {value} > {limit}",
    "dissimilar cells": "dissimilarity of a cell {value} > {limit}",
    "uncertain position": "the position is too uncertain",
}
"""The rule that a refusal breaks, with its numbers; of all others it is the least score."""
LOW_SCORE = "score {score} < {min_score}"
WHY: dict[RefusalKind, str] = {
    "nothing trusted": "the variance mask hides all ground of one submap: raise it to see more",
    "no motion": "the maps have too little in common",
    "few inliers": "too few keypoints agree",
    "dissimilar": "the gradients of the two maps differ too much (h)",
    "dissimilar cells": "the gradients of the two maps differ too much (h of a cell)",
    "no common ground": "no ground of both was compared",
    "too little ground": "they share too little ground to compare",
    "heights differ": "the heights do not fit",
    "small overlap": "they share too little ground to tell",
    "smooth ground": "the ground is too smooth to tell: its relief is {relief}, and noise explains "
    "{possible}",
    "chance": "the maps agree, but unrelated ground can agree as well",
    "repeated ground": "this ground repeats: {places:.0f} places fit, and better closures lead "
    "elsewhere",
    "another motion": "better closures lead to another motion",
    "common mistake": "this ground repeats: alone the score is {own_score:.3g}, and in this "
    "dataset wrong motions often have as much",
    "unusual heights": "the heights differ {misfit:.2g} times as much as is usual in this dataset",
    "uncertain position": "the ground lets it slide: the standard deviation of the position is "
    "{value} m (at most {limit} m)",
    "images contradict": "the images contradict the motion",
    "images do not confirm": "the images do not confirm the motion",
}
"""Why a pair is refused, in words that a person reads on a card and in a file alike."""
UNDECIDED: frozenset[RefusalKind] = frozenset(
    (
        "no common ground",
        "too little ground",
        "small overlap",
        "smooth ground",
        "uncertain position",
    )
)
"""Refusals for want of ground that could tell: nothing speaks against the pair."""
LENGTHS = {"relief", "possible"}
"""Numbers that are written as lengths."""


def rule_of(refusal: Refusal) -> str:
    """The broken rule in words, with the numbers that it compares."""
    return _filled(RULES.get(refusal.kind, LOW_SCORE), refusal)


def why_of(refusal: Refusal) -> str:
    """The reason in words, without the figures, which a card shows beside it."""
    why = _filled(WHY[refusal.kind], refusal)
    return f"{why}: {refusal.detail}" if refusal.detail else why


def _filled(text: str, refusal: Refusal) -> str:
    numbers = refusal.numbers
    words = {name: describe_length(numbers[name]) for name in LENGTHS & numbers.keys()}
    if "limit" in numbers:
        form = ".2g" if refusal.kind == "uncertain position" else ".3g"
        limit, value = told_apart(numbers["limit"], numbers["value"], "g", form)
        words |= {"value": value, "limit": limit}
    if "score" in numbers:
        score, least = told_apart(numbers["score"], numbers["min_score"])
        words |= {"score": score, "min_score": least}
    return text.format_map({**numbers, **words})


def classify(
    registration: Registration,
    params: ClosureParams | None = None,
    *,
    query_id: str = "query",
    database_id: str = "database",
    context: Context | None = None,
) -> LoopClosure:
    """Decide whether a registration is a loop closure: the paper's AcceptTransformation.

    Args:
        registration: The registration of the query to the database, as it is for the pair alone.
        params: The thresholds.
        query_id: Name of the query submap.
        database_id: Name of the database submap.
        context: What the other pairs of the dataset say; its score then counts, and its variance
            factor multiplies the covariance.
    """
    params = params or ClosureParams()
    registration = in_context(registration, context)
    refusal = find_refusal(registration, params, context)
    if refusal is None:
        reason = _met(registration, params, context)
    else:
        figures = () if refusal.kind in RULES else figures_in_words(registration)
        reason = "; ".join((f"{rule_of(refusal)}: {why_of(refusal)}", *figures))
    return LoopClosure(
        query_id,
        database_id,
        registration,
        refusal is None,
        reason,
        context=context,
        undecided=refusal is not None and refusal.kind in UNDECIDED,
        refusal=refusal,
    )


def _met(registration: Registration, params: ClosureParams, context: Context | None) -> str:
    num, score = registration.num_inliers, registration.score
    met = [f"{num} inliers >= {params.min_inliers}"] if params.min_inliers > 0 else []
    met += ["score {} >= {}".format(*told_apart(score, params.min_score))] * (params.min_score > 0)
    if context is not None and context.own_score < params.min_score:
        own, _ = told_apart(context.own_score, params.min_score)
        met += [f"{own} alone, and other closures lead to the same motion"]
    return ", ".join(met) or "no threshold is set"


def find_refusal(
    registration: Registration, params: ClosureParams, context: Context | None = None
) -> Refusal | None:
    """Find the first rule that a registration breaks; None accepts it."""
    if registration.T_database_query is None:
        return Refusal("nothing trusted" if registration.nothing_trusted else "no motion")
    num = registration.num_inliers
    if num < params.min_inliers:
        return Refusal("few inliers", {"count": num, "least": params.min_inliers})
    dissimilar = params.too_dissimilar(registration.dissimilarity, registration.mean_dissimilarity)
    if dissimilar is not None:
        return dissimilar
    if registration.score < params.min_score:
        return _explain_score(registration, params.min_score, context)
    std = registration.position_std
    if std is not None and std > params.max_std:
        return Refusal("uncertain position", {"value": std, "limit": params.max_std})
    return None


def with_images(
    closure: LoopClosure, images: ImageVerdict | None, params: ClosureParams
) -> LoopClosure:
    """Add to a verdict of the terrain what camera images say, and refuse a closure if they must."""
    closure = replace(closure, images=images)
    says = "silent" if images is None else images.verdict
    refused = (params.images == "veto" and says == "contradicted") or (
        params.images == "require" and says != "confirmed"
    )
    if not (refused and closure.accepted):
        return closure
    explanation = "there are not images of both submaps" if images is None else images.reason
    kind: RefusalKind = "images contradict" if says == "contradicted" else "images do not confirm"
    refusal = Refusal(kind, detail=explanation)
    return replace(closure, accepted=False, reason=why_of(refusal), refusal=refusal)


def _explain_score(
    registration: Registration, min_score: float, context: Context | None
) -> Refusal:
    agreement, area = registration.agreement, registration.overlap_area
    numbers = {"score": registration.score, "min_score": min_score}
    if agreement is None or registration.scale is None:
        return Refusal("too little ground" if area > 0 else "no common ground", numbers)
    numbers |= {"relief": agreement.relief, "possible": agreement.possible}
    kind: RefusalKind = "chance"
    if context is not None and context.own_score >= min_score:
        numbers |= {"places": context.places, "misfit": context.misfit}
        numbers |= {"own_score": context.own_score}
        by_heights = score_against(context.misfit)
        kind = "unusual heights"
        if context.own_score - context.score > 2 * by_heights:  # others took more than heights did
            kind = "another motion" if context.support < 0 else "common mistake"
            kind = "repeated ground" if context.places > 1 else kind
    elif not heights_fit(agreement):
        kind = "heights differ"
    elif has_small_overlap(registration):
        kind = "small overlap"
    elif agreement.relief < SMOOTH * agreement.possible:
        kind = "smooth ground"
    return Refusal(kind, numbers)


def has_small_overlap(registration: Registration) -> bool:
    """Whether the overlap holds too few features to decide."""
    scale = registration.scale
    return scale is not None and registration.overlap_area < SMALL_OVERLAP * 2 * np.pi * scale**2


def heights_fit(agreement: Agreement) -> bool:
    """Whether noise explains the difference of the heights; if not, it speaks against."""
    return agreement.difference <= IMPOSSIBLE * agreement.possible


def figures_in_words(registration: Registration) -> tuple[str, ...]:
    """What was compared under a motion, a sentence each: heights, keypoints and ground."""
    agreement, area = registration.agreement, registration.overlap_area
    return (
        *(() if agreement is None else (heights_in_words(agreement),)),
        keypoints_in_words(registration.num_inliers),
        *((ground_in_words(area),) if area > 0 else ()),
    )


def heights_in_words(agreement: Agreement) -> str:
    """Describe how far heights differ, how far noise explains it, and whether both agree.

    >>> heights_in_words(Agreement(difference=0.007, possible=0.005, relief=0.2))
    'heights differ by 7 mm; noise explains 5 mm: consistent (1.4 times, limit 1.5)'
    """
    ratio = agreement.difference / max(agreement.possible, LEAST_LENGTH)
    limit, times = told_apart(IMPOSSIBLE, ratio, "g", ",.1f")
    verdict = "consistent" if heights_fit(agreement) else "inconsistent"
    return (
        f"{difference_in_words(agreement)}; noise explains "
        f"{describe_length(agreement.possible)}: {verdict} ({times} times, limit {limit})"
    )


def difference_in_words(agreement: Agreement) -> str:
    """Describe how far heights differ.

    >>> difference_in_words(Agreement(difference=0.007, possible=0.005, relief=0.2))
    'heights differ by 7 mm'
    """
    return f"heights differ by {describe_length(agreement.difference)}"


def keypoints_in_words(count: int) -> str:
    """Describe how many keypoints agree.

    >>> keypoints_in_words(1), keypoints_in_words(17)
    ('1 keypoint agrees', '17 keypoints agree')
    """
    return f"{count:,} keypoint{' agrees' if count == 1 else 's agree'}"


def ground_in_words(area: float) -> str:
    """Describe how much ground is shared [m²].

    >>> ground_in_words(3.14), ground_in_words(1234.5)
    ('they share 3.1 m²', 'they share 1,234 m²')
    """
    return f"they share {f'{area:.2g}' if area < 9.5 else f'{area:,.0f}'} m²"


def describe_length(metres: float) -> str:
    """Write a length [m] in millimetres, centimetres or metres.

    >>> describe_length(0.0072), describe_length(0.045), describe_length(1234.5)
    ('7.2 mm', '4.5 cm', '1,234.5 m')
    """
    if metres >= 0.995:
        return f"{metres:,.1f} m"
    return f"{1e3 * metres:.2g} mm" if metres < 0.01 else f"{100 * metres:.2g} cm"
