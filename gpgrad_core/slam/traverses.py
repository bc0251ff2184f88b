"""Several traverses in one map: the closures between them tell how their frames lie."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError, NoTerrainError
from gpgrad_core.io.folder import Outline, index_of
from gpgrad_core.reading.paths import different_names
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import Edge, PoseGraph
from gpgrad_core.types import Array, Dataset, GroundChoice, Submap

AGREEMENT = 4.0
"""Two closures agree on how two frames lie if they differ by no more than this many standard
deviations of the odometry between them."""


@dataclass(frozen=True, eq=False)
class PlacedGraph:
    """A graph whose traverses lie in one frame, as far as closures join them."""

    # the graph with all poses in the frame of the first traverse. The poses of a traverse that no
    # closure joins to the first are unchanged.
    graph: PoseGraph
    # how many closures agree on where each traverse lies, by the id of its first submap; 0 for the
    # first traverse
    support: dict[str, int]
    alone: tuple[str, ...]  # first submap of each traverse that no closure joins to the first


@dataclass(frozen=True, eq=False)
class JoinedDatasets:
    """Datasets side by side, each with a frame of its own."""

    # all submaps as one dataset. If there is more than one dataset, a submap's id is ``NAME:ID``.
    outline: Outline
    traverses: dict[str, tuple[str, ...]]  # ids of each dataset's submaps, by the dataset's name
    numbers: dict[str, int]  # number of each submap within its own dataset, by id

    @property
    def starts(self) -> tuple[str, ...]:
        """First submap of each dataset but the first."""
        return tuple(names[0] for names in self.traverses.values())[1:]

    def sound(self, on_note: Callable[[str], None]) -> Iterator[tuple[int, Submap]]:
        """Load the submaps of which a map can be made, with their places; notes name the others."""
        for note in self.outline.dataset.notes:
            on_note(note)
        for k in range(len(self.outline.clouds)):
            try:
                submap, notes = self.outline.load(k)
            except NoTerrainError as error:
                on_note(f"{error}: it was left out")
                continue
            for note in notes:
                on_note(note)
            yield k, submap

    def keeping(self, ids: Collection[str]) -> "JoinedDatasets":
        outline = self.outline
        numbers = [k for k, submap in enumerate(outline.dataset.submaps) if submap.id in ids]
        submaps = tuple(outline.dataset.submaps[k] for k in numbers)
        sound = Outline(
            replace(outline.dataset, submaps=submaps),
            tuple(outline.clouds[k] for k in numbers),
            tuple(outline.sensor(k) for k in numbers),
            {new: outline.extents[k] for new, k in enumerate(numbers) if k in outline.extents},
        )
        left = {k: tuple(name for name in v if name in ids) for k, v in self.traverses.items()}
        return replace(self, outline=sound, traverses={k: v for k, v in left.items() if v})


def join_datasets(outlines: Sequence[Outline]) -> JoinedDatasets:
    """Join datasets side by side; InputError if there are none."""
    if not outlines:
        raise InputError("give one dataset or more")
    names = different_names(outline.dataset.name for outline in outlines)
    alone = len(outlines) == 1
    choices: set[GroundChoice] = {outline.dataset.ground for outline in outlines}
    if len(choices) > 1:
        raise InputError(
            f"{' + '.join(names)}: what stands on the ground is treated differently; give ground "
            "the same value in each dataset.toml"
        )
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
        ground=choices.pop(),
        positions_only=any(outline.dataset.positions_only for outline in outlines),
        origin=outlines[0].dataset.origin,
    )
    clouds = tuple(cloud for outline in outlines for cloud in outline.clouds)
    traverses = {
        name: tuple(submap.id for submap in part) for name, part in zip(names, parts, strict=True)
    }
    sensors = tuple(outline.sensor(k) for outline in outlines for k in range(len(outline.clouds)))
    measured = [outline.extents.get(k) for outline in outlines for k in range(len(outline.clouds))]
    extents = {k: extent for k, extent in enumerate(measured) if extent is not None}
    return JoinedDatasets(Outline(dataset, clouds, sensors, extents), traverses, numbers)


def place_traverses(graph: PoseGraph) -> PlacedGraph:
    """Transform all traverses into the frame of the first, before the graph is solved.

    Each closure between two traverses implies how one frame lies in the other, but some are wrong.
    The one that most others agree with, as far as odometry's errors explain the differences, is
    used. Frames are gravity-aligned, so x, y, z and yaw place one.
    """
    traverses = _traverses(graph)
    if len(traverses) == 1:
        return PlacedGraph(graph, {traverses[0][0]: 0}, ())
    traverse_of = {name: k for k, names in enumerate(traverses) for name in names}
    centred = graph.centred
    odometry = _Odometry(centred, traverses)
    poses, support = dict(centred.poses), {traverses[0][0]: 0}
    placed, waiting = {0}, set(range(1, len(traverses)))
    while waiting:
        best = _best_closure(centred, traverse_of, odometry, placed, waiting)
        if best is None:
            break
        edge, agreeing, candidate = best
        T_world_frame = _frame(edge, poses, joins_end=traverse_of[edge.end] == candidate)
        for name in traverses[candidate]:
            poses[name] = T_world_frame @ poses[name]
        support[traverses[candidate][0]] = agreeing
        placed.add(candidate)
        waiting.remove(candidate)
    alone = tuple(traverses[k][0] for k in sorted(waiting))
    poses = {name: graph.at_origin(name, pose) for name, pose in poses.items()}
    return PlacedGraph(replace(graph, poses=poses), support, alone)


def _best_closure(
    graph: PoseGraph,
    traverse_of: dict[str, int],
    odometry: "_Odometry",
    placed: set[int],
    waiting: set[int],
) -> tuple[Edge, int, int] | None:
    """Find the closure from a placed traverse to a waiting one that most others agree with."""
    best: tuple[Edge, int, int] | None = None
    highest = (0, 0.0)
    for candidate in sorted(waiting):
        joining = [
            edge
            for edge in graph.loops
            if {traverse_of[edge.start], traverse_of[edge.end]} & placed
            and candidate in (traverse_of[edge.start], traverse_of[edge.end])
        ]
        for edge in joining:
            same_pair = [
                oriented
                for other in joining
                if (oriented := _oriented_as(edge, other, traverse_of)) is not None
            ]
            agreeing = sum(odometry.agree(edge, other) for other in same_pair)
            rank = agreeing, edge.score or 0.0
            if best is None or rank > highest:
                best, highest = (edge, agreeing, candidate), rank
    return best


def _oriented_as(edge: Edge, other: Edge, traverse_of: dict[str, int]) -> Edge | None:
    """Turn a closure to lead between the same traverses in one direction; None if it cannot."""
    ends = traverse_of[edge.start], traverse_of[edge.end]
    if ends == (traverse_of[other.start], traverse_of[other.end]):
        return other
    if ends == (traverse_of[other.end], traverse_of[other.start]):
        return replace(
            other, start=other.end, end=other.start, T_start_end=other.T_start_end.inverse()
        )
    return None


def _frame(edge: Edge, poses: dict[str, Pose], *, joins_end: bool) -> Pose:
    """``T_world_frame`` of a traverse's own level frame, according to one closure."""
    if joins_end:
        T_world_submap, T_frame_submap = poses[edge.start] @ edge.T_start_end, poses[edge.end]
    else:
        T_world_submap = poses[edge.end] @ edge.T_start_end.inverse()
        T_frame_submap = poses[edge.start]
    motion = T_world_submap.planar @ T_frame_submap.planar.inverse()
    height = float(T_world_submap.translation[2] - T_frame_submap.translation[2])
    return Pose.from_planar(motion, height)


def _traverses(graph: PoseGraph) -> list[list[str]]:
    """List the submaps along each chain of odometry."""
    entered = {edge.end for edge in graph.edges if edge.kind == "odometry"}
    traverses: list[list[str]] = []
    for name in graph.poses:
        if name not in entered:
            traverses.append([])
        traverses[-1].append(name)
    return traverses


def _variance(edge: Edge) -> Float[Array, "2"]:
    """The variance of a planar motion: of x and y together [m²], and of the yaw [rad²]."""
    x, y, _, _, _, yaw = np.diag(edge.covariance)
    return np.array([x + y, yaw])


def _at_end_of(span: float, variance: Float[Array, "2"]) -> Float[Array, "2"]:
    """The variance at a point some way off [m], which an error of the yaw swings."""
    return variance + np.array([variance[1] * span**2, 0.0])


class _Odometry:
    """The motions between the submaps of a traverse by odometry, and their variances."""

    def __init__(self, graph: PoseGraph, traverses: list[list[str]]) -> None:
        self._poses = graph.poses
        self._since_start: dict[str, Float[Array, 2]] = {}
        leading_to = {edge.end: edge for edge in graph.edges if edge.kind == "odometry"}
        for names in traverses:
            total = np.zeros(2)
            for name in names:
                if name in leading_to:
                    total = total + _variance(leading_to[name])
                self._since_start[name] = total

    def agree(self, edge: Edge, other: Edge) -> bool:
        """Whether two closures between two traverses, in one direction, can both be right."""
        along_ends = self._motion(edge.end, other.end)
        there = edge.T_start_end @ along_ends
        back = self._motion(edge.start, other.start) @ other.T_start_end
        gap = there.planar.inverse() @ back.planar
        span = _length(along_ends)
        variance = (
            self._variance(edge.start, other.start)
            + self._variance(edge.end, other.end)
            + _at_end_of(span, _variance(edge))
            + _at_end_of(span, _variance(other))
        )
        most_off, most_turn = AGREEMENT * np.sqrt(variance)
        return bool(np.hypot(gap.x, gap.y) <= most_off and abs(gap.yaw) <= most_turn)

    def _motion(self, a: str, b: str) -> Pose:
        return self._poses[a].inverse() @ self._poses[b]

    def _variance(self, a: str, b: str) -> Float[Array, "2"]:
        gained = np.abs(self._since_start[a] - self._since_start[b])
        return _at_end_of(_length(self._motion(a, b)), gained)


def _length(motion: Pose) -> float:
    return float(np.linalg.norm(motion.translation))
