"""The pose graph: submaps, with odometry and accepted closures between them, and its g2o files."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from typing_extensions import Doc

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import index_of
from gpgrad_core.io.poses import make_pose
from gpgrad_core.io.records.files import replacing
from gpgrad_core.params import Bounds, check_bounds
from gpgrad_core.reading.text import lines_of, parse_count, parse_numbers, read_text, write_lines
from gpgrad_core.se2 import FAR, Pose
from gpgrad_core.types import (
    Array,
    Dataset,
    LoopClosure,
    PairOfIds,
    Registration,
    Submap,
    read_only,
)

EdgeKind = Literal["odometry", "loop"]
AnchorKind = Literal["start", "place", "surface"]
Centres: TypeAlias = Mapping[str, Float[Array, "3"]]

HEIGHT_FLOOR = 0.01
"""Standard deviation that is added to that of a loop closure's height [m]."""

LEAST_LEVER = 0.1
"""Shortest lever of a turn's uncertainty [m], for inliers that lie almost at one point."""
HALVED = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
"""Converts a covariance: g2o measures a turn by the quaternion's vector part, half of a small
angle."""
VERTEX, EDGE = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT"
MIN_INFORMATION, MAX_INFORMATION = 1e-18, 1e18
"""A standard deviation of 1e9 m, and one of 1e-9 m; what lies beyond cannot be computed with."""
COLUMNS = {VERTEX: 1 + 7, EDGE: 2 + 7 + 21}


@dataclass(frozen=True)
class GraphParams:
    """How certain the edges of a pose graph are.

    An odometry edge over a distance d has the standard deviations ``odometry_std +
    odometry_drift d`` along x and y, ``odometry_std + height_drift d`` in height and
    ``heading_std + heading_drift √d`` in yaw, because its heading is a random walk. It turns
    about itself and not about the middle of what it sees: hence x and y have the deviation of yaw
    times the spread of the points besides. A closure has the covariance of its registration, if
    that is known.
    """

    odometry_drift: Annotated[
        float,
        Bounds(0.0, 1.0, 0.005, "", slider=(0.0, 0.2)),
        Doc("Standard deviation of odometry along x and y, as a share of the distance driven."),
    ] = 0.02
    odometry_std: Annotated[
        float,
        Bounds(0.0001, 100.0, 0.005, "m", slider=(0.005, 0.2)),
        Doc("Standard deviation of odometry along x and y that does not grow with the distance."),
    ] = 0.02
    height_drift: Annotated[
        float,
        Bounds(0.0, 1.0, 0.001, "", slider=(0.0, 0.1)),
        Doc("Standard deviation of odometry's height, as a share of the distance driven."),
    ] = 0.01
    heading_drift: Annotated[
        float,
        Bounds(0.0, 3.2, 0.001, "rad/√m", slider=(0.0, 0.05)),
        Doc("Random walk of odometry's heading."),
    ] = 0.01
    heading_std: Annotated[
        float,
        Bounds(0.0001, 3.2, 0.001, "rad", slider=(0.001, 0.05)),
        Doc("Standard deviation of odometry's heading that does not grow with the distance."),
    ] = 0.002
    tilt_std: Annotated[
        float,
        Bounds(0.0001, 3.2, 0.001, "rad", slider=(0.001, 0.05)),
        Doc("Standard deviation of roll and pitch, which are measured by gravity."),
    ] = 0.005
    closure_height_std: Annotated[
        float,
        Bounds(0.0001, 100.0, 0.005, "m", slider=(0.005, 0.2)),
        Doc(
            "Standard deviation of a loop closure's height where the ground was aligned, if its "
            "registration does not tell it."
        ),
    ] = 0.03
    association_std: Annotated[
        float,
        Bounds(0.0001, 10.0, 0.01, "m", slider=(0.01, 0.5)),
        Doc(
            "Standard deviation of one inlier. It is used for loop closures that have no "
            "covariance."
        ),
    ] = 0.15
    unseen_std: Annotated[
        float,
        Bounds(0.0001, 1000.0, 0.1, "m"),
        Doc("Standard deviation of a loop closure's height where the ground was not aligned."),
    ] = 10.0

    def __post_init__(self) -> None:
        check_bounds(self)


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured motion between two submaps.

    Attributes:
        start: Id of the earlier submap: the database of a loop closure.
        end: Id of the later submap: the query of a loop closure.
        T_start_end: The motion; it maps points of `end` into the frame of `start`.
        covariance: Covariance of its error ``T_start_end⁻¹ T_true``: x, y, z [m], then the
            rotation vector [rad], along the axes of `end`, at its centre (`PoseGraph.centres`).
        kind: Whether it is odometry or a loop closure.
        score: Score of the loop closure; None for odometry.
        trusted: Whether it is never refused, as odometry never is.
    """

    start: str
    end: str
    T_start_end: Pose
    covariance: Float[Array, "6 6"]
    kind: EdgeKind
    score: float | None = None
    trusted: bool = False

    def __post_init__(self) -> None:
        read_only(self.covariance)

    @property
    def pair(self) -> PairOfIds:
        """Its ends as a loop closure names them: query and database."""
        return self.end, self.start


@dataclass(frozen=True, eq=False)
class Anchor:
    """A measured pose of one submap in the world, such as on an elevation model."""

    submap: str  # id of the submap
    # where the drive starts, a place that was found on the model, or height and tilt of its surface
    kind: AnchorKind
    T_world_submap: Pose
    # inverse covariance of the error ``T_world_submap⁻¹ T_true``: x, y, z [1/m²], then the rotation
    # vector [1/rad²], along the submap's axes, at its centre; 0 where nothing was measured
    information: Float[Array, "6 6"]
    trusted: bool = False  # whether it is never refused

    def __post_init__(self) -> None:
        read_only(self.information)


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Submaps and the measured motions between them.

    Attributes:
        poses: ``T_world_submap`` by id, in the order of the traverse, before any closure is used.
        edges: The motions: odometry first, then loop closures.
        tilt_std: Standard deviation of each pose's roll and pitch [rad], which gravity gives.
        anchors: Measured poses in the world. If there are some, they hold the graph there; else
            its first pose is held.
        centres: `Submap.centre` by id, where errors are measured: a frame's origin may lie
            anywhere. It is the origin of a submap that is missing here.
    """

    poses: dict[str, Pose]
    edges: tuple[Edge, ...]
    tilt_std: float
    anchors: tuple[Anchor, ...] = ()
    centres: Centres = field(default_factory=dict)

    def at_centre(self, name: str, pose: Pose) -> Pose:
        """Move a submap's pose from its frame's origin to its centre."""
        return shifted(pose, self.centres[name]) if name in self.centres else pose

    def at_centres(self, poses: Mapping[str, Pose]) -> dict[str, Pose]:
        """Move poses by id from the frames' origins to the centres, where errors are measured."""
        return at_centres(self.centres, poses)

    def at_origin(self, name: str, pose: Pose) -> Pose:
        """Move a submap's pose from its centre back to its frame's origin."""
        return shifted(pose, -self.centres[name]) if name in self.centres else pose

    @property
    def centred(self) -> "PoseGraph":
        """The same graph between the centres of its submaps, which are its origins then."""
        return PoseGraph(
            self.at_centres(self.poses),
            tuple(replace(edge, T_start_end=self.between_centres(edge)) for edge in self.edges),
            self.tilt_std,
            tuple(
                replace(one, T_world_submap=self.at_centre(one.submap, one.T_world_submap))
                for one in self.anchors
            ),
        )

    def between_centres(self, edge: Edge) -> Pose:
        """The motion of an edge between the centres of its submaps."""
        motion = self.at_centre(edge.end, edge.T_start_end)
        if edge.start not in self.centres:
            return motion
        return Pose(motion.translation - self.centres[edge.start], motion.quaternion)

    @property
    def loops(self) -> tuple[Edge, ...]:
        """The edges that are loop closures."""
        return tuple(edge for edge in self.edges if edge.kind == "loop")


def shifted(pose: Pose, offset: Float[Array, "3"]) -> Pose:
    """Move the origin of a pose's frame by an offset along its own axes [m]."""
    return Pose(pose.apply(offset[None])[0], pose.quaternion)


def at_centres(centres: Centres, poses: Mapping[str, Pose]) -> dict[str, Pose]:
    """Move poses by id from the origins of their frames to the centres of submaps, if known."""
    return {
        name: shifted(pose, centres[name]) if name in centres else pose
        for name, pose in poses.items()
    }


def judged_poses(dataset: Dataset, poses: Mapping[str, Pose]) -> Mapping[str, Pose]:
    """Move poses by id to where errors are measured: centres, or origins if only these are true."""
    return poses if dataset.positions_only else at_centres(dataset.centres, poses)


def build_pose_graph(
    dataset: Dataset,
    closures: Iterable[LoopClosure],
    params: GraphParams | None = None,
    *,
    trusted: Iterable[tuple[str, str]] = (),
    starts: Iterable[str] = (),
) -> PoseGraph:
    """Build the pose graph of a traverse from its odometry and its accepted closures.

    Args:
        dataset: The submaps, each with an odometry pose.
        closures: The loop closures; refused ones are left out, but may not name a stranger either.
        params: How certain the edges are.
        trusted: Pairs (query id, database id) whose closures a person has confirmed.
        starts: Submaps with which another traverse begins; no odometry edge leads to them.

    Raises:
        InputError: If a submap has no odometry pose, or a closure names an unknown submap.
    """
    params = params or GraphParams()
    poses = odometry_poses(dataset)
    confirmed, first, centres = set(trusted), set(starts), dataset.centres
    edges = [
        odometry_edge(start, end, params)
        for start, end in pairwise(dataset.submaps)
        if end.id not in first
    ]
    for closure in closures:
        for name in closure.pair:
            if name not in poses:
                raise InputError(
                    f"{dataset.name}: a closure names submap {name!r}, which the dataset does not "
                    "have; give the closures of this dataset"
                )
        if not closure.accepted or closure.registration.T_database_query is None:
            continue
        trusts = closure.pair in confirmed
        edges.append(loop_edge(closure, poses, centres, params, trusted=trusts))
    return PoseGraph(poses, tuple(edges), params.tilt_std, centres=centres)


def odometry_poses(dataset: Dataset) -> dict[str, Pose]:
    """All odometry poses by id, in order; InputError, before long work, if one is missing."""
    poses = dataset.odometry
    missing = [submap.id for submap in dataset.submaps if submap.id not in poses]
    if missing:
        raise InputError(
            f"{dataset.name}: a pose graph needs odometry, and submap {missing[0]} has none "
            f"({len(missing)} of {len(dataset.submaps)} have none); add it to poses_odom.txt"
        )
    return poses


def odometry_edge(start: Submap, end: Submap, params: GraphParams) -> Edge:
    """Make the edge from a submap to the next one, by their odometry poses."""
    assert start.pose_odometry is not None
    assert end.pose_odometry is not None
    T_start_end = start.pose_odometry.inverse() @ end.pose_odometry
    from_centre = shifted(start.pose_odometry, start.centre).translation
    to_centre = shifted(end.pose_odometry, end.centre).translation
    distance = float(np.linalg.norm(to_centre - from_centre))
    yaw = params.heading_std + params.heading_drift * np.sqrt(distance)
    # The robot turns about itself, wherever it stands beside the cloud: a turn moves the centre.
    level = params.odometry_std + params.odometry_drift * distance
    level = np.hypot(level, yaw * end.extent.spread)
    height = params.odometry_std + params.height_drift * distance
    std = np.array([level, level, height, params.tilt_std, params.tilt_std, yaw])
    return Edge(start.id, end.id, T_start_end, np.diag(std**2), "odometry", trusted=True)


def loop_edge(
    closure: LoopClosure,
    poses: dict[str, Pose],
    centres: Centres,
    params: GraphParams,
    *,
    trusted: bool = False,
) -> Edge:
    """Turn a planar closure into a motion in space; gravity gives roll and pitch."""
    registration, start, end = closure.registration, closure.database_id, closure.query_id
    motion = registration.T_database_query
    assert motion is not None
    if registration.covariance is not None:
        height, height_std = registration.z_offset, params.closure_height_std
        if registration.z_std is not None:
            height_std = float(np.hypot(registration.z_std, HEIGHT_FLOOR))
        # The registration's covariance is in the database's frame, an edge's in the query's.
        turn = np.eye(3)
        turn[:2, :2] = motion.rotation.T
        planar = turn @ registration.covariance_at(centres[end][:2]) @ turn.T
    else:
        # The heights were not aligned: take the odometry's height, with almost no weight.
        height, height_std = (poses[start].inverse() @ poses[end]).translation[2], params.unseen_std
        planar = _covariance_of_inliers(registration, params)
    covariance = np.zeros((6, 6))
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = 0.5 * (planar + planar.T)
    covariance[[2, 3, 4], [2, 3, 4]] = [height_std**2, params.tilt_std**2, params.tilt_std**2]
    T_start_end = Pose.from_planar(motion, float(height))
    return Edge(start, end, T_start_end, covariance, "loop", registration.score, trusted)


def _covariance_of_inliers(registration: Registration, params: GraphParams) -> Float[Array, "3 3"]:
    """Estimate the covariance of a motion from its inliers and the area that they spread over."""
    offset_std = params.association_std / np.sqrt(max(registration.num_inliers, 1))
    # Points spread over a disc lie sqrt(area / 2 pi) rms from its centre: the yaw's lever.
    lever = max(np.sqrt(registration.overlap_area / (2 * np.pi)), LEAST_LEVER)
    return np.diag(np.array([offset_std, offset_std, offset_std / lever]) ** 2)


def write_graph(
    path: Path | str, graph: PoseGraph, poses: Mapping[str, Pose] | None = None
) -> None:
    """Write a pose graph.

    A vertex has the number in the submap's name; if not every submap has a number of its own, the
    vertices are numbered in their order. It is the submap's frame; but where ground lies farther
    than a kilometre from its frame's origin, all vertices are the submaps' centres, along the axes
    of their frames.

    Args:
        path: The ``.g2o`` file, with ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT`` lines.
        graph: The graph. What is known of gravity is left out: the format has no line for it.
        poses: Poses of the vertices, such as those of a solved graph; None takes the graph's own.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    numbers = vertex_numbers(graph)
    poses = poses or graph.poses
    if any(np.abs(centre).max() > FAR for centre in graph.centres.values()):
        graph, poses = graph.centred, graph.at_centres(poses)
    lines = [f"{VERTEX} {numbers[name]} {_text(pose)}" for name, pose in poses.items()]
    for edge in graph.edges:
        # The format's errors are those of the frames' origins.
        lever = _lever(graph.centres.get(edge.end, np.zeros(3))) @ np.linalg.inv(HALVED)
        information = lever.T @ np.linalg.inv(edge.covariance) @ lever
        weights = " ".join(f"{weight:.9g}" for weight in information[np.triu_indices(6)])
        ends = f"{numbers[edge.start]} {numbers[edge.end]}"
        lines.append(f"{EDGE} {ends} {_text(edge.T_start_end)} {weights}")
    with replacing(path) as unfinished:
        write_lines(unfinished, lines)


def _lever(arm: Float[Array, "3"]) -> Float[Array, "6 6"]:
    """How an error at a frame's origin (offset, turn) makes one at a point of the frame."""
    x, y, z = arm.tolist()
    lever = np.eye(6)
    lever[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    return lever


def vertex_numbers(graph: PoseGraph) -> dict[str, int]:
    """Number the vertices by the submaps' names, or in their order if these are ambiguous."""
    numbers = {name: index_of(name) for name in graph.poses}
    named = {name: number for name, number in numbers.items() if number is not None}
    if len(set(named.values())) == len(numbers):
        return named
    return {name: place for place, name in enumerate(numbers)}


def read_graph(path: Path | str, tilt_std: float | None = None) -> PoseGraph:
    """Read a pose graph that any tool wrote.

    The format does not tell odometry from loop closures: the first edge from a vertex to the next
    one counts as odometry, and all others count as closures.

    Args:
        path: The ``.g2o`` file, with 3D vertices and edges.
        tilt_std: Standard deviation of each pose's roll and pitch [rad]; None takes the default of
            `GraphParams`.

    Returns:
        The graph; its submaps are named by their numbers.

    Raises:
        InputError: If a line is of another kind, has the wrong number of columns, or names an
            unknown vertex; the message names the line.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    poses: dict[str, Pose] = {}
    edge_rows: list[_GraphLine] = []
    for number, line in enumerate(lines_of(read_text(path)), start=1):
        row = _read_row(line, f"{path}, line {number}")
        if row is None:
            continue
        if len(row.vertices) == 1:
            if row.vertices[0] in poses:
                raise InputError(f"{row.where}: gives vertex {row.vertices[0]} a second time")
            poses[row.vertices[0]] = row.pose
        else:
            edge_rows.append(row)
    names = sorted(poses, key=int)
    following = set(pairwise(names))
    edges: list[Edge] = []
    for row in edge_rows:
        start, end = row.vertices
        if missing := [name for name in (start, end) if name not in poses]:
            raise InputError(
                f"{row.where}: names vertex {missing[0]}, which the file does not have"
            )
        if start == end:
            raise InputError(f"{row.where}: joins vertex {start} to itself")
        kind: EdgeKind = "odometry" if (start, end) in following else "loop"
        following.discard((start, end))
        covariance = _covariance(row.values[7:], row.where)
        trusted = kind == "odometry"
        edges.append(Edge(start, end, row.pose, covariance, kind, trusted=trusted))
    tilt = GraphParams().tilt_std if tilt_std is None else tilt_std
    edges.sort(key=lambda edge: edge.kind == "loop")
    return PoseGraph({name: poses[name] for name in names}, tuple(edges), tilt)


@dataclass(frozen=True)
class _GraphLine:
    """One line of the file: a vertex has one number, an edge has two."""

    where: str
    vertices: tuple[str, ...]
    values: list[float]

    @property
    def pose(self) -> Pose:
        """The pose in the line; its quaternion must have length 1."""
        return make_pose(self.values[:7], self.where)


def _read_row(line: str, where: str) -> _GraphLine | None:
    """Parse a line; None if it holds nothing that is needed."""
    tag, *words = line.split("#", 1)[0].split() or [""]
    if not tag or tag == "FIX":
        return None
    if tag not in COLUMNS:
        raise InputError(f"{where}: {tag[:40]!r} is not one of {VERTEX}, {EDGE}")
    if len(words) != COLUMNS[tag]:
        raise InputError(f"{where}: {tag} has {COLUMNS[tag]} columns, found {len(words)}")
    num_vertices = 1 if tag == VERTEX else 2
    vertices: list[str] = []
    for word in words[:num_vertices]:
        number = parse_count(word)
        if number is None:
            raise InputError(f"{where}: the vertex {word[:40]!r} is not a whole number, 0 or more")
        vertices.append(str(number))
    return _GraphLine(where, tuple(vertices), parse_numbers(words[num_vertices:], where))


def _covariance(upper: list[float], where: str) -> Float[Array, "6 6"]:
    information = np.zeros((6, 6))
    information[np.triu_indices(6)] = upper
    information += np.triu(information, 1).T
    if np.abs(information).max() > MAX_INFORMATION:
        raise InputError(f"{where}: an entry of the information is above {MAX_INFORMATION:g}")
    if not np.linalg.eigvalsh(information)[0] > MIN_INFORMATION:
        raise InputError(f"{where}: the information matrix is not positive definite")
    whole = np.linalg.inv(HALVED)
    return whole @ np.linalg.inv(information) @ whole


def _text(pose: Pose) -> str:
    return " ".join(f"{number:.9g}" for number in pose.row)
