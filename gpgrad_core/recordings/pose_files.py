"""Files of poses over time (TUM and KITTI rows), of times, and of a sensor's pose on its body."""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from gpgrad_core.arrays import Array
from gpgrad_core.errors import InputError
from gpgrad_core.io.georeference import check_place, east_north_up
from gpgrad_core.io.poses import ASK_ORDER, check_matrices, check_position, make_pose, named_columns
from gpgrad_core.reading.paths import with_nanoseconds
from gpgrad_core.reading.text import lines_of, parse_number, parse_numbers, read_text, split_rows
from gpgrad_core.recordings.trajectory import SHORTEST_STEP, Poses, Trajectory
from gpgrad_core.types import MAX_COORDINATE

LARGEST_TABLE = 100_000_000
"""Bytes of a table with commas."""
MAX_TIME = 1e19
"""Of a time, in whatever unit: the nanoseconds since 1970 are a fifth of it."""
TUM, TUM_WITH_ID, TUM_WITH_COVARIANCE, KITTI, POSITION = 8, 9, 44, 12, 4
LEAST_STEPS, SIDEWAYS, AHEAD = 8, 0.7, 0.85
"""Least number of steps by which turns are judged, and the length of the mean of their directions,
as the robot sees them, below which it moves to any side, and above which always to the same."""
SINCE_1970 = re.compile(r"\d{9,10}\.")
LATEST = 1e17
"""Times beyond this are nanoseconds."""
SOLUTION = 6
"""Least number of columns of a solution of RTKLIB: the sixth is its quality."""
GPS_BEGAN, WEEK = 315_964_800.0, 604_800.0
"""Beginning of GPS time, 6 January 1980, in seconds since 1970, and seconds of a week."""
LEAP_SECONDS = 18.0
"""GPS time is so much ahead of UTC, since 2017 [s]."""
MOUNT_KEYS = ("Tr:", "Tr_velo_to_cam:", "Tr_velo_cam:")
"""KITTI's names for the pose of the LiDAR in the frame of the camera, whose poses KITTI gives."""


@dataclass(frozen=True, eq=False)
class PoseFile:
    """The content of a file of poses."""

    # poses by time; KITTI's poses have no times, so the row's number from 0 stands for it
    trajectory: Trajectory
    numbered: bool  # whether the rows are KITTI's
    # whether they are positions of a truth, and the turns mean nothing
    positions_only: bool = False
    # latitude, longitude [degrees] and height [m] of their frame, if known
    origin: tuple[float, float, float] | None = None


def read_pose_file(path: Path, usual: tuple[Sequence[int], bool] | None = None) -> PoseFile:
    """Read TUM rows ``timestamp tx ty tz qx qy qz qw``, or KITTI rows of a 3x4 matrix.

    A TUM row may also have the 36 numbers of a covariance, position first, as in ROS, or the number
    of a frame, as RTAB-Map writes it. A comment or a first line may name the columns in another
    order; `usual` is what `named_columns` gives where nothing does.
    """
    rows: list[list[float]] = []
    places: list[str] = []
    table = split_rows(path)
    if table and all(parse_number(word) is None for word in table[0][1]):
        table = table[1:]  # the names of the columns
    width = len(table[0][1]) if table else TUM
    named, in_nanoseconds = named_columns(path, width) or usual or (None, False)
    table = _with_nanoseconds(table, path, 0 if named is None else named[0])
    for where, words in table:
        is_layout = named is not None or len(words) in (TUM_WITH_ID, TUM_WITH_COVARIANCE, KITTI)
        if len(words) < TUM or not (is_layout or len(words) == TUM):
            raise InputError(
                f"{where}: has {len(words)} columns; a TUM pose has 8, timestamp tx ty tz qx qy qz "
                "qw, or 44 with its covariance, a KITTI pose 12"
            )
        if len(words) != width:
            raise InputError(f"{where}: has {len(words)} columns, the rows before it have {width}")
        whole = width == TUM_WITH_COVARIANCE or named is None
        rows.append(parse_numbers([words[k] for k in named or range(8)] + words[8:] * whole, where))
        places.append(where)
    if not rows:
        raise InputError(f"{path}: holds no poses")
    table = np.array(rows)
    if named is None and width == KITTI:
        stamps = np.arange(len(rows), dtype=np.float64)
        return PoseFile(Trajectory(stamps, poses_of_matrices(table, places)), numbered=True)
    _check_times(table[:, 0], places)
    if named is None and width == TUM_WITH_ID and (table[:, 8] % 1).any():
        raise InputError(f"{places[0]}: has 9 columns, and the last is no whole number of a frame")
    if in_nanoseconds or np.abs(table[:, 0]).min() > LATEST:
        table[:, 0] *= 1e-9
    poses = [make_pose(row[1:8], where) for row, where in zip(rows, places, strict=True)]
    stack = Poses(table[:, 1:4], Rotation.from_quat([pose.quaternion for pose in poses]))
    if named is None:
        _check_turns(stack, path)
    covariance = None
    if width == TUM_WITH_COVARIANCE:
        whole = table[:, 8:].reshape(-1, 6, 6)
        _check_covariances(whole, places)
        covariance = np.ascontiguousarray(whole[:, :3, :3])
    return PoseFile(Trajectory.in_order(table[:, 0], stack, covariance), numbered=False)


def _check_turns(poses: Poses, path: Path) -> None:
    """Refuse turns by which a robot that drives a curve moves to any side, but not with w first."""
    steps = np.diff(poses.translation, axis=0)
    moved = np.linalg.norm(steps, axis=1) > SHORTEST_STEP
    if moved.sum() < LEAST_STEPS:
        return
    steps = steps[moved] / np.linalg.norm(steps[moved], axis=1, keepdims=True)
    turns = poses.rotation[:-1][moved]
    w_first = Rotation.from_quat(np.roll(turns.as_quat(), -1, axis=1))
    world, in_file, other = (
        float(np.linalg.norm(turn.inv().apply(steps).mean(axis=0)))
        for turn in (Rotation.identity(len(steps)), turns, w_first)
    )
    if max(world, in_file) < SIDEWAYS and other > AHEAD:
        ask = ASK_ORDER.format("timestamp")
        raise InputError(f"{path}: its turns fit the drive only if w comes first; {ask}")


def read_timed_poses(path: Path, usual: tuple[Sequence[int], bool] | None = None) -> Trajectory:
    """Read TUM rows, as `read_pose_file` does."""
    poses = read_pose_file(path, usual)
    if poses.numbered:
        raise InputError(f"{path}: KITTI poses have no times, which the scans need; give TUM poses")
    return poses.trajectory


def read_truth_file(path: Path) -> PoseFile:
    """Read true poses, or true positions as a GNSS receiver gives them.

    Positions are rows ``timestamp x y z`` [s, m], z up, or a solution of RTKLIB 2.4.2 (``.pos``):
    week and seconds, or date and time, then latitude, longitude and height. Its places become
    metres from the first one, its times UTC. Not verified on a real file.
    """
    if path.suffix.lower() == ".pos":
        return positions_of(*_read_solution(path))
    words_of_rows = split_rows(path)
    if not words_of_rows or len(words_of_rows[0][1]) != POSITION:
        return read_pose_file(path)
    rows: list[list[float]] = []
    for where, words in words_of_rows:
        if len(words) != POSITION:
            raise InputError(f"{where}: has {len(words)} columns, the rows before it have 4")
        rows.append(parse_numbers(words, where))
        check_position(rows[-1][1:], where)
    columns, _ = named_columns(path, POSITION) or (range(POSITION), False)
    table = np.array(rows)[:, columns]
    _check_times(table[:, 0], [where for where, _ in words_of_rows])
    return _as_truth(table[:, 0], table[:, 1:])


def positions_of(stamps: Float[Array, "n"], places: Float[Array, "n 3"]) -> PoseFile:
    """Turn latitude, longitude [degrees] and height [m] into positions from the first one [m]."""
    latitude, longitude, height = (float(number) for number in places[0])
    positions = east_north_up(places, places[0])
    return replace(_as_truth(stamps, positions), origin=(latitude, longitude, height))


def _as_truth(stamps: Float[Array, "n"], positions: Float[Array, "n 3"]) -> PoseFile:
    poses = Poses(positions, Rotation.identity(len(positions)))
    return PoseFile(Trajectory.in_order(stamps, poses), numbered=False, positions_only=True)


def _read_solution(path: Path) -> tuple[Float[Array, "n"], Float[Array, "n 3"]]:
    """Read the times [s], and latitude, longitude and height, of a solution of RTKLIB."""
    stamps: list[float] = []
    places: list[list[float]] = []
    for where, words in split_rows(path, comment="%"):
        if len(words) < SOLUTION:
            raise InputError(
                f"{where}: has {len(words)} columns; a solution of RTKLIB has the time in two, "
                "then latitude, longitude [degrees] and height [m]"
            )
        stamps.append(_solution_time(words[:2], where))
        places.append(parse_numbers(words[2:5], where))
        check_place(places[-1], where)
    if not stamps:
        raise InputError(f"{path}: holds no positions")
    heads = [line[1:].split() for line in lines_of(read_text(path)) if line.startswith("%")]
    in_utc = any(words[:1] == ["UTC"] for words in heads)
    return np.array(stamps) - (0.0 if in_utc else LEAP_SECONDS), np.array(places)


def _solution_time(words: list[str], where: str) -> float:
    """Read the time of a row of RTKLIB [s]: GPS week and its seconds, or date and time."""
    if "/" not in words[0]:
        week, seconds = parse_numbers(words, where)
        if not (0 <= week <= 10_000 and 0 <= seconds <= WEEK):
            raise InputError(f"{where}: {words[0]} {words[1]} are no GPS week and seconds")
        return GPS_BEGAN + WEEK * week + seconds
    try:
        return datetime.strptime(
            f"{words[0]} {words[1]} +0000", "%Y/%m/%d %H:%M:%S.%f %z"
        ).timestamp()
    except ValueError:
        raise InputError(f"{where}: {words[0]} {words[1]} is no date and time") from None


def _check_covariances(covariance: Float[Array, "n 6 6"], places: list[str]) -> None:
    size = np.abs(covariance).max(axis=(1, 2))
    skew = np.abs(covariance - covariance.transpose(0, 2, 1)).max(axis=(1, 2))
    # Sums in single precision leave the two halves of a matrix equal to six digits only.
    wrong = np.flatnonzero(
        (skew > 1e-5 * size)
        | (size > MAX_COORDINATE**2)
        | (np.einsum("nii->ni", covariance).min(axis=1) < 0)
    )
    if len(wrong):
        raise InputError(
            f"{places[wrong[0]]}: the covariance must be symmetric, with variances "
            f"from 0 to {MAX_COORDINATE**2:g}"
        )


def poses_of_matrices(table: Float[Array, "n 12"], places: list[str]) -> Poses:
    """Make poses of the upper three rows of 4x4 matrices; the places are for messages."""
    matrices = table.reshape(-1, 3, 4)
    check_matrices(matrices, places)
    turns = Rotation.from_matrix(matrices[:, :, :3])
    return Poses(np.ascontiguousarray(matrices[:, :, 3]), turns)


def read_times(path: Path) -> Float[Array, "n"]:
    """Read the times [s] of scans, the first number of each row."""
    rows = _with_nanoseconds(split_rows(path), path)
    if not rows:
        raise InputError(f"{path}: holds no times")
    stamps = np.array([parse_numbers(words[:1], where)[0] for where, words in rows])
    _check_times(stamps, [where for where, _ in rows])
    return stamps


def _with_nanoseconds(
    rows: list[tuple[str, list[str]]], path: Path, column: int = 0
) -> list[tuple[str, list[str]]]:
    """Write out the leading zeros of nanoseconds, if the times in a column lack them."""
    times = [words[column] for _, words in rows if column < len(words)]
    if len(times) < len(rows) or not all(map(SINCE_1970.match, times)):
        return rows
    try:
        whole = with_nanoseconds(times)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return [
        (where, [*words[:column], time, *words[column + 1 :]])
        for (where, words), time in zip(rows, whole, strict=True)
    ]


def _check_times(stamps: Float[Array, "n"], places: list[str]) -> None:
    far = np.flatnonzero(np.abs(stamps) > MAX_TIME)
    if len(far):
        raise InputError(f"{places[far[0]]}: the time {stamps[far[0]]:g} is beyond {MAX_TIME:g}")


@dataclass(frozen=True, eq=False)
class Mount:
    """The pose of a sensor on the robot's body."""

    pose: Poses  # one pose, ``T_body_sensor``
    on_camera: bool = False  # whether the body is KITTI's camera, whose y axis points down


def read_mount(path: Path) -> Mount:
    """Read the pose of a sensor on the body whose poses are recorded.

    The file has one row, ``tx ty tz qx qy qz qw`` or a 3x4 matrix, or is KITTI's ``calib.txt``.
    """
    rows = split_rows(path)
    named = [(where, words[1:]) for where, words in rows if words[0] in MOUNT_KEYS]
    on_camera = len(named) == 1
    chosen = named if on_camera else rows
    if len(chosen) != 1 or len(chosen[0][1]) not in (7, KITTI):
        raise InputError(
            f"{path}: a mount is one row, tx ty tz qx qy qz qw or the 12 numbers of a 3x4 matrix, "
            f"or a calibration of KITTI's with a row {MOUNT_KEYS[0]}"
        )
    where, words = chosen[0]
    values = parse_numbers(words, where)
    if len(values) == KITTI:
        return Mount(poses_of_matrices(np.array([values]), [where]), on_camera)
    return Mount(Poses.of(make_pose(values, where)), on_camera)


def table_rows(path: Path, comments: tuple[str, ...] = ("#", "%")) -> list[tuple[str, list[str]]]:
    """Split a table with commas into cells, and name each row for messages."""
    if not path.exists():
        raise InputError(f"{path}: no such file")
    rows: list[tuple[str, list[str]]] = []
    reader = csv.reader(lines_of(read_text(path, LARGEST_TABLE)))
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells) and not cells[0].startswith(comments):
                rows.append((f"{path}, line {reader.line_num}", cells))
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: {error}") from None
    return rows
