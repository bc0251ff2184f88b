"""What there is of the world: all of a drive, or what there was of it at one of its moments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, TypeAlias

from jaxtyping import Float

from app.viewer.features.world.submaps import (
    PoseSource,
    Terrain,
    WorldOptions,
    pose_sources,
    poses_of,
)
from app.viewer.session.decisions import count_kinds
from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import Pose
from gpgrad_core.slam import Moment, OptimisedGraph, trajectory_error, verdicts_at
from gpgrad_core.slam.graph import at_centres, judged_poses, shifted
from gpgrad_core.slam.optimise import interpolated_rows, pose_rows
from gpgrad_core.slam.optimise import poses_of as poses_of_rows
from gpgrad_core.types import Dataset, LoopClosure, PairOfIds

MarkKind: TypeAlias = Literal["closure", "correction", "refusal"]
Poses: TypeAlias = Mapping[str, Pose]

CORRECTED = 0.1
"""From here on a move of an earlier submap counts as a correction of the map [m]."""
MOVES = 0.005
"""Less than this is not shown as a motion [m]; of a drive that goes on, what is no correction."""


@dataclass(frozen=True, eq=False)
class Correction:
    """What the pose graph says of the world; its poses are those of the submaps' centres."""

    graph: OptimisedGraph | None = None  # none before the first one
    # of x [m], y [m] and yaw [rad] of each of its poses, in their order
    covariances: Float[Array, "n 3 3"] | None = None
    loops: tuple[LoopClosure, ...] = ()  # accepted and refused
    wrong: frozenset[PairOfIds] = frozenset()  # of them, those that the others contradict
    highest_score: float = 1.0  # of the last colour of the loops
    marked: PairOfIds | None = None  # whose loop stands out

    @property
    def corrected(self) -> Poses | None:
        return None if self.graph is None else self.graph.poses


@dataclass(frozen=True, eq=False)
class Past:
    """What there was of the world at a moment of a drive; poses are those of centres."""

    dataset: Dataset  # with the submaps of the moments, and perhaps later ones
    moments: Sequence[Moment]  # of the drive, from the first on
    number: int  # of the moment among them
    decided: bool = True  # whether its pairs are judged; else the submap has just come by odometry
    moving: bool = False  # whether the map moves there from where it was then
    grows: bool = False  # whether later submaps are still to come, so that the cameras follow

    @property
    def moment(self) -> Moment:
        return self.moments[self.number]

    @property
    def goes_on(self) -> bool:
        """Whether the next moment follows soon, so that nothing is inferred meanwhile."""
        return self.moving or not self.decided

    @property
    def words(self) -> str:
        happened = words_of(self.moment) if self.decided else "has just come"
        return f"{self.moment.submap_id} · {happened}"

    @cached_property
    def poses(self) -> Poses:
        return self._at_centres(self.moment.poses) if self.decided else self.predicted

    @cached_property
    def predicted(self) -> Poses:
        """The map as it was before the moment, and the new submap by odometry."""
        moment, poses = self.moment, self.moment.poses
        if self.number:
            before = self.moments[self.number - 1]
            poses = before.poses
            poses[moment.submap_id] = (
                moment.odometry
                if moment.starts_traverse
                else poses[before.submap_id] @ (before.odometry.inverse() @ moment.odometry)
            )
        return self._at_centres(poses)

    @cached_property
    def odometry(self) -> Poses:
        so_far = self.moments[: self.number + 1]
        return self._at_centres({moment.submap_id: moment.odometry for moment in so_far})

    @cached_property
    def moves_from(self) -> Poses | None:
        """The poses from which the map moves; None if it stands still."""
        least = CORRECTED if self.grows else MOVES
        moves = (self.decided and self.moving) and any(
            abs(pose.translation - self.predicted[name].translation).max() > least
            for name, pose in self.poses.items()
        )
        return self.predicted if moves else None

    @cached_property
    def correction(self) -> Correction:
        moment, judged = self.moment, self.moments[: self.number + self.decided]
        highest = max((c.registration.score for m in self.moments for c in m.closures), default=1.0)
        loops = tuple(loop for loop in verdicts_at(judged).values() if loop.accepted)
        accepted = frozenset(loop.pair for loop in loops)
        if self.goes_on:  # compared or refused pairs are visible as long as they are news
            news = (replace(closure, accepted=False) for closure in moment.closures)
            loops += tuple(one for one in news if not self.decided or one.pair not in accepted)
        wrong = accepted.intersection(moment.rejected) if self.decided else frozenset[PairOfIds]()
        return Correction(None, moment.covariances, loops, wrong, highest or 1.0)

    def _at_centres(self, poses: Poses) -> Poses:
        return at_centres(self.dataset.centres, poses)


def between(start: Poses, end: Poses, share: float) -> Poses:
    """Interpolate poses; those that only the end has stand where they end."""
    first = pose_rows({name: start.get(name, pose) for name, pose in end.items()})
    return poses_of_rows(end, interpolated_rows(first, pose_rows(end), share))


@dataclass(frozen=True, eq=False)
class World:
    """What is shown of all submaps, and how."""

    whole: Dataset
    options: WorldOptions = field(default_factory=WorldOptions)
    correction: Correction = field(default_factory=Correction)
    selected: str | None = None  # id of the submap that is outlined
    share: float = 1.0  # how far the corrected poses are on the way from odometry
    past: Past | None = None  # what is shown in place of the whole
    surfaces: Mapping[str, Terrain] = field(default_factory=dict)  # of each submap, by id

    @classmethod
    def of(cls, dataset: Dataset, options: WorldOptions | None = None) -> "World":
        """Begin with a dataset at the first poses that it has."""
        options = replace(options or WorldOptions(), poses=pose_sources(dataset)[0])
        return cls(dataset, options)

    @property
    def dataset(self) -> Dataset:
        return self.whole if self.past is None else self.past.dataset

    @property
    def goes_on(self) -> bool:
        return self.past is not None and self.past.goes_on

    @property
    def grows(self) -> bool:
        return self.past is not None and self.past.grows

    @property
    def pose_sources(self) -> tuple[PoseSource, ...]:
        return pose_sources(self.whole, self.correction.corrected)

    def with_surfaces(self, surfaces: Mapping[str, Terrain]) -> "World":
        """The world as it is drawn; the past has corrected poses and loops of its own."""
        if self.past is None:
            return replace(self, surfaces=surfaces)
        return replace(
            self,
            options=replace(self.options, poses="corrected", refused=True),
            correction=self.past.correction,
            selected=None,
            surfaces=surfaces,
        )

    @cached_property
    def poses(self) -> Poses:
        """Pose of the centre of each submap that stands somewhere, by id."""
        source, graph = self.options.poses, self.correction.graph
        if self.past is not None:
            return self.past.poses
        if source == "corrected" and graph is not None and self.share < 1.0:
            return graph.at(self.share)
        return poses_of(self.whole, source, self.correction.corrected)

    @cached_property
    def trajectories(self) -> dict[PoseSource, Poses]:
        """Poses along each trajectory, by where they come from."""
        if self.past is not None:
            return {"odometry": self.past.odometry, "corrected": self.past.poses}
        return {
            source: poses_of(self.whole, source, self.correction.corrected)
            for source in self.pose_sources
            if source != "in rows"
        }

    @cached_property
    def track_errors(self) -> dict[str, str]:
        """The error of each track against the true poses (ATE), where there are any."""
        dataset, errors = self.dataset, dict[str, str]()
        true, centres = judged_poses(dataset, dataset.true_poses), dataset.centres
        for source, poses in self.trajectories.items():
            if source == "true":
                continue
            along = self.poses if source == self.options.poses else poses
            if dataset.positions_only:
                along = {name: shifted(pose, -centres[name]) for name, pose in along.items()}
            try:
                error = trajectory_error(true, along, positions_only=dataset.positions_only)
            except InputError:  # fewer than two submaps have both poses
                continue
            errors[source] = f"{error.absolute:.2f} m"
        return errors

    @property
    def placed(self) -> dict[str, Terrain]:
        return {name: ground for name, ground in self.surfaces.items() if name in self.poses}

    @property
    def certain(self) -> dict[str, Float[Array, "3 3"]]:
        known = self.correction.covariances
        if known is None or self.options.poses != "corrected":
            return {}
        return dict(zip(self.poses, known, strict=True))

    @property
    def num_accepted(self) -> tuple[int, int]:
        """Number of loop closures, and of odometry neighbours, among the loops accepted."""
        accepted = (loop.pair for loop in self.correction.loops if loop.accepted)
        return count_kinds(self.dataset, accepted)


def marks_of(moments: Sequence[Moment]) -> list[tuple[int, MarkKind]]:
    """List what happened when; a refusal is taken back, or contradicted by others from then on."""
    marks: list[tuple[int, MarkKind]] = []
    rejected = [frozenset[PairOfIds](), *(frozenset(moment.rejected) for moment in moments)]
    for moment, (before, now) in zip(moments, pairwise(rejected), strict=True):
        if moment.loops:
            marks.append((moment.number, "closure"))
        if moment.moved >= CORRECTED:
            marks.append((moment.number, "correction"))
        if now - before or any(not closure.accepted for closure in moment.flipped):
            marks.append((moment.number, "refusal"))
    return marks


def words_of(moment: Moment) -> str:
    """What happened at a moment, in one line."""
    closes = [closure.database_id for closure in moment.loops]
    words: list[str] = []
    if closes:
        more = f" and {len(closes) - 3} more" if len(closes) > 3 else ""
        words.append(f"closes with {', '.join(closes[:3])}{more}")
    if moment.moved >= CORRECTED:
        words.append(f"moves the map by {moment.moved:.1f} m")
    if moment.flipped:
        words.append(f"turns {len(moment.flipped)} earlier")
    if not words:
        compared = f"compared with {len(moment.closures)} earlier"
        words.append(compared if moment.number else "the first submap")
    return " · ".join(words)
