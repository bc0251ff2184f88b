"""Brings a method's verdicts into the order of the true pairs."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int

from gpgrad_core.arrays import NDArray
from gpgrad_core.detection import DetectionResult
from gpgrad_core.errors import InputError
from gpgrad_core.evaluation.overlap import TruePairs
from gpgrad_core.io.records.closures import ClosureReport
from gpgrad_core.se2 import SE2
from gpgrad_core.types import Array, Dataset, read_only


@dataclass(frozen=True, eq=False)
class Ranking:
    """A method's verdicts on all pairs that can be judged.

    Attributes:
        score: The score by which the method ranks each pair (p,); -inf for a pair that it does
            not list.
        num_inliers: Number of inliers of each pair (p,), the paper's n.
        accepted: Which pairs it accepts as loop closures (p,).
        T_database_query: The motion of each pair; None if there is none.
        seconds: Time of each stage [s], as far as it is known.
        notes: What had to be assumed, one line each.
    """

    score: Float[Array, "p"]
    num_inliers: Int[NDArray[np.intp], "p"]
    accepted: Bool[NDArray[np.bool_], "p"]
    T_database_query: tuple[SE2 | None, ...]
    seconds: dict[str, float] = field(default_factory=dict[str, float])
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for array in (self.score, self.num_inliers, self.accepted):
            read_only(array)


@dataclass(frozen=True)
class _Verdict:
    query: str
    database: str
    score: float
    num_inliers: int
    accepted: bool
    T_database_query: SE2 | None


def rank_pairs(
    detection: DetectionResult | ClosureReport, dataset: Dataset, pairs: TruePairs, name: str
) -> Ranking:
    """Bring a method's verdicts into the order of the true pairs.

    A pair may be listed in either direction; its motion is inverted if need be. A pair that is
    not listed ranks below all that are.

    Args:
        detection: The result of a detector, or the content of any tool's ``closures.json``.
        dataset: The dataset that was searched.
        pairs: Its true pairs.
        name: Name of the method, for error messages.

    Raises:
        InputError: If a pair names a submap that the dataset does not have, pairs a submap with
            itself, is listed twice, or has a score that is not a finite number.
    """
    ids = {submap.id for submap in dataset.submaps}
    score = np.full(len(pairs), -np.inf)
    num_inliers = np.zeros(len(pairs), dtype=np.intp)
    accepted = np.zeros(len(pairs), dtype=np.bool_)
    motions: list[SE2 | None] = [None] * len(pairs)
    listed: set[frozenset[str]] = set()
    for verdict in _verdicts(detection):
        both = frozenset((verdict.query, verdict.database))
        _check(verdict, both, ids, listed, dataset.name, name)
        listed.add(both)
        row = pairs.rows.get(both)
        if row is None:
            continue  # a submap without a true pose, which the notes of the true pairs name
        score[row], num_inliers[row] = verdict.score, verdict.num_inliers
        accepted[row] = verdict.accepted
        motion = verdict.T_database_query
        turned_about = verdict.query != pairs.ids[pairs.query[row]]
        motions[row] = motion.inverse() if motion and turned_about else motion
    unlisted = int(np.sum(np.isneginf(score)))
    notes = (
        (f"{name} lists {len(pairs) - unlisted} of {len(pairs)} pairs: the others rank last",)
        if unlisted
        else ()
    )
    return Ranking(score, num_inliers, accepted, tuple(motions), dict(detection.seconds), notes)


def _check(
    verdict: _Verdict,
    both: frozenset[str],
    ids: set[str],
    listed: set[frozenset[str]],
    dataset: str,
    name: str,
) -> None:
    pair = f"{name}: pair {verdict.query}, {verdict.database}"
    for strange in sorted(both - ids):
        raise InputError(
            f"{pair}: {dataset} has no submap {strange!r}; evaluate it on the dataset that it was "
            "made from"
        )
    if len(both) == 1:
        raise InputError(f"{pair}: a submap cannot close a loop with itself; leave the pair out")
    if both in listed:
        raise InputError(f"{pair}: is listed twice; list every pair once")
    if not np.isfinite(verdict.score):
        raise InputError(f"{pair}: the score must be a finite number, got {verdict.score!r}")


def _verdicts(detection: DetectionResult | ClosureReport) -> Iterator[_Verdict]:
    if isinstance(detection, ClosureReport):
        for pair in detection.pairs:
            motion = pair.T_database_query
            ends = pair.query, pair.database
            yield _Verdict(*ends, pair.score, pair.num_inliers, pair.accepted, motion)
        return
    for closure in detection.closures:
        registration, ends = closure.registration, (closure.query_id, closure.database_id)
        score, num_inliers = registration.score, registration.num_inliers
        motion = registration.T_database_query
        yield _Verdict(*ends, score, num_inliers, closure.accepted, motion)
