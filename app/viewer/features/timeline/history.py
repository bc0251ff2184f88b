"""What a drive shows at a time: the map, the pairs, and the marks of its moments on the line."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Literal, TypeAlias

from app.viewer.features.world import Past
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import Moment, verdicts_at
from gpgrad_core.slam.graph import at_centres
from gpgrad_core.types import Dataset

MarkKind: TypeAlias = Literal["closure", "correction", "refusal"]

CORRECTED = 0.1
"""From here on a move of an earlier submap counts as a correction of the map [m]."""
MOVES = 0.005
"""Less than this is not shown as a motion [m]; of a drive that goes on, what is no correction."""
LIVE_SECONDS = 0.3
"""How long the map of a drive that goes on moves [s]: the next submap may come soon."""


def past_at(
    dataset: Dataset,
    moments: Sequence[Moment],
    number: int,
    *,
    decided: bool = True,
    moving: bool = False,
    grows: bool = False,
) -> Past:
    """Give what there was at a moment.

    Args:
        dataset: With the submaps of the moments so far, in their order.
        moments: Of the drive, from the first on.
        number: Which of them, from 0.
        decided: Whether the submap's pairs are judged; else it has just come by odometry.
        moving: Whether the map moves there from where it was when the submap had just come.
        grows: Whether later submaps are not known yet.
    """
    moment, so_far = moments[number], moments[: number + 1]
    highest = max((c.registration.score for m in moments for c in m.closures), default=1.0)
    candidates = tuple(replace(closure, accepted=False) for closure in moment.closures)
    poses, predicted, odometry = (
        at_centres(dataset.centres, poses)
        for poses in (moment.poses, predicted_at(moments, number), odometry_at(moments, number))
    )
    least = CORRECTED if grows else MOVES
    covariances = moment.covariances
    verdicts = verdicts_at(so_far if decided else moments[:number]).values()
    loops = tuple(closure for closure in verdicts if closure.accepted)
    judged = frozenset(loop.pair for loop in loops)
    if not decided:
        loops += candidates
    elif moving:  # what was refused is seen for as long as it is news
        loops += tuple(loop for loop in candidates if loop.pair not in judged)
    return Past(
        dataset,
        poses if decided else predicted,
        odometry,
        loops,
        judged.intersection(moment.rejected) if decided else frozenset(),
        covariances,
        highest_score=highest or 1.0,
        moves_from=predicted if decided and moving and _moved(poses, predicted, least) else None,
        seconds=LIVE_SECONDS if grows else Past.seconds,
        goes_on=moving or not decided,
        grows=grows,
        words=f"{moment.submap_id} · {words_at(moments, number) if decided else 'has just come'}",
    )


def predicted_at(moments: Sequence[Moment], number: int) -> dict[str, Pose]:
    """Give the poses before the moment: the map as it was, and the new submap by odometry."""
    moment = moments[number]
    if number == 0:
        return moment.poses
    before = moments[number - 1]
    poses = before.poses
    if moment.starts_traverse:
        poses[moment.submap_id] = moment.odometry
    else:
        motion = before.odometry.inverse() @ moment.odometry
        poses[moment.submap_id] = poses[before.submap_id] @ motion
    return poses


def odometry_at(moments: Sequence[Moment], number: int) -> dict[str, Pose]:
    """Give the poses by odometry alone of all submaps so far."""
    return {moment.submap_id: moment.odometry for moment in moments[: number + 1]}


def loops_of(moments: Sequence[Moment], number: int) -> tuple[str, ...]:
    """Name the earlier submaps that the new one closes a loop with: not the one just before it."""
    moment = moments[number]
    neighbour = moments[number - 1].submap_id if number and not moment.starts_traverse else None
    return tuple(
        closure.database_id for closure in moment.accepted if closure.database_id != neighbour
    )


def marks_of(moments: Sequence[Moment]) -> list[tuple[int, MarkKind]]:
    """List what is marked on the line: the number of the moment, and what happened then.

    A refusal is a closure that others contradict from then on, or that is taken back.
    """
    marks: list[tuple[int, MarkKind]] = []
    left_out = [frozenset(moment.rejected) for moment in moments]
    new = [now - before for before, now in pairwise([frozenset[tuple[str, str]](), *left_out])]
    for number, moment in enumerate(moments):
        if loops_of(moments, number):
            marks.append((number, "closure"))
        if moment.moved >= CORRECTED:
            marks.append((number, "correction"))
        if new[number] or any(not closure.accepted for closure in moment.flipped):
            marks.append((number, "refusal"))
    return marks


def words_at(moments: Sequence[Moment], number: int) -> str:
    """Say in one line what happened at a moment."""
    moment = moments[number]
    closes = loops_of(moments, number)
    words: list[str] = []
    if closes:
        more = f" and {len(closes) - 3} more" if len(closes) > 3 else ""
        words.append(f"closes with {', '.join(closes[:3])}{more}")
    if moment.moved >= CORRECTED:
        words.append(f"moves the map by {moment.moved:.1f} m")
    if moment.flipped:
        words.append(f"turns {len(moment.flipped)} earlier")
    if not words:
        words.append(
            f"compared with {len(moment.closures)} earlier" if number else "the first submap"
        )
    return " · ".join(words)


def _moved(poses: Mapping[str, Pose], before: Mapping[str, Pose], least: float) -> bool:
    return any(
        abs(pose.translation - before[name].translation).max() > least
        for name, pose in poses.items()
    )
