"""Pose files: TUM rows ``index tx ty tz qx qy qz qw``, ``p_world = R p_submap + t``."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array
from gpgrad_core.datasets.tables import write_lines
from gpgrad_core.errors import InputError
from gpgrad_core.reading.text import (
    COMMA_HINT,
    DECIMAL_COMMA,
    lines_of,
    parse_number,
    read_text,
)
from gpgrad_core.se2 import Pose
from gpgrad_core.types import MAX_COORDINATE

QUATERNION_TOLERANCE = 0.01
"""A length further from 1 than this is not a rounded one: columns are swapped or missing."""


def read_poses(path: Path, known: Mapping[int, str]) -> dict[int, Pose]:
    """Read the poses of submaps.

    Args:
        path: The file; ``#`` starts a comment.
        known: Names of the existing submaps, by index.

    Returns:
        Poses by index; not every submap needs one.

    Raises:
        InputError: If a row is not eight numbers, its quaternion is not of unit length, its
            submap does not exist, or an earlier row names the same submap; the message names the
            line.
    """
    return {
        index: make_pose(values, where)
        for index, values, where in _rows(
            path, known, 7, "a pose needs 8: index tx ty tz qx qy qz qw"
        )
    }


def read_positions(path: Path, known: Mapping[int, str]) -> dict[int, Float[Array, "3"]]:
    """Read the positions of submaps, rows ``index x y z`` [m].

    Args:
        path: The file; ``#`` starts a comment.
        known: Names of the existing submaps, by index.

    Returns:
        Positions (3,) by index; not every submap needs one.

    Raises:
        InputError: If a row is not four numbers, a position is beyond `MAX_COORDINATE`, its submap
            does not exist, or an earlier row names the same submap; the message names the line.
    """
    positions: dict[int, Float[Array, 3]] = {}
    for index, values, where in _rows(path, known, 3, "a position needs 4: index x y z"):
        check_position(values, where)
        positions[index] = np.array(values)
    return positions


def _rows(
    path: Path, known: Mapping[int, str], width: int, needs: str
) -> Iterator[tuple[int, list[float], str]]:
    """Give the index, the further numbers and the place of each row."""
    named_at: dict[int, int] = {}
    for number, line in enumerate(lines_of(read_text(path)), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        where = f"{path}, line {number}"
        if len(words) != width + 1:
            raise InputError(f"{where}: has {len(words)} columns, but {needs}")
        values = parse_numbers(words, where)
        if not values[0].is_integer():
            raise InputError(f"{where}: the index must be a whole number, got {words[0]}")
        index = int(values[0])
        if index not in known:
            raise InputError(f"{where}: names submap {index}, which the dataset does not have")
        if index in named_at:
            raise InputError(
                f"{where}: names submap {index} a second time, after line {named_at[index]}"
            )
        named_at[index] = number
        yield index, values[1:], where


def parse_numbers(words: list[str], where: str) -> list[float]:
    """Parse the columns of a row.

    Raises:
        InputError: If one is not a number or not finite; the message begins with `where`.
    """
    values: list[float] = []
    for word in words:
        value = parse_number(word)
        if value is None:
            hint = f"; {COMMA_HINT}" if DECIMAL_COMMA.fullmatch(word) else ""
            raise InputError(f"{where}: holds something that is not a number: {word[:40]!r}{hint}")
        values.append(value)
    if not np.isfinite(values).all():
        raise InputError(f"{where}: holds a value that is not finite")
    return values


def make_pose(values: list[float], where: str) -> Pose:
    """Make a pose of ``tx ty tz qx qy qz qw``.

    Raises:
        InputError: If the quaternion is not of unit length, or the position is beyond
            `MAX_COORDINATE`; the message begins with `where`.
    """
    check_position(values[:3], where)
    quaternion = np.array(values[3:])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: the quaternion qx qy qz qw must have length 1, this one has {length:.3g}"
        )
    return Pose(np.array(values[:3]), quaternion / length)


def check_position(values: list[float], where: str) -> None:
    """Refuse a position that is beyond `MAX_COORDINATE`.

    Raises:
        InputError: If it is; the message begins with `where`.
    """
    if not max(map(abs, values)) <= MAX_COORDINATE:
        raise InputError(
            f"{where}: the position tx ty tz is further from the origin than {MAX_COORDINATE:g} m"
        )


def write_positions(path: Path, positions: Mapping[int, Float[Array, "3"]]) -> None:
    """Write positions as rows ``index x y z`` [m], to a micrometre.

    Args:
        path: The file; it is overwritten if it exists.
        positions: Positions by index.
    """
    rows = ["# index x y z   (position of the submap's origin in the world)"]
    for index, position in positions.items():
        rows.append(" ".join([f"{index}", *(f"{value:.6f}" for value in position)]))
    write_lines(path, rows)


def write_poses(path: Path, poses: Mapping[int, Pose]) -> None:
    """Write poses as the rows of a pose file; see `pose_row`.

    Args:
        path: The file; it is overwritten if it exists.
        poses: Poses by index.
    """
    rows = ["# index tx ty tz qx qy qz qw   (p_world = R p_submap + t)"]
    rows += [pose_row(str(index), pose) for index, pose in poses.items()]
    write_lines(path, rows)


def pose_row(key: str, pose: Pose) -> str:
    """Format a pose as a TUM row.

    Args:
        key: Index or time of the pose.
        pose: The pose; it is written to a micrometre and nine decimals of the quaternion.
    """
    translation = " ".join(f"{value:.6f}" for value in pose.translation)
    quaternion = " ".join(f"{value:.9f}" for value in pose.quaternion)
    return f"{key} {translation} {quaternion}"
