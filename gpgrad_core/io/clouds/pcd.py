"""PCD, the point cloud library's format: ascii, binary and binary_compressed.

Open3D's reader is not used: of a file that was cut short it silently drops the missing rows, or all
points if it is binary.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import (
    CloudFormat,
    PointCloud,
    as_floats,
    check_size,
    grows_too_much,
    surplus,
)
from gpgrad_core.io.clouds.tables import Columns, read_body
from gpgrad_core.reading.files import open_regular, read_regular
from gpgrad_core.reading.text import parse_count

KINDS = {"F": "f", "I": "i", "U": "u"}
SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}
MOST_GROWTH = 30
"""A compressed block of real points grows to at most some times its size; of zeros LZF makes 88
times as much."""
MOST_LINES = 100
"""Of a header; real ones have eleven."""
LARGEST_HEADER = 100_000
MOST_FIELDS, MOST_NUMBERS = 1000, 100_000
"""Fields of a point, and numbers of a field; a descriptor of 352 numbers is a real one."""
PADDING = "_"
LAYOUTS = ("ascii", "binary", "binary_compressed")


@dataclass(frozen=True)
class _PcdHeader:
    """What the header says, checked."""

    names: tuple[str, ...]  # of the fields; several may have one name
    types: tuple[str, ...]  # NumPy's types of the fields
    counts: tuple[int, ...]  # how many numbers each field has
    num_points: int
    layout: str  # one of `LAYOUTS`
    num_bytes: int  # of the header
    num_lines: int  # of the header

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Type of a point; its fields are numbered."""
        fields = zip(self.types, self.counts, strict=True)
        return np.dtype([(str(k), kind, (repeat,)) for k, (kind, repeat) in enumerate(fields)])

    def kind(self, name: str) -> np.dtype[np.number]:
        return np.dtype(self.types[self.names.index(name)])


def read_pcd(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read a PCD file; its ``rgb`` or ``rgba`` packs three bytes, declared perhaps as a float."""
    data = read_regular(path)
    header = _parse_header(data, path)
    for name in "xyz":
        if header.names.count(name) != 1:
            number = "no" if name not in header.names else "more than one"
            raise InputError(f"{path}: its FIELDS have {number} {name}")
    numbers = zip(header.names, header.counts, strict=True)
    single = {name for name, count in numbers if count == 1 and header.names.count(name) == 1}
    further = [name for name in names if name in single]
    packed = next((name for name in ("rgb", "rgba") if name in header.names), None)
    if packed is not None and header.kind(packed).itemsize != 4:
        packed = None
    columns = _read_fields(data, header, [*"xyz", *([packed] if packed else []), *further], path)
    points = np.column_stack([columns[name] for name in "xyz"])
    colors = None if packed is None else _unpacked_colors(columns[packed], header.kind(packed))
    return PointCloud(as_floats(points), colors, {name: columns[name] for name in further})


def _unpacked_colors(packed: NDArray[np.number], kind: np.dtype[np.number]) -> Float[Array, "n 3"]:
    if kind.kind == "f":
        packed = packed.astype(np.float32).view(np.uint32)
    # A text may hold anything; what is no whole number of four bytes has no colour.
    sound = np.isfinite(packed) & (np.abs(packed.astype(np.float64)) < 2.0**32)
    whole = np.where(sound, packed, 0).astype(np.int64) & 0xFFFFFF
    return np.column_stack([whole >> 16, (whole >> 8) & 0xFF, whole & 0xFF]) / 255.0


def unpacked_pcd(path: Path) -> int:
    """The size of a PCD file's points, unpacked [bytes]."""
    with open_regular(path) as file:
        header = _parse_header(file.read(LARGEST_HEADER), path)
    return header.num_points * header.dtype.itemsize


def _read_fields(
    data: bytes, header: _PcdHeader, fields: Sequence[str], path: Path
) -> dict[str, NDArray[np.number]]:
    """Read the first number of some fields of every point, by the fields' names."""
    columns = [header.names.index(name) for name in fields]
    count = header.num_points
    if header.layout == "ascii":
        starts = np.concatenate([[0], np.cumsum(header.counts)])
        layout = Columns(tuple(int(starts[column]) for column in columns), int(starts[-1]))
        body = data[header.num_bytes :]
        rows = read_body(body, count, layout, path, first_line=header.num_lines + 1)
        return dict(zip(fields, rows.T, strict=True))
    dtype = header.dtype
    if header.layout == "binary_compressed":
        values = _read_compressed(data[header.num_bytes :], dtype, columns, count, path)
        return dict(zip(fields, values, strict=True))
    available = len(data) - header.num_bytes
    check_size(path, count, dtype.itemsize, available)
    table = np.frombuffer(data, dtype, count, header.num_bytes) if count else np.empty(0, dtype)
    return {name: table[str(column)][:, 0] for name, column in zip(fields, columns, strict=True)}


def _read_compressed(
    body: bytes, dtype: np.dtype[np.void], columns: list[int], count: int, path: Path
) -> list[NDArray[np.number]]:
    """Read the layout that stores the values field by field, compressed by LZF."""
    if len(body) < 8:
        raise InputError(f"{path}: is cut short: its compressed points are missing")
    packed_size, size = (int(word) for word in np.frombuffer(body, "<u4", 2))
    if size != count * dtype.itemsize:
        raise InputError(
            f"{path}: its header promises {count * dtype.itemsize:,} bytes of points, "
            f"the compressed block {size:,}; save it again"
        )
    packed = body[8:]
    if len(packed) < packed_size:
        raise InputError(
            f"{path}: is cut short: it should hold {packed_size:,} bytes of compressed points, "
            f"but it holds {len(packed):,}; copy or save it again"
        )
    if len(packed) > packed_size:
        raise surplus(path, packed_size, len(packed), "bytes of compressed points")
    if grows_too_much(packed_size, size, MOST_GROWTH):
        raise InputError(
            f"{path}: its {packed_size:,} bytes of compressed points would unpack to {size:,}; "
            f"points do not shrink to less than 1/{MOST_GROWTH}, so it is damaged"
        )
    unpacked = decompress_lzf(packed, size)
    if len(unpacked) != size == packed_size:
        unpacked = packed  # writers store a block that does not shrink as it is
    if len(unpacked) != size:
        raise InputError(f"{path}: its compressed points are damaged; copy or save it again")
    values: list[NDArray[np.number]] = []
    for column in columns:
        offset = count * sum(dtype[k].itemsize for k in range(column))
        field, (repeat,) = dtype[column].subdtype or (dtype[column], (1,))
        flat = np.frombuffer(unpacked, field, count * repeat, offset) if count else np.empty(0)
        values.append(flat[::repeat])
    return values


def decompress_lzf(packed: bytes, size: int) -> bytes:
    """Undo LibLZF: runs of literal bytes, and copies of earlier ones; damage changes the length."""
    out = bytearray()
    position = 0
    try:
        while position < len(packed) and len(out) <= size:
            control = packed[position]
            position += 1
            if control < 32:  # a run of 1 to 32 literal bytes
                out += packed[position : position + control + 1]
                position += control + 1
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += packed[position]
                position += 1
            start = len(out) - ((control & 31) << 8) - packed[position] - 1
            position += 1
            if start < 0:
                return b""
            chunk = out[start : start + length]
            # A copy may overlap its own output; then its start repeats.
            out += (chunk * (length // len(chunk) + 1))[:length]
    except IndexError:
        return b""
    return bytes(out)


def _parse_header(data: bytes, path: Path) -> _PcdHeader:
    words: dict[str, list[str]] = {}
    position = number = 0
    while (end := data.find(b"\n", position, LARGEST_HEADER)) >= 0 and number < MOST_LINES:
        keyword, *rest = data[position:end].decode("latin-1").split() or ["#"]
        position = end + 1
        number += 1
        if keyword.startswith("#"):
            continue
        if keyword.upper() in words:
            raise InputError(f"{path}, line {number}: the header has {keyword!r} a second time")
        words[keyword.upper()] = rest
        if keyword.upper() == "DATA":
            return _checked(words, position, number, path)
    raise InputError(f"{path}: is not a complete PCD file: its header has no 'DATA' line")


def _checked(words: dict[str, list[str]], num_bytes: int, num_lines: int, path: Path) -> _PcdHeader:
    for keyword in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"):
        if not words.get(keyword):
            raise InputError(f"{path}: its PCD header has no {keyword!r} line")
    names = tuple(words["FIELDS"])
    words.setdefault("COUNT", ["1"] * len(names))
    for keyword in ("SIZE", "TYPE", "COUNT"):
        if len(words[keyword]) != len(names):
            raise InputError(f"{path}: its {keyword} line does not have {len(names)} entries")
    if len(names) > MOST_FIELDS:
        raise InputError(f"{path}: its FIELDS are {len(names):,}; {MOST_FIELDS} is the most")
    numbers = {
        keyword: [_whole(word, keyword, path) for word in words[keyword]]
        for keyword in ("SIZE", "COUNT", "POINTS", "WIDTH", "HEIGHT")
        if words.get(keyword)
    }
    if max(numbers["COUNT"]) > MOST_NUMBERS:
        raise InputError(f"{path}: each COUNT must be from 0 to {MOST_NUMBERS:,}")
    points = numbers["POINTS"][0]
    if "WIDTH" in numbers and "HEIGHT" in numbers:
        width, height = numbers["WIDTH"][0], numbers["HEIGHT"][0]
        if width * height != points:
            raise InputError(
                f"{path}: its header contradicts itself: WIDTH {width:,} times HEIGHT {height:,} "
                f"are not POINTS {points:,}"
            )
    layout = words["DATA"][0]
    if layout not in LAYOUTS:
        raise InputError(f"{path}: DATA {layout!r} is not one of {', '.join(LAYOUTS)}")
    fields = zip(names, words["TYPE"], numbers["SIZE"], numbers["COUNT"], strict=True)
    # Drivers name padding, whose bytes may be of no type of number, or none at all.
    held = [
        (name, "<u1", size * count)
        if name == PADDING and size <= 8 and layout != "ascii"
        else (name, _type(kind, size, path), count)
        for name, kind, size, count in fields
        if size * count
    ]
    if not held:
        raise InputError(f"{path}: each COUNT or SIZE of its PCD header is 0; it holds no points")
    names, types, counts = zip(*held, strict=True)
    return _PcdHeader(names, types, counts, points, layout, num_bytes, num_lines)


def _whole(word: str, keyword: str, path: Path) -> int:
    number = parse_count(word)
    if number is None:
        raise InputError(
            f"{path}: its {keyword} line holds something that is not a whole number of up to 18 "
            f"digits: {word[:40]!r}"
        )
    return number


def _type(kind: str, size: int, path: Path) -> str:
    letter = KINDS.get(kind, "")
    if size not in SIZES.get(letter, ()):
        raise InputError(f"{path}: TYPE {kind[:40]} of SIZE {size} is not a number type of PCD")
    return f"<{letter}{size}"


PCD = CloudFormat(".pcd", "x, y, z; colours", read_pcd, unpacked_bytes=unpacked_pcd)
