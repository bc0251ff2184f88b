"""LAS and LAZ, the formats of laser scanning.

LAZ is decompressed by lazrs, in a process of its own: for a damaged file it may abort, or never
return.
"""

import struct
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import (
    CloudFormat,
    PointCloud,
    check_size,
    grows_too_much,
    surplus,
)
from gpgrad_core.io.georeference import units_of_keys, units_of_system
from gpgrad_core.libraries import load_library
from gpgrad_core.reading.decoding import LAZ_HEAD, DecodingError, decode_apart
from gpgrad_core.reading.files import read_regular

LEAST_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point, by its format."""
LEAST_HEADERS = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Bytes of the header, by the minor version."""
FIELDS = {
    "intensity": (12, "<u2", 0xFFFF),
    "return_number": (14, "u1", 0x07),
    "classification": (15, "u1", 0x1F),
    "user_data": (17, "u1", 0xFF),
}
"""Where a number of a point begins, its type, and which of its bits count, in formats 0 to 5."""
FIELDS_FROM_6 = FIELDS | {"return_number": (14, "u1", 0x0F), "classification": (16, "u1", 0xFF)}
"""The same in formats 6 to 10 (ASPRS, LAS Specification 1.4)."""
LASZIP = (b"laszip encoded", 22204)
"""Owner and number of the record that describes the compression."""
TEXT, KEYS = (b"LASF_Projection", 2112), (b"LASF_Projection", 34735)
"""The same of those that name the coordinate system: well-known text, or keys of GeoTIFF."""
MOST_RECORDS = 100_000
MOST_GROWTH = 100
"""Real points grow to 4 to 30 times their compressed size."""


@dataclass(frozen=True, eq=False)
class _LasHeader:
    """What the header says, checked against the size of the file."""

    compressed: bool
    kind: int  # format of a point, from 0 to 10
    count: int  # number of points
    length: int  # bytes of a point
    begin: int  # where the points begin
    end: int  # where the points end; of compressed ones, the latest place
    scale: Float[Array, "3"]  # what the three whole numbers are multiplied by [m]
    offset: Float[Array, "3"]  # what is added then [m]
    low: Float[Array, "3"]  # least coordinates [m]; NaN if they are not given
    high: Float[Array, "3"]  # greatest coordinates [m]; NaN if they are not given
    laszip: bytes  # the record that describes the compression; empty if there is none


def read_las(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read the points of a LAS or LAZ file; `names` are those of `FIELDS` to read too."""
    data = read_regular(path)
    if path.suffix.lower() == ".laz":
        try:
            load_library("lazrs", "gpgrad[las]")
        except InputError as error:
            raise InputError(f"{path}: to read {path.suffix}, {error}") from None
    header = _parse_header(data, path)
    body = memoryview(data)[header.begin :]
    if header.compressed:
        body = memoryview(_decompressed(data, header, path))
    points = np.empty((0, 3))
    if header.count:
        points = _column(body, header, 0, "<3i4") * header.scale + header.offset
        _check_box(points, header, path)
    fields = FIELDS if header.kind < 6 else FIELDS_FROM_6
    further = {name: fields[name] for name in names if name in fields}
    numbers = {
        name: _column(body, header, start, kind) & bits
        for name, (start, kind, bits) in further.items()
    }
    return PointCloud(points, numbers=numbers)


def _column(body: memoryview, header: _LasHeader, start: int, kind: str) -> NDArray[np.integer]:
    """The values of all points at the byte offset `start`."""
    row = np.dtype(
        {"names": ["it"], "formats": [kind], "offsets": [start], "itemsize": header.length}
    )
    points = np.frombuffer(body, row, header.count) if header.count else np.empty(0, row)
    return points["it"]


def unpacked_las(path: Path) -> int:
    """The size of the points of a LAS or LAZ file, unpacked [bytes]."""
    header = _parse_header(read_regular(path), path)
    return header.count * header.length


def _broken(path: Path, reason: str) -> InputError:
    return InputError(f"{path}: is not a complete LAS file: {reason}; copy or save it again")


def _parse_header(data: bytes, path: Path) -> _LasHeader:
    minor = _version(data, path)
    least = LEAST_HEADERS[minor]
    size, begin, num_records = struct.unpack_from("<HII", data, 94)
    kind, length, count = struct.unpack_from("<BHI", data, 104)
    compressed, kind = bool(kind & 0xC0), kind & 0x3F
    if kind >= len(LEAST_LENGTHS) or length < LEAST_LENGTHS[kind]:
        raise _broken(path, f"a point of format {kind} cannot have {length} bytes")
    if minor == 4:
        legacy, (count,) = count, struct.unpack_from("<Q", data, 247)
        if legacy not in (0, count):
            raise _broken(path, f"its header gives two numbers of points, {legacy:,} and {count:,}")
    returns = struct.unpack_from("<15Q", data, 255) if minor == 4 else ()
    if max(sum(returns), sum(struct.unpack_from("<5I", data, 111))) > count:
        raise _broken(path, f"its header counts more returns than its {count:,} points")
    if size < least or begin > len(data):
        raise _broken(path, f"its points begin at byte {begin:,}, and it ends at {len(data):,}")
    records = _records(data, size, begin, num_records, path)
    end = _end_of_points(data, minor, begin, records, path)
    numbers = np.array(struct.unpack_from("<12d", data, 131))
    scale, offset, box = numbers[:3], numbers[3:6], numbers[6:].reshape(3, 2)
    if not (np.isfinite(numbers[:6]).all() and (scale > 0).all()):
        raise _broken(path, "its scales and offsets must be finite, and the scales above 0")
    # Some programs leave the box at zero.
    high, low = box.T if np.isfinite(box).all() and box.any() else np.full((2, 3), np.nan)
    unit = _units(records, path)
    if not compressed:
        check_size(path, count, length, end - begin)
    elif grows_too_much(end - begin, count * length, MOST_GROWTH):
        raise _broken(
            path, f"its {end - begin:,} compressed bytes cannot be the {count:,} points promised"
        )
    scale, offset, low, high = (one * unit for one in (scale, offset, low, high))
    laszip = records.get(LASZIP, b"")
    return _LasHeader(compressed, kind, count, length, begin, end, scale, offset, low, high, laszip)


def _units(records: dict[tuple[bytes, int], bytes], path: Path) -> Float[Array, "3"]:
    """The units of x, y and z [m]; a map without an axis of heights has them in its unit."""
    text = records.get(TEXT, b"").rstrip(b"\0 ").decode("utf-8", "replace")
    try:
        flat, height = units_of_system(text) if text else units_of_keys(records.get(KEYS, b""))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    flat = 1.0 if flat is None else flat
    return np.array([flat, flat, flat if height is None else height])


def _version(data: bytes, path: Path) -> int:
    """The minor version; the file is as long as its header, or longer."""
    if data[:4] != b"LASF":
        raise _broken(path, "it does not begin with 'LASF'")
    major, minor = data[24:26] if len(data) > 25 else (0, 0)
    if major != 1 or minor not in LEAST_HEADERS:
        raise _broken(path, "it is not of version 1.0 to 1.4")
    if len(data) < LEAST_HEADERS[minor]:
        raise _broken(path, f"its header has {LEAST_HEADERS[minor]} bytes, the file {len(data):,}")
    return minor


def _records(
    data: bytes, position: int, begin: int, count: int, path: Path
) -> dict[tuple[bytes, int], bytes]:
    """Walk the records before the points; give their contents by owner and number."""
    records: dict[tuple[bytes, int], bytes] = {}
    if count > MOST_RECORDS:
        raise _broken(path, f"its header promises {count:,} records")
    for _ in range(count):
        if position + 54 > begin:
            raise _broken(path, f"its header promises {count:,} records before the points")
        owner, number, length = struct.unpack_from("<2x16sHH", data, position)
        position += 54 + length
        if position > begin:
            raise _broken(path, "a record reaches into the points")
        records[owner.rstrip(b"\0"), number] = data[position - length : position]
    return records


def _end_of_points(
    data: bytes, minor: int, begin: int, records: dict[tuple[bytes, int], bytes], path: Path
) -> int:
    """Find where the points end: at the end of the file, or where further records follow them."""
    waveforms = struct.unpack_from("<Q", data, 227)[0] if minor >= 3 else 0
    start, count = struct.unpack_from("<QI", data, 235) if minor == 4 else (0, 0)
    end = len(data)
    if count:
        if not begin <= start <= len(data) or count > MOST_RECORDS:
            raise _broken(path, f"its {count:,} last records would begin at byte {start:,}")
        position = end = int(start)
        for _ in range(count):
            if position + 60 > len(data):
                raise _broken(path, f"it does not hold the {count:,} records after the points")
            owner, number, length = struct.unpack_from("<2x16sHQ", data, position)
            position += 60 + length
            records[owner.rstrip(b"\0"), number] = data[position - length : position]
        if position != len(data):
            raise surplus(path, position, len(data), "bytes")
    # Waveforms may lie in the file, as a record of their own, or in a file beside it.
    return int(waveforms) if begin <= waveforms < end and waveforms else end


def _decompressed(data: bytes, header: _LasHeader, path: Path) -> bytes:
    if not header.laszip:
        raise _broken(path, "it has no record that describes its compression")
    if not header.count:
        return b""
    load_library("lazrs", "gpgrad[las]")  # a .las may be compressed too
    size = header.count * header.length
    # The points come with a table of their chunks, which lies after them.
    head = LAZ_HEAD.pack(size, len(header.laszip))
    packed = head + header.laszip + _with_table(data, header, path)
    try:
        points = decode_apart("laz", packed, size)
    except DecodingError as error:
        raise _broken(path, str(error)) from None
    if len(points) != size:
        raise _broken(path, f"{len(points):,} bytes of points instead of {size:,}")
    return points


def _with_table(data: bytes, header: _LasHeader, path: Path) -> bytes:
    """The compressed points, whose first eight bytes are the position of their chunks' table."""
    body = data[header.begin : header.end]
    if len(body) < 16:
        raise _broken(path, "its compressed points are missing")
    (table,) = struct.unpack_from("<q", body)
    if table == -1:  # a writer that could not go back put it at the end
        (table,) = struct.unpack_from("<q", body, len(body) - 8)
    place = table - header.begin  # it was counted from the file's beginning
    if not 8 <= place <= len(body) - 8:
        raise _broken(path, f"the table of its chunks would begin at byte {table:,}")
    return struct.pack("<q", place) + body[8:]


def _check_box(points: Float[Array, "n 3"], header: _LasHeader, path: Path) -> None:
    # Programs round the box; a step or a millionth of its size is no damage.
    slack = 2 * header.scale + 1e-6 * np.abs(header.high - header.low)
    low, high = points.min(axis=0), points.max(axis=0)
    if (low < header.low - slack).any() or (high > header.high + slack).any():
        raise InputError(
            f"{path}: its points reach from {_metres(low)} to {_metres(high)} m, but its header "
            f"says from {_metres(header.low)} to {_metres(header.high)} m; save it again"
        )


def _metres(position: Float[Array, "3"]) -> str:
    return ", ".join(f"{value:,.3f}" for value in position)


LAS = CloudFormat(".las", "x, y, z", read_las, unpacked_bytes=unpacked_las)
LAZ = CloudFormat(
    ".laz",
    "x, y, z; needs the extra `las`: `pip install 'gpgrad[las]'`",
    read_las,
    unpacked_bytes=unpacked_las,
)
