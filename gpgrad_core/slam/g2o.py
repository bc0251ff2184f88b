"""A pose graph in g2o's text format, which most optimisers read."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.errors import InputError
from gpgrad_core.io.folder import index_of
from gpgrad_core.io.poses import make_pose
from gpgrad_core.io.records.files import replacing
from gpgrad_core.reading.text import lines_of, parse_count, parse_numbers, read_text, write_lines
from gpgrad_core.se2 import Pose
from gpgrad_core.slam.graph import Edge, EdgeKind, GraphParams, PoseGraph
from gpgrad_core.types import Array

HALVED = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
"""Converts a covariance: g2o measures a turn by the quaternion's vector part, half of a small
angle."""
VERTEX, EDGE = "VERTEX_SE3:QUAT", "EDGE_SE3:QUAT"
MIN_INFORMATION, MAX_INFORMATION = 1e-18, 1e18
"""A standard deviation of 1e9 m, and one of 1e-9 m; what lies beyond cannot be computed with."""
COLUMNS = {VERTEX: 1 + 7, EDGE: 2 + 7 + 21}


def write_graph(
    path: Path | str, graph: PoseGraph, poses: Mapping[str, Pose] | None = None
) -> None:
    """Write a pose graph.

    A vertex has the number in the submap's name; if not every submap has a number of its own, the
    vertices are numbered in their order.

    Args:
        path: The ``.g2o`` file, with ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT`` lines.
        graph: The graph. What is known of gravity is left out: the format has no line for it.
        poses: Poses of the vertices, such as those of a solved graph; None takes the graph's own.

    Raises:
        InputError: If the file cannot be written there.
        OSError: If writing fails.
    """
    numbers = vertex_numbers(graph)
    lines = [
        f"{VERTEX} {numbers[name]} {_text(pose)}" for name, pose in (poses or graph.poses).items()
    ]
    for edge in graph.edges:
        information = np.linalg.inv(HALVED @ edge.covariance @ HALVED)
        weights = " ".join(f"{weight:.9g}" for weight in information[np.triu_indices(6)])
        ends = f"{numbers[edge.start]} {numbers[edge.end]}"
        lines.append(f"{EDGE} {ends} {_text(edge.T_start_end)} {weights}")
    with replacing(path) as unfinished:
        write_lines(unfinished, lines)


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
    edge_rows: list[_Row] = []
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
class _Row:
    """One line of the file: a vertex has one number, an edge has two."""

    where: str
    vertices: tuple[str, ...]
    values: list[float]

    @property
    def pose(self) -> Pose:
        """The pose in the line; its quaternion must have length 1."""
        return make_pose(self.values[:7], self.where)


def _read_row(line: str, where: str) -> _Row | None:
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
    return _Row(where, tuple(vertices), parse_numbers(words[num_vertices:], where))


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
    return " ".join(f"{number:.9g}" for number in (*pose.translation, *pose.quaternion))
