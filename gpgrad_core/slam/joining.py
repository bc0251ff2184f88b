"""Several traverses in one map: closures between them say how their frames lie."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gpgrad_core.datasets.folder import Outline, index_of
from gpgrad_core.errors import InputError
from gpgrad_core.se2 import SE2, Pose
from gpgrad_core.slam.graph import Edge, PoseGraph
from gpgrad_core.types import Dataset, Submap

AGREEMENT = 4.0
"""Two closures agree on how two frames lie up to this many standard deviations of what odometry
between them may be off."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A graph whose traverses lie in one frame, as far as closures join them.

    Attributes:
        graph: Poses of every traverse in the frame of the first; of those that nothing joins to
            it, as they were.
        support: For each traverse, how many closures agree on where it lies; 0 for the first.
        alone: First submap of each traverse that nothing joins to the first.
    """

    graph: PoseGraph
    support: dict[str, int]
    alone: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class JoinedDatasets:
    """Datasets side by side, each with a frame of its own.

    Attributes:
        outline: All submaps as one dataset; with more than one session their ids are ``NAME:ID``.
        traverses: Ids of each session's submaps, by the session's name.
        numbers: Number of each submap within its own dataset, by id.
    """

    outline: Outline
    traverses: dict[str, tuple[str, ...]]
    numbers: dict[str, int]

    @property
    def starts(self) -> tuple[str, ...]:
        """First submap of each session but the first."""
        return tuple(names[0] for names in self.traverses.values())[1:]

    def load(self, k: int) -> tuple[Submap, tuple[str, ...]]:
        """Load submap number k under its id here; see `Outline.load`."""
        submap, notes = self.outline.load(k)
        return replace(submap, id=self.outline.dataset.submaps[k].id), notes


def join_datasets(outlines: Sequence[Outline]) -> JoinedDatasets:
    """Put datasets side by side.

    Raises:
        InputError: If there is none.
    """
    if not outlines:
        raise InputError("give one dataset or more")
    names = _different([outline.dataset.name for outline in outlines])
    alone = len(outlines) == 1
    parts = [
        tuple(
            replace(submap, id=submap.id if alone else f"{name}:{submap.id}")
            for submap in outline.dataset.submaps
        )
        for name, outline in zip(names, outlines, strict=True)
    ]
    numbers = {
        submap.id: k if (index := index_of(submap.id)) is None else index
        for part in parts
        for k, submap in enumerate(part)
    }
    dataset = Dataset(
        " + ".join(names),
        tuple(submap for part in parts for submap in part),
        preferred=outlines[0].dataset.preferred,
        notes=tuple(note for outline in outlines for note in outline.dataset.notes),
    )
    clouds = tuple(cloud for outline in outlines for cloud in outline.clouds)
    traverses = {
        name: tuple(submap.id for submap in part) for name, part in zip(names, parts, strict=True)
    }
    return JoinedDatasets(Outline(dataset, clouds), traverses, numbers)


def place_traverses(graph: PoseGraph) -> Placed:
    """Bring all traverses into the frame of the first, before the graph is solved.

    Each closure between two traverses says how one frame lies in the other, and so do some wrong
    ones: the one that most others agree with is believed, as far as odometry between them can be
    off. All frames are gravity-aligned, so that four numbers say it all.
    """
    traverses = _traverses(graph)
    poses, support = dict(graph.poses), {traverses[0][0]: 0}
    number = {name: k for k, names in enumerate(traverses) for name in names}
    placed, waiting = {0}, set(range(1, len(traverses)))
    chains = _Chains(graph, traverses)
    while waiting:
        best: tuple[int, float, int, Pose] | None = None
        for candidate in sorted(waiting):
            joining = [
                edge
                for edge in graph.loops
                if {number[edge.start] in placed, number[edge.end] in placed} == {True, False}
                and candidate in (number[edge.start], number[edge.end])
            ]
            for edge in joining:
                agreeing = sum(chains.agree(edge, other, number) for other in joining)
                rank = agreeing, edge.score or 0.0
                if best is None or rank > best[:2]:
                    best = *rank, candidate, _frame(edge, poses, number, candidate)
        if best is None:
            break
        agreeing, _, candidate, T_world_frame = best
        for name in traverses[candidate]:
            poses[name] = T_world_frame @ poses[name]
        support[traverses[candidate][0]] = agreeing
        placed.add(candidate)
        waiting.remove(candidate)
    alone = tuple(traverses[k][0] for k in sorted(waiting))
    return Placed(replace(graph, poses=poses), support, alone)


def _frame(edge: Edge, poses: dict[str, Pose], number: dict[str, int], candidate: int) -> Pose:
    """``T_world_frame`` of a traverse's own frame, level, as one closure has it."""
    if number[edge.end] == candidate:
        T_world_end, own = poses[edge.start] @ edge.T_start_end, poses[edge.end]
    else:
        T_world_end, own = poses[edge.end] @ edge.T_start_end.inverse(), poses[edge.start]
    there, here = T_world_end.planar, own.planar
    motion = there @ here.inverse()
    return Pose.from_planar(motion, float(T_world_end.translation[2] - own.translation[2]))


def _traverses(graph: PoseGraph) -> list[list[str]]:
    """Names along each chain of odometry."""
    entered = {edge.end for edge in graph.edges if edge.kind == "odometry"}
    traverses: list[list[str]] = []
    for name in graph.poses:
        if name not in entered:
            traverses.append([])
        traverses[-1].append(name)
    return traverses


class _Chains:
    """How far odometry between two submaps of a traverse may be off."""

    def __init__(self, graph: PoseGraph, traverses: list[list[str]]) -> None:
        self._poses = graph.poses
        self._sums: dict[str, tuple[float, float]] = {}
        leading = {edge.end: edge for edge in graph.edges if edge.kind == "odometry"}
        for names in traverses:
            offset, yaw = 0.0, 0.0
            for name in names:
                if name in leading:
                    variances = np.diag(leading[name].covariance)
                    offset += float(variances[0] + variances[1])
                    yaw += float(variances[5])
                self._sums[name] = offset, yaw

    def agree(self, edge: Edge, other: Edge, number: dict[str, int]) -> bool:
        """Say whether two closures between the same traverses can both be right."""
        if (number[edge.start] == number[other.start]) != (number[edge.end] == number[other.end]):
            return False
        same_way = number[edge.start] == number[other.start]
        start, end = (other.start, other.end) if same_way else (other.end, other.start)
        measured = other.T_start_end if same_way else other.T_start_end.inverse()
        # Around the loop: along the closure, odometry, back the other closure, odometry.
        there = edge.T_start_end @ self._between(edge.end, end)
        back = self._between(edge.start, start) @ measured
        left: SE2 = there.planar.inverse() @ back.planar
        offset_variance, yaw_variance = 0.0, 0.0
        for a, b in ((edge.start, start), (edge.end, end)):
            offset, yaw = (abs(self._sums[a][k] - self._sums[b][k]) for k in (0, 1))
            span = float(np.linalg.norm(self._poses[a].translation - self._poses[b].translation))
            offset_variance += offset + yaw * span**2
            yaw_variance += yaw
        for one in (edge, other):
            span = float(np.linalg.norm(self._between(edge.end, end).translation))
            offset_variance += float(np.trace(one.covariance[:2, :2]))
            offset_variance += float(one.covariance[5, 5]) * span**2
            yaw_variance += float(one.covariance[5, 5])
        near = np.hypot(left.x, left.y) <= AGREEMENT * np.sqrt(offset_variance)
        return bool(near and abs(left.yaw) <= AGREEMENT * np.sqrt(yaw_variance))

    def _between(self, a: str, b: str) -> Pose:
        return self._poses[a].inverse() @ self._poses[b]


def _different(names: list[str]) -> list[str]:
    """Tell equal names apart by a number.

    >>> _different(["yard", "crater", "yard"])
    ['yard', 'crater', 'yard-2']
    """
    given: list[str] = []
    for name in names:
        count, made = 1, name
        while made in given:
            count += 1
            made = f"{name}-{count}"
        given.append(made)
    return given
