"""What a reader of clouds is, what it returns, and the errors that all readers share."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError

SMALL = 16_000_000
"""Bytes that anything compressed may grow to."""
Points: TypeAlias = Float[NDArray[np.floating], "n 3"]


@dataclass(frozen=True, eq=False)
class PointCloud:
    """What a file holds of each of its points, NaN and all.

    Attributes:
        points: Positions (n, 3) [m], in the precision of the file.
        colors: Red, green and blue (n, 3) from 0 to 1; None if the file has none.
        numbers: Further numbers of each point (n,) by the names that the caller wants; those that
            the file does not have are missing.
    """

    points: Points
    colors: Points | None = None
    numbers: Mapping[str, NDArray[np.generic]] = field(
        default_factory=dict[str, NDArray[np.generic]]
    )


@dataclass(frozen=True)
class CloudFormat:
    """How the files of one ending are read.

    A module of this folder that has one is found by itself; see `CLOUD_FORMATS`.

    Attributes:
        ending: Of the files' names: a dot and lower-case letters.
        holds: What is read, as the guide's table of formats says it.
        read: Reads a file once; it takes the names of the further numbers that are wanted of
            each point. For a broken file it raises an `InputError` that names the file.
        submap_numbers: Which of the numbers become a submap's: ``noise_std``, the standard
            deviation of the height [m], and ``range``, the distance from the sensor [m]. Where
            programs use these names for something else, there are none.
        unpacked_bytes: Gives the bytes that a compressed file's points take in memory, without
            unpacking them; None if the format does not compress.
        example: A small, sound file, which the tests read and damage; empty if they make their own.
    """

    ending: str
    holds: str
    read: Callable[[Path, Collection[str]], PointCloud]
    submap_numbers: tuple[str, ...] = ()
    unpacked_bytes: Callable[[Path], int] | None = None
    example: bytes = b""


def grows_too_much(packed: int, unpacked: int, most: int) -> bool:
    """Whether numbers would grow to more than `most` times their packed size: only damaged do."""
    return unpacked > max(SMALL, most * packed)


def as_floats(columns: NDArray[np.generic]) -> NDArray[np.floating]:
    """Convert numbers to floats without loss: float32 stays, everything else becomes float64."""
    dtype = np.float32 if columns.dtype.kind == "f" and columns.dtype.itemsize == 4 else np.float64
    return columns.astype(dtype, copy=False)


def cut_short(path: Path, promised: int, held: int) -> InputError:
    """Make the error for a file with fewer points than its header says."""
    return InputError(
        f"{path}: is cut short: its header promises {promised:,} points, but the file ends after "
        f"{held:,}; copy or save it again"
    )


def check_size(path: Path, promised: int, length: int, held: int) -> None:
    """Refuse a file whose points take fewer bytes, or more, than the `length` of each says."""
    if held < promised * length:
        raise cut_short(path, promised, held // length)
    if held > promised * length:
        raise surplus(path, promised * length, held, "bytes of points")


def surplus(path: Path, promised: int, held: int, what: str) -> InputError:
    """Make the error for a file that holds more than its header says."""
    return InputError(
        f"{path}: holds more than its header says: {held:,} {what} instead of {promised:,}; "
        "save it again"
    )
