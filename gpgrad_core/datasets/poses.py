"""Pose files: TUM rows ``index tx ty tz qx qy qz qw``, ``p_world = R p_submap + t``."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gpgrad_core.datasets.tables import read_text
from gpgrad_core.errors import InputError
from gpgrad_core.types import Pose

QUATERNION_TOLERANCE = 0.01
"""A length further from 1 than this is no rounding: columns are swapped or missing."""


def read_poses(path: Path, known: Mapping[int, str]) -> dict[int, Pose]:
    """Read the poses of submaps.

    Args:
        path: The file; ``#`` starts a comment.
        known: Names of the submaps that there are, by index.

    Returns:
        Poses by index; not every submap needs one.

    Raises:
        InputError: If a row is not eight numbers, its quaternion is not of unit length, its
            submap does not exist, or the submap was named before; names the line.
    """
    poses: dict[int, Pose] = {}
    lines_of: dict[int, int] = {}
    for number, line in enumerate(read_text(path), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        where = f"{path}, line {number}"
        index, pose = _parse_row(words, where)
        if index not in known:
            raise InputError(f"{where}: names submap {index}, which the dataset does not have")
        if index in poses:
            raise InputError(
                f"{where}: names submap {index} a second time, after line {lines_of[index]}"
            )
        poses[index], lines_of[index] = pose, number
    return poses


def _parse_row(words: list[str], where: str) -> tuple[int, Pose]:
    if len(words) != 8:
        raise InputError(
            f"{where}: has {len(words)} columns, a pose needs 8: index tx ty tz qx qy qz qw"
        )
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise InputError(f"{where}: holds something that is not a number") from None
    if not np.isfinite(values).all():
        raise InputError(f"{where}: holds a value that is not finite")
    if not values[0].is_integer():
        raise InputError(f"{where}: the index must be a whole number, got {words[0]}")
    quaternion = np.array(values[4:])
    length = float(np.linalg.norm(quaternion))
    if abs(length - 1.0) > QUATERNION_TOLERANCE:
        raise InputError(
            f"{where}: the quaternion qx qy qz qw must have length 1, this one has {length:.3g}"
        )
    return int(values[0]), Pose(np.array(values[1:4]), quaternion / length)


def write_poses(path: Path, poses: Mapping[int, Pose]) -> None:
    """Write poses as rows of a pose file, to a micrometre and nine digits of quaternion.

    Args:
        path: The file; overwritten if it exists.
        poses: By index.
    """
    rows = ["# index tx ty tz qx qy qz qw   (p_world = R p_submap + t)"]
    for index, pose in poses.items():
        translation = " ".join(f"{value:.6f}" for value in pose.translation)
        quaternion = " ".join(f"{value:.9f}" for value in pose.quaternion)
        rows.append(f"{index} {translation} {quaternion}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")
