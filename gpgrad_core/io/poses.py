"""Pose files, and scans with a pose each; the guide has their forms (datasets.md).

A row of a pose file is TUM's ``index tx ty tz qx qy qz qw``: ``p_world = R p_submap + t``.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.reading.paths import in_order
from gpgrad_core.reading.text import (
    OWN_PLACE,
    check_unit,
    column_names,
    lines_of,
    parse_number,
    parse_numbers,
    read_text,
    split_rows,
    write_lines,
)
from gpgrad_core.se2 import FAR, SE2, Pose, fit_se2
from gpgrad_core.types import MAX_COORDINATE

AROUND = 3
"""Submaps on either side by whose positions a heading is found."""
LEAST_EXTENT = 2.0
"""Least extent of these positions [m]; from shorter pieces a heading is too uncertain."""
NAMED_WIDTHS = (4, 8, 9, 44)
"""Columns of rows that have the time, x, y, z and, but for the first, the quaternion first."""
GROUPS = {"p": re.compile(r"(pos|trans)\w*"), "q": re.compile(r"(quat|orient|rot)\w*")}
"""Words before ``x``, ``y``, ``z`` and ``w`` in a sentence, by what these are named for them."""
TIME = re.compile(r"t|.*(time|stamp|secs?).*")
QUATERNION_TOLERANCE = ROTATION_TOLERANCE = 0.01
"""A quaternion or a matrix further from a rotation is not a rounded one: its columns are swapped,
or mean something else."""
LEVEL, TIPPED, OVER = 1e-12, 0.03, 0.3
"""Mean sin² of half the tilt of submaps: of exactly level ones, of those that are not level where
another order of the quaternion makes them so, and of those that no order excuses."""
ASK_ORDER = (
    "name the columns in a first line: # {} tx ty tz qw qx qy qz if w comes first, or … qx qy qz "
    "qw if it comes last"
)
CLOUD, TRUTH = ".xyz", ".gt"
VERTEX = "VERTEX_SE3:QUAT"
KEYFRAMES = {
    "cloud.pcd": ("data", "estimate"),
    "points_compact.bin": ("data.txt", "T_world_origin:"),
}
"""Files of a keyframe's points, the file beside each, and the line there before the pose."""
LARGEST = 10_000
"""Bytes of a ``.gt``; sixteen numbers take 200."""


def read_poses(path: Path, indices: Collection[int]) -> dict[int, Pose]:
    """Read the poses of existing submaps by index; a ``#`` line may name the columns' order."""
    needs = "a pose needs 8: index tx ty tz qx qy qz qw"
    rows = _rows(path, indices, 8, needs)
    poses = {index: make_pose(values, where) for index, values, where in rows}
    if poses and named_columns(path, 8) is None:
        _check_level([pose.quaternion for pose in poses.values()], path)
    return poses


def _check_level(quaternions: Sequence[Float[Array, "4"]], path: Path) -> None:
    """Refuse turns that tip level submaps over, as those do whose w comes first."""
    x, y, z, _ = np.square(quaternions).mean(axis=0).tolist()
    tilt, w_first = x + y, y + z  # sin² of half the tilt, as the columns are and with w first
    level = w_first < LEVEL and tilt > 1e6 * LEVEL
    if level or tilt > OVER or (tilt > TIPPED and tilt > 10 * w_first):
        raise InputError(
            f"{path}: its turns tip the submaps over by {2 * np.degrees(np.arcsin(tilt**0.5)):.2g} "
            f"degrees, and submaps are level; {ASK_ORDER.format('index')}"
        )


def named_columns(path: Path, width: int) -> tuple[Sequence[int], bool] | None:
    """Find the columns of the time, x, y, z, qx, qy, qz and qw by a line above the rows.

    Such a line is ``# timestamp tx ty tz qw qx qy qz``; rows of a `width` of 4 have no quaternion.
    Also gives whether times are in nanoseconds; None where no line names the columns.
    """
    for number, line in enumerate(lines_of(read_text(path)), start=1):
        if parse_number(re.split(r"[\s,]", line.strip(), maxsplit=1)[0]) is not None:
            break
        columns = _columns_of(column_names(line), width)
        if columns is not None and -1 in columns:
            needed = "x y z" if width == 4 else "x y z qx qy qz qw"
            order = "x y z" if width == 4 else "tx ty tz qw qx qy qz"
            raise InputError(
                f"{path}, line {number}: names the columns, but not each of {needed} just once; "
                f"name and give these, as # index {order} does, or remove the line if they follow "
                "the time in this order"
            )
        if columns is not None:
            check_unit(line, f"{path}, line {number}")
            return columns, "[ns]" in line
    return None


def _columns_of(words: Sequence[str], width: int) -> list[int] | None:
    """Find the columns that some words name, -1 for one that is missing; None if they name none."""
    groups: dict[str, dict[str, int]] = {}  # columns by the last letter, and by what is before it
    before = ""
    for column, name in enumerate(words):
        before = next((key for key, kind in GROUPS.items() if kind.fullmatch(name)), before)
        word = before + name if len(name) == 1 else name
        if word[-1] in "wxyz":
            group = groups.setdefault(word[:-1], {})
            group[word[-1]] = -1 if word[-1] in group else column
    turn = next((group for group in groups.values() if len(group) == 4), {})
    rest = [name for name, group in groups.items() if group is not turn]
    places = [name for name in rest if len(groups[name].keys() - {"w"}) > 1]
    if len(places) > 1:  # velocities, too
        places = [name for name in places if OWN_PLACE.fullmatch(name)]
    place = groups[places[0]] if places else {}
    columns = [place.get(axis, -1) for axis in "xyz"]
    columns += [turn.get(axis, -1) for axis in "xyzw"] if width > 4 else []
    if len(words) == width and (turn or (place and width in NAMED_WIDTHS)):
        others = [column for column in range(width) if column not in columns]
        first = others[0] if others else 0
        return [next((k for k in others if TIME.fullmatch(words[k])), first), *columns]
    if turn and width in NAMED_WIDTHS[1:]:  # the time is the first, whatever else is said there
        if not place:
            columns[:3] = range(-4, -1)
        elif columns[:3] != sorted(columns[:3]) and max(columns[:3]) - min(columns[:3]) > 2:
            return [-1]  # what is said of each axis, in an order of its own
        order = sorted(columns)
        return [-1] if -1 in columns else [0, *(order.index(column) + 1 for column in columns)]
    return None


def read_positions(path: Path, indices: Collection[int]) -> dict[int, Float[Array, "3"]]:
    """Read the positions [m] of existing submaps by index, rows ``index x y z`` and comments."""
    positions: dict[int, Float[Array, 3]] = {}
    for index, values, where in _rows(path, indices, 4, "a position needs 4: index x y z"):
        check_position(values, where)
        positions[index] = np.array(values)
    return positions


def _rows(
    path: Path, indices: Collection[int], width: int, needs: str
) -> Iterator[tuple[int, list[float], str]]:
    """The index, the further numbers and the place of each row."""
    columns, _ = named_columns(path, width) or (range(width), False)
    named_at: dict[int, str] = {}
    for where, words in split_rows(path):
        if len(words) != width:
            raise InputError(f"{where}: has {len(words)} columns, but {needs}")
        values = parse_numbers([words[column] for column in columns], where)
        if not values[0].is_integer():
            got = words[columns[0]]
            raise InputError(f"{where}: the index must be a whole number, got {got}")
        index = int(values[0])
        if index not in indices:
            raise InputError(f"{where}: names submap {index}, which the dataset does not have")
        if index in named_at:
            raise InputError(
                f"{where}: names submap {index} a second time, after {named_at[index]}"
            )
        named_at[index] = where.rpartition(", ")[2]
        yield index, values[1:], where


def make_pose(values: list[float], where: str) -> Pose:
    """Make a pose of ``tx ty tz qx qy qz qw``; the error message begins with `where`."""
    check_position(values[:3], where)
    quaternion = np.array(values[3:])
    with np.errstate(over="ignore"):
        length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: the quaternion qx qy qz qw must have length 1, this one has {length:.3g}"
        )
    return Pose(np.array(values[:3]), quaternion / length)


def check_position(values: list[float], where: str) -> None:
    """Raise InputError for a position beyond `MAX_COORDINATE`; the message begins with `where`."""
    if not max(map(abs, values)) <= MAX_COORDINATE:
        raise InputError(
            f"{where}: the position tx ty tz is further from the origin than {MAX_COORDINATE:g} m"
        )


def check_matrices(matrices: Float[Array, "n 3 4"], places: Sequence[str]) -> None:
    """Refuse upper rows of 4x4 matrices [m] that are no poses; messages begin with places."""
    turns = matrices[:, :, :3]
    far = np.abs(matrices[:, :, 3]).max(axis=1) > MAX_COORDINATE
    if far.any():
        raise InputError(
            f"{places[int(np.argmax(far))]}: the position is further from the origin than "
            f"{MAX_COORDINATE:g} m"
        )
    # The largest number is looked at first: squares of huge ones overflow.
    wrong = np.abs(turns).max(axis=(1, 2)) > 2.0
    usual = np.where(wrong[:, None, None], 0.0, turns)
    off = np.abs(usual @ usual.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong |= (off > ROTATION_TOLERANCE) | (np.linalg.det(usual) < 0)
    if wrong.any():
        raise InputError(
            f"{places[int(np.argmax(wrong))]}: the first three columns of the pose's matrix are "
            "no rotation"
        )


def pose_of_matrix(matrix: Float[Array, "3 4"], where: str) -> Pose:
    """Make a pose of the upper three rows of a 4x4 matrix."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 - loads slowly

    check_matrices(matrix[None], [where])
    quaternion = Rotation.from_matrix(matrix[:, :3]).as_quat(canonical=True)
    return Pose(matrix[:, 3].copy(), quaternion)


def write_positions(path: Path, positions: Mapping[int, Float[Array, "3"]]) -> None:
    """Write positions as rows ``index x y z`` [m], to a micrometre."""
    rows = ["# index x y z   (position of the submap's origin in the world)"]
    for index, position in positions.items():
        rows.append(" ".join([f"{index}", *(f"{value:.6f}" for value in position)]))
    write_lines(path, rows)


def write_poses(path: Path, poses: Mapping[int, Pose]) -> None:
    """Write poses as the rows of a pose file; see `pose_row`."""
    rows = ["# index tx ty tz qx qy qz qw   (p_world = R p_submap + t)"]
    rows += [pose_row(str(index), pose) for index, pose in poses.items()]
    write_lines(path, rows)


def write_pose_covariances(path: Path, covariances: Mapping[int, Float[Array, "6 6"]]) -> None:
    """Write covariances of x, y, z [m] and turns about them [rad]: rows of upper triangles."""
    names = ("x", "y", "z", "rx", "ry", "rz")
    pairs = [f"{names[i]}.{names[j]}" for i, j in zip(*np.triu_indices(6), strict=True)]
    rows = [f"# index {' '.join(pairs)}   (m and rad, along the axes of the world)"]
    for index, covariance in covariances.items():
        values = covariance[np.triu_indices(6)]
        rows.append(" ".join([f"{index}", *(f"{value:.6g}" for value in values)]))
    write_lines(path, rows)


def pose_row(key: str, pose: Pose) -> str:
    """Format a pose as a TUM row: micrometres, and far away twelve decimals of the quaternion."""
    decimals = 9 if np.abs(pose.translation).max() < FAR else 12
    translation = " ".join(f"{value:.6f}" for value in pose.translation)
    quaternion = " ".join(f"{value:.{decimals}f}" for value in pose.quaternion)
    return f"{key} {translation} {quaternion}"


def poses_at(
    positions: Mapping[int, Float[Array, "3"]], odometry: Mapping[int, Pose]
) -> dict[int, Pose]:
    """Combine true positions [m], as from GNSS, with odometry's headings, turned to fit nearby."""
    both = sorted(set(positions) & set(odometry))
    true = np.array([positions[k][:2] for k in both]).reshape(-1, 2)
    driven = np.array([odometry[k].translation[:2] for k in both]).reshape(-1, 2)
    poses: dict[int, Pose] = {}
    for place, index in enumerate(both):
        piece = _piece(true, driven, place)
        if piece is None:
            return {}
        turn = fit_se2(driven[piece], true[piece]).yaw
        x, y, z = positions[index].tolist()
        yaw = odometry[index].planar.yaw + turn
        poses[index] = Pose.from_planar(SE2(x, y, yaw), z)
    return poses


def _piece(true: Float[Array, "n 2"], driven: Float[Array, "n 2"], place: int) -> slice | None:
    """Choose the stretch around a place that is long enough to give a heading."""
    for reach in range(AROUND, max(len(true), AROUND + 1)):
        piece = slice(max(place - reach, 0), place + reach + 1)
        extents = [np.ptp(points[piece], axis=0).max(initial=0.0) for points in (true, driven)]
        if min(extents) >= LEAST_EXTENT:
            return piece
    return None


@dataclass(frozen=True)
class PosedScan:
    """A scan and its pose."""

    name: str  # that of its folder
    cloud: Path
    source: Path  # the file of its pose
    pose: Pose | None  # ``T_world_scanner``; None if the file lacks it
    true: bool = True  # whether it is the true one, not that of a SLAM program


def is_posed_scan(folder: Path) -> bool:
    """Whether a folder holds one scan and its pose, or a keyframe."""
    own = all((folder / f"{folder.name}{ending}").is_file() for ending in (CLOUD, TRUTH))
    return own or any((folder / name).is_file() for name in KEYFRAMES)


def find_posed_scans(folder: Path) -> list[PosedScan]:
    """Find the scans with a pose each in a folder, sorted by name; there may be none."""
    if not folder.is_dir():
        return []
    inner = in_order([scan for scan in folder.iterdir() if scan.is_dir()])
    posed: list[PosedScan] = []
    bare: list[Path] = []
    for scan in inner:
        cloud, truth = (scan / f"{scan.name}{ending}" for ending in (CLOUD, TRUTH))
        if cloud.is_file() and truth.is_file():
            posed.append(PosedScan(scan.name, cloud, truth, read_matrix_pose(truth)))
        elif cloud.is_file():
            bare.append(scan)
    if posed and bare:
        raise InputError(
            f"{bare[0]}: has {bare[0].name}{CLOUD} but no pose {bare[0].name}{TRUTH}; copy the "
            "pose too, or remove the scan"
        )
    return posed or _find_keyframes(folder, inner)


def _find_keyframes(folder: Path, inner: Sequence[Path]) -> list[PosedScan]:
    """Find the keyframes that hdl_graph_slam or GLIM dumped into a folder."""
    graph, posed = folder / "graph.g2o", list[PosedScan]()
    rows = split_rows(graph) if graph.is_file() else []
    vertices = {
        words[1]: (words[2:], where) for where, words in rows if words[0] == VERTEX and words[1:]
    }
    for scan in inner:
        name = next((name for name in KEYFRAMES if (scan / name).is_file()), None)
        if name is None:
            continue
        source, key = scan / KEYFRAMES[name][0], KEYFRAMES[name][1]
        if not source.is_file() and not vertices:
            continue  # another program's folder
        beside = split_rows(source) if source.is_file() else []
        heads = {words[0]: k for k, (_, words) in enumerate(beside)}
        number = beside[heads["id"]][1][-1] if "id" in heads else scan.name.lstrip("0") or "0"
        pose = None
        if number in vertices:
            words, where = vertices[number]
            if len(words) != 7:
                raise InputError(f"{where}: {VERTEX} needs a number and 7 more, x y z qx qy qz qw")
            source, pose = graph, make_pose(parse_numbers(words, where), where)
        elif key in heads:
            four = beside[heads[key] + 1 : heads[key] + 5]
            matrix = [parse_numbers(words, where) for where, words in four]
            if [len(row) for row in matrix] != [4] * 4:
                raise InputError(f"{source}: {key} must be four rows of four numbers")
            pose = pose_of_matrix(np.array(matrix)[:3], str(source))
        elif vertices:
            source = graph
        posed.append(PosedScan(scan.name, scan / name, source, pose, true=False))
    return posed


def read_matrix_pose(path: Path) -> Pose:
    """Read a pose written as the four rows of a 4x4 matrix."""
    rows: list[list[float]] = []
    for where, words in split_rows(path, LARGEST, comment=None):
        if len(words) != 4 or len(rows) == 4:
            raise InputError(f"{where}: a pose is four rows of four numbers, a 4x4 matrix")
        rows.append(parse_numbers(words, where))
    if len(rows) != 4:
        raise InputError(f"{path}: has {len(rows)} rows; a pose is the four rows of a 4x4 matrix")
    matrix = np.array(rows)
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-6):
        raise InputError(f"{path}: the last row of a pose's 4x4 matrix must be 0 0 0 1")
    return pose_of_matrix(matrix[:3], str(path))
