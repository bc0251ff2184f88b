"""Plain arrays: NPY and NPZ, NumPy's own formats, and KITTI's scans.

NumPy's reader is not used: it parses the header as a Python expression, believes a shape before it
has looked at the size, and leaves what a shape does not cover unread. KITTI's scans are rows of x,
y, z and reflectance, all float32, without a header.
"""

import ast
import math
import re
from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TypeAlias, cast
from zipfile import ZipFile, ZipInfo

import numpy as np

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import CloudFormat, PointCloud, Points, as_floats, grows_too_much
from gpgrad_core.reading.files import (
    check_regular,
    open_regular,
    opened_archive,
    read_member,
    read_regular,
)
from gpgrad_core.reading.text import parse_count

MAGIC, ZIP_MAGIC = b"\x93NUMPY", b"PK\x03\x04"
LENGTH_BYTES = {1: 2, 2: 4, 3: 4}
"""How many bytes give the length of the header, by version."""
LARGEST_HEADER = 10_000
MOST_GROWTH = 30
"""Arrays of real numbers grow to at most some times their compressed size; zeros grow a
thousandfold."""
COMPACT = "points_compact.bin"
"""Name of GLIM's clouds: rows of x, y and z, all float32."""
OTHER_WIDTHS = (3, 5, 6, 7, 9, 10)
"""Numbers of a point in other programs' ``.bin``: nuScenes and Lyft have the ring as the fifth.
Multiples of four are found otherwise, because each point looks like some."""
LEAST_COMPARED, LEAST_SPREAD, MANY = 24, 128, 400
"""Of fewer numbers nothing can be said, nothing by spreads, or columns may be alike by chance."""
BLOCK, MOST_BLOCKS = 2520, 6
"""Numbers in a block, of which each width is a divisor, and about how many blocks are looked at."""
CLEARLY, NEARLY = 6.0, 0.8
"""A width explains the numbers better than four does if it does so by some standard deviations; of
such widths the first is taken that comes near the best, whose multiples are as good."""
MOST_UNLIKE, UNLIKE_IF_FEW, MOSTLY = 4.0, 6.0, 0.99
"""Ratio of the spreads of two columns of one thing, of many numbers and of few, and share of
numbers that make sense."""

Load: TypeAlias = Callable[[], NDArray[np.generic]]

_ITEM = re.compile(
    r"\s*'(?P<key>descr|fortran_order|shape)'\s*:\s*"
    r"(?P<value>'[^']{1,40}'|True|False|\([0-9,\s]{0,200}\)|\[.*\])\s*(?:,|(?=\}))"
)
REFLECTANCE = ("intensity", "reflectance")
"""Names of the fourth number of a point."""


def read_npy(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read an array of shape (n, 3), or a structured one with fields x, y and z."""
    data = read_regular(path)
    if data.startswith(ZIP_MAGIC):
        raise InputError(f"{path}: is an NPZ archive; rename it to .npz")
    array = _parse(data, f"{path}: is not a complete NPY file")
    numbers = {name: held for name in names if (held := _column(array, name)) is not None}
    return PointCloud(_check_points(array, str(path)), numbers=numbers)


def read_npz(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read the array ``points`` of an archive, or its only array of shape (n, 3)."""
    with opened_npz(path) as arrays:
        points = _points_of(arrays, path)
        numbers = {name: arrays[name]() for name in names if name in arrays}
    for name, array in numbers.items():
        if array.ndim != 1 or array.dtype.kind not in "fiu":
            raise InputError(
                f"{path}, array {name!r}: must be numbers of shape (n,), one for each point, "
                f"got {array.dtype} {array.shape}"
            )
    return PointCloud(points, numbers=numbers)


def _points_of(arrays: Mapping[str, Load], path: Path) -> Points:
    if "points" in arrays:
        return _check_points(arrays["points"](), f"{path}, array 'points'")
    held = {name: load() for name, load in arrays.items()}
    clouds = [points for array in held.values() if (points := _points_in(array)) is not None]
    if len(clouds) != 1:
        listed = ", ".join(f"{name} {array.shape}" for name, array in held.items()) or "nothing"
        raise InputError(
            f"{path}: needs an array 'points', or just one of shape (n, 3); it holds {listed}"
        )
    return clouds[0]


def unpacked_npz(path: Path) -> int:
    """The size of an archive's arrays, unpacked [bytes]."""
    with open_regular(path) as file, opened_archive(file, str(path), "NPZ file") as archive:
        return sum(member.file_size for member in archive.infolist())


def _parse(data: bytes, broken: str) -> NDArray[np.generic]:
    """Parse the content of an NPY file; an error message begins with ``broken``."""
    if not data.startswith(MAGIC) or len(data) < 12:
        raise InputError(f"{broken}: it does not begin as one, with the byte 0x93 and 'NUMPY'")
    width = LENGTH_BYTES.get(data[6])
    if width is None:
        raise InputError(f"{broken}: its version {data[6]} is not known")
    begin = 8 + width
    end = begin + int.from_bytes(data[8:begin], "little")
    if end > len(data) or end - begin > LARGEST_HEADER:
        raise InputError(f"{broken}: its header of {end - begin:,} bytes does not end")
    dtype, fortran, shape = _parse_header(data[begin:end].decode("latin-1"), broken)
    size = math.prod(shape) * dtype.itemsize
    if size != len(data) - end:
        raise InputError(
            f"{broken}: its header promises {dtype} {shape}, {size:,} bytes, but "
            f"{len(data) - end:,} follow"
        )
    if not size:
        return np.empty(shape, dtype)
    array = np.frombuffer(data, dtype, offset=end).reshape(shape, order="F" if fortran else "C")
    return array.copy()  # one that can be written to, unlike the file's bytes


def _parse_header(header: str, broken: str) -> tuple[np.dtype[np.generic], bool, tuple[int, ...]]:
    text = header.strip()
    items: dict[str, str] = {}
    position = 1
    while text.startswith("{") and (item := _ITEM.match(text, position)) is not None:
        if item["key"] in items:
            break
        items[item["key"]] = item["value"]
        position = item.end()
    if len(items) != 3 or text[position:].strip() != "}":
        raise InputError(f"{broken}: its header does not give descr, fortran_order and shape")
    descr, order, sizes = items["descr"], items["fortran_order"], items["shape"]
    if re.search(r"'[|<>=]?O", descr):
        raise InputError(
            f"{broken} of numbers: it holds {descr[:40]}; Python objects are never loaded, "
            "because loading them can run programs"
        )
    try:
        dtype = np.lib.format.descr_to_dtype(ast.literal_eval(descr))
    except (TypeError, ValueError, SyntaxError, MemoryError, RecursionError):
        raise InputError(f"{broken}: {descr} is not a type of numbers") from None
    shape = [parse_count(size.strip()) for size in sizes[1:-1].split(",") if size.strip()]
    counted = tuple(size for size in shape if size is not None)
    # Only a type of numbers has a fixed meaning: NumPy takes many words for types.
    if order not in ("True", "False") or not sizes.startswith("(") or len(counted) < len(shape):
        raise InputError(f"{broken}: its header gives the shape {sizes} and the order {order}")
    return dtype, order == "True", counted


@contextmanager
def opened_npz(path: Path) -> Generator[dict[str, Load]]:
    """Open an archive of arrays: each is loaded when it is called."""
    with open_regular(path) as file:
        if file.read(len(MAGIC)) == MAGIC:
            raise InputError(f"{path}: is a single NPY array; rename it to .npy")
        with opened_archive(file, str(path), "NPZ file") as archive:
            yield {
                member.filename.removesuffix(".npy"): partial(_load, archive, member, path)
                for member in archive.infolist()
                if member.filename.endswith(".npy")
            }


def _load(archive: ZipFile, member: ZipInfo, path: Path) -> NDArray[np.generic]:
    if grows_too_much(member.compress_size, member.file_size, MOST_GROWTH):
        raise InputError(
            f"{path}: {member.filename!r} would unpack from {member.compress_size:,} bytes to "
            f"{member.file_size:,}; numbers do not shrink to less than 1/{MOST_GROWTH}, "
            "so it is damaged"
        )
    data = read_member(archive, member, str(path))
    name = member.filename.removesuffix(".npy")
    return _parse(data, f"{path}, array {name!r}: is not a complete NPY file")


def _column(array: NDArray[np.generic], name: str) -> NDArray[np.generic] | None:
    """A named column of a structured array; None if there is none."""
    if name not in (array.dtype.names or ()):
        return None
    held = cast("Mapping[str, NDArray[np.generic]]", array)[name]
    return held.ravel() if held.shape == array.shape and held.dtype.kind in "fiu" else None


def _points_in(array: NDArray[np.generic]) -> Points | None:
    """The points of an array, plain or structured; None if it has none."""
    if array.dtype.names is None:
        shaped = array.ndim == 2 and array.shape[1] == 3 and array.dtype.kind in "fiu"
        return as_floats(array) if shaped else None
    columns = [column for name in "xyz" if (column := _column(array, name)) is not None]
    return as_floats(np.column_stack(columns)) if len(columns) == 3 else None


def _check_points(array: NDArray[np.generic], where: str) -> Points:
    points = _points_in(array)
    if points is None:
        raise InputError(
            f"{where}: points must be numbers of fields x, y and z, or of shape (n, 3), got "
            f"{array.dtype} {array.shape}"
        )
    return points


def read_kitti(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read a scan of x, y, z and `REFLECTANCE`; InputError if its size is not of whole rows."""
    size = path.stat().st_size
    if path.name == COMPACT:
        if size % 12:
            raise InputError(f"{path}: is cut short: {size:,} bytes are not a multiple of 12")
        return PointCloud(np.fromfile(check_regular(path), "<f4").reshape(-1, 3))
    numbers = np.fromfile(check_regular(path), "<f4")
    kind, what = "f4", "numbers"
    if size % 8 == 0 and _are_doubles(numbers):
        kind, what = "f8", "64-bit numbers"
        width = _other_width(numbers.view("<f8")) or (3 if size % 32 else 4)
    else:
        width = _other_width(numbers) if size % 4 == 0 else None
    if width is not None:
        raise InputError(
            f"{path}: seems to have {width} {what} a point, not KITTI's four x, y, z and "
            f"reflectance; save x, y and z as .npy: np.save('cloud.npy', np.fromfile(FILE, "
            f"'{kind}').reshape(-1, {width})[:, :3])"
        )
    if size % 16:
        raise InputError(
            f"{path}: is not a complete KITTI scan: {size:,} bytes are not a multiple of 16, the "
            "four float32 of a point"
        )
    rows = numbers.reshape(-1, 4)
    numbers = {name: rows[:, 3] for name in REFLECTANCE if name in names}
    return PointCloud(rows[:, :3], numbers=numbers)


def _other_width(numbers: NDArray[np.floating]) -> int | None:
    """Find how many numbers a point has if not four, or None: other columns tell them better."""
    if len(numbers) < LEAST_COMPARED:
        return None
    blocks = numbers[: len(numbers) // BLOCK * BLOCK].reshape(-1, BLOCK)
    some = blocks[:: len(blocks) // MOST_BLOCKS].ravel() if len(blocks) > MOST_BLOCKS else numbers
    four, _ = _mutual_information(some, 4)
    estimates = {
        width: _mutual_information(some, width)
        for width in OTHER_WIDTHS
        if len(numbers) % width == 0
    }
    better = {width: much for width, (much, by) in estimates.items() if much - four > CLEARLY * by}
    if better:
        return next(width for width in better if better[width] > NEARLY * max(better.values()))
    rows = (width for width in (8, 12) if len(numbers) % width == 0)
    return next((width for width in rows if _are_unlike(numbers, width)), None)


def _mutual_information(numbers: NDArray[np.floating], width: int) -> tuple[float, float]:
    """Estimate how much the column tells of a number if rows are so wide, and the deviation [nats].

    This is their mutual information. Numbers count by the quantiles between which they lie, so
    neither units nor points far away matter.
    """
    values = np.nan_to_num(numbers[: len(numbers) // width * width])
    count = int(np.clip(len(values) // 40, 3, 16))
    edges = np.quantile(values, np.linspace(0, 1, count + 1)[1:-1], method="nearest")
    rows = np.searchsorted(edges, values, "right")
    share = np.zeros((width, count))
    np.add.at(share, (np.arange(len(rows)) % width, rows), 1 / len(rows))
    expected = share.sum(axis=0) / width
    ratio = np.divide(share, expected, out=np.ones_like(share), where=share > 0)
    by_chance = (width - 1) * (count - 1) / (2 * len(rows))
    return float(np.sum(share * np.log(ratio))) - by_chance, (by_chance / len(rows)) ** 0.5


def _are_unlike(numbers: NDArray[np.floating], width: int) -> bool:
    """Whether every second or third row of four has other things in it, not other points."""
    if len(numbers) < LEAST_SPREAD:
        return False
    with np.errstate(all="ignore"):
        rows = numbers.reshape(-1, width // 4, 4)[:, :, :2].astype(np.float64)
        low, middle, high = np.nanpercentile(rows, [25, 50, 75], axis=0)
    spread, many = high - low, len(numbers) >= MANY
    least = spread.max(axis=0) / (MOST_UNLIKE if many else UNLIKE_IF_FEW)
    apart = many & (np.ptp(middle, axis=0) > spread.max(axis=0))
    return bool(np.any(apart | (spread.min(axis=0) < least)))


def _are_doubles(numbers: NDArray[np.float32]) -> bool:
    """Whether numbers of 64 bits make sense, but not their halves."""
    if len(numbers) < LEAST_COMPARED:
        return False
    with np.errstate(all="ignore"):
        sound = (
            np.mean((values == 0) | ((np.abs(values) > 1e-6) & (np.abs(values) < 1e8)))
            for values in (numbers, numbers.view("<f8"))
        )
        as_floats, as_doubles = sound
    return bool(as_floats < MOSTLY <= as_doubles)


KITTI = CloudFormat(".bin", "KITTI's rows of four 32-bit numbers", read_kitti)
NPY = CloudFormat(".npy", "an array of shape (n, 3), or with fields x, y, z", read_npy)
NPZ = CloudFormat(
    ".npz",
    "an array `points`, or the only one that is such as in `.npy`; `noise_std` and `range` if they "
    "are there",
    read_npz,
    submap_numbers=("noise_std", "range"),
    unpacked_bytes=unpacked_npz,
)
