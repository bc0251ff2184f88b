"""PLY, the cloud format that every tool writes.

Open3D's reader is not used: Open3D 0.20 returns zeros for the points that a cut file lacks. trimesh
refuses such a file, but does not say how much is missing.
"""

import shutil
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.io.clouds.format import CloudFormat, PointCloud, as_floats, cut_short, surplus
from gpgrad_core.io.clouds.tables import Columns, read_body
from gpgrad_core.reading.files import read_regular
from gpgrad_core.reading.text import parse_count

BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
SCALARS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
RGB = ("red", "green", "blue")
MAX_FLOAT32_EXTENT = 1000.0
"""Coordinates beyond this [m] are written as doubles: there float32 has steps of 0.06 mm."""


LARGEST_HEADER = 1_000_000
"""Bytes; real headers have a thousandth."""
FACE_LISTS = ("vertex_indices", "vertex_index")
MOST_PROPERTIES = 1000
"""Of an element; real ones have some tens."""


@dataclass(frozen=True)
class _Property:
    """A number of each row, or a list of numbers, whose length comes first."""

    name: str
    kind: str  # NumPy's type of the number, or of a list's numbers
    length: str = ""  # NumPy's type of a list's length; "" if it is no list


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def has_list(self) -> bool:
        return any(item.length for item in self.properties)

    def is_corners(self, item: _Property) -> bool:
        """Whether a list has the numbers of points."""
        return item.name in FACE_LISTS and self.name != "vertex"

    def dtype(self, byte_order: str, lengths: Sequence[int] = ()) -> np.dtype[np.void]:
        """Type of a row, given the lengths of its lists; without them, as if all were empty."""
        # The fields are numbered, because two properties may have the same name.
        left = iter(lengths or [0] * len(self.properties))
        fields: list[tuple[str, str] | tuple[str, str, tuple[int, ...]]] = []
        for k, item in enumerate(self.properties):
            if item.length:
                fields.append((f"length {k}", byte_order + item.length))
            shape = (next(left),) if item.length else ()
            fields.append((str(k), byte_order + item.kind, shape))
        return np.dtype(fields)


_Run: TypeAlias = tuple[np.dtype[np.void], int, int]
"""The type of some rows that are alike, where they begin and how many they are."""


@dataclass(frozen=True)
class _PlyHeader:
    layout: str
    elements: tuple[_Element, ...]
    num_bytes: int
    num_lines: int

    def vertex(self, path: Path) -> _Element:
        for element in self.elements:
            if element.name == "vertex":
                return element
        raise InputError(f"{path}: its header has no 'element vertex'; it holds no points")


def read_ply(path: Path, names: Collection[str] = ()) -> PointCloud:
    """Read the vertices of a PLY file, ascii or binary of either byte order."""
    data = read_regular(path)
    header = _parse_header(data, path)
    kinds = {item.name: item.kind for item in header.vertex(path).properties if not item.length}
    rgb = RGB if all(name in kinds for name in RGB) else ()
    further = [name for name in names if name in kinds]
    columns = _read_vertices(data, header, [*"xyz", *rgb, *further], path)
    colors = None
    if rgb:
        colors = np.column_stack([columns[name] for name in RGB]).astype(np.float64)
        if np.dtype(kinds["red"]).kind in "iu":
            colors /= np.iinfo(kinds["red"]).max
    points = np.column_stack([columns[name] for name in "xyz"])
    return PointCloud(as_floats(points), colors, {name: columns[name] for name in further})


def _read_vertices(
    data: bytes, header: _PlyHeader, properties: Sequence[str], path: Path
) -> dict[str, NDArray[np.number]]:
    """Read some properties of every vertex, by their names."""
    vertex = header.vertex(path)
    columns = _columns(vertex, properties, path)
    if header.layout != "ascii":
        values = _read_binary(data, header, vertex, columns, path)
        return dict(zip(properties, values, strict=True))
    if any(item.length for item in vertex.properties[: max(columns)]):
        names = ", ".join(properties)
        raise InputError(f"{path}: {names} must come before all list properties of a vertex")
    place = header.elements.index(vertex)
    # An element without properties has no rows.
    counts = [element.count if element.properties else 0 for element in header.elements]
    body = read_body(
        data[header.num_bytes :],
        vertex.count,
        Columns(columns, None if vertex.has_list else len(vertex.properties)),
        path,
        before=sum(counts[:place]),
        after=sum(counts[place + 1 :]),
        first_line=header.num_lines + 1,
    )
    return dict(zip(properties, body.T, strict=True))


def _read_binary(
    data: bytes, header: _PlyHeader, vertex: _Element, columns: Sequence[int], path: Path
) -> list[NDArray[np.number]]:
    """Read some numbers of every vertex; the file must end where its last element ends.

    The corners of faces must be points: by chance, the lengths of their lists may fit elsewhere.
    """
    order, position = BYTE_ORDERS[header.layout], header.num_bytes
    values: list[NDArray[np.number]] = []
    for element in header.elements:
        runs = _runs(data, position, element, order, vertex.count)
        if runs is None and element is vertex and not vertex.has_list:
            available = max(0, len(data) - position) // vertex.dtype(order).itemsize
            raise cut_short(path, vertex.count, available)
        if runs is None:
            raise InputError(
                f"{path}: is cut short or damaged: it does not hold {element.count:,} rows of "
                f"'element {element.name}'; copy or save it again"
            )
        if element is vertex:
            values = [np.empty(vertex.count, vertex.properties[column].kind) for column in columns]
        first = 0
        for dtype, start, count in runs:
            if element is vertex:
                rows = np.frombuffer(data, dtype, count, start)
                for column, into in zip(columns, values, strict=True):
                    into[first : first + count] = rows[str(column)]
            first, position = first + count, start + count * dtype.itemsize
    if position < len(data):
        raise surplus(path, position, len(data), "bytes")
    return values


def _runs(
    data: bytes, start: int, element: _Element, order: str, num_points: int
) -> list[_Run] | None:
    """Find the rows of an element; None if they reach beyond the file, or cannot be its rows."""
    if start + element.count * element.dtype(order).itemsize > len(data):
        return None
    if not element.count:
        return []
    if not element.has_list:
        return [(element.dtype(order), start, element.count)]
    lengths = _list_lengths(data, start, element, order, num_points)
    if lengths is not None:
        # Nearly always, all lists are as long as the first one: a mesh of triangles.
        dtype = element.dtype(order, lengths)
        if start + element.count * dtype.itemsize <= len(data):
            rows = np.frombuffer(data, dtype, element.count, start)
            lists = [k for k, item in enumerate(element.properties) if item.length]
            same = zip(lists, lengths, strict=True)
            if all(np.all(rows[f"length {k}"] == length) for k, length in same):
                corners = [k for k in lists if element.is_corners(element.properties[k])]
                right = all(_are_indices(rows[str(k)], num_points) for k in corners)
                return [(dtype, start, element.count)] if right else None
    runs: list[_Run] = []
    dtypes: dict[tuple[int, ...], np.dtype[np.void]] = {}
    for _ in range(element.count):
        lengths = _list_lengths(data, start, element, order, num_points)
        if lengths is None:
            return None
        if lengths not in dtypes:
            dtypes[lengths] = element.dtype(order, lengths)
        runs.append((dtypes[lengths], start, 1))
        start += dtypes[lengths].itemsize
    return runs


def _are_indices(corners: NDArray[np.number], num_points: int) -> bool:
    return bool(np.all((corners >= 0) & (corners < num_points)))


def _list_lengths(
    data: bytes, position: int, element: _Element, order: str, num_points: int
) -> tuple[int, ...] | None:
    """Read the lengths of the lists of a row; None if it cannot be a row."""
    lengths: list[int] = []
    for item in element.properties:
        size, times = np.dtype(item.kind).itemsize, 1
        if item.length:
            width = np.dtype(item.length).itemsize
            if position + width > len(data):
                return None
            signed = item.length.startswith("i")
            little = "little" if order == "<" else "big"
            times = int.from_bytes(data[position : position + width], little, signed=signed)
            if times < (1 if element.is_corners(item) else 0):  # a face of no corner is none
                return None
            lengths.append(times)
            position += width
        position += times * size
        if position > len(data):
            return None
        if item.length and element.is_corners(item):
            corners = np.frombuffer(data, order + item.kind, times, position - times * size)
            if not _are_indices(corners, num_points):
                return None
    return tuple(lengths)


def _parse_header(data: bytes, path: Path) -> _PlyHeader:
    if not data.startswith(b"ply"):
        raise InputError(f"{path}: is not a PLY file: it does not start with 'ply'")
    layout = ""
    elements: list[_Element] = []
    position = number = 0
    while (end := data.find(b"\n", position, LARGEST_HEADER)) >= 0:
        words = data[position:end].decode("latin-1").split()
        position = end + 1
        number += 1
        where = f"{path}, line {number}"
        match words:
            case ["end_header"]:
                if not layout:
                    raise InputError(f"{path}: its header has no 'format' line")
                return _PlyHeader(layout, tuple(elements), position, number)
            case ["format", name, *_] if not layout:
                if name not in BYTE_ORDERS:
                    raise InputError(
                        f"{where}: format {name!r} is not one of {', '.join(BYTE_ORDERS)}"
                    )
                layout = name
            case ["element", name, word] if (count := parse_count(word)) is not None:
                if any(element.name == name for element in elements):
                    raise InputError(f"{where}: names 'element {name}' a second time")
                elements.append(_Element(name, count, ()))
            case ["property", "list", length, kind, name] if elements and _is_length(length, kind):
                item = _Property(name, SCALARS[kind], SCALARS[length])
                elements[-1] = _with_property(elements[-1], item, where)
            case ["property", kind, name] if elements and kind in SCALARS:
                item = _Property(name, SCALARS[kind])
                elements[-1] = _with_property(elements[-1], item, where)
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise InputError(f"{where}: {' '.join(words)[:60]!r} is not a line of a PLY header")
    raise InputError(f"{path}: is cut short: its header has no 'end_header'; copy or save it again")


def _is_length(length: str, kind: str) -> bool:
    return SCALARS.get(length, "f")[0] in "iu" and kind in SCALARS


def _with_property(element: _Element, item: _Property, where: str) -> _Element:
    if len(element.properties) == MOST_PROPERTIES:
        raise InputError(f"{where}: 'element {element.name}' has over {MOST_PROPERTIES} properties")
    return _Element(element.name, element.count, (*element.properties, item))


def _columns(vertex: _Element, required: Sequence[str], path: Path) -> tuple[int, ...]:
    names = [None if item.length else item.name for item in vertex.properties]
    missing = [name for name in required if name not in names]
    if missing:
        raise InputError(f"{path}: its vertices have no property {' or '.join(missing)}")
    twice = [name for name in required if names.count(name) > 1]
    if twice:
        raise InputError(f"{path}: its vertices have the property {twice[0]} twice")
    return tuple(names.index(name) for name in required)


def write_ply(
    path: Path,
    points: Float[Array, "n 3"],
    colors: Float[Array, "n 3"] | None = None,
    extras: Mapping[str, Float[Array, "n"]] | None = None,
) -> None:
    """Write a binary PLY, in float32 where that is precise to a tenth of a millimetre."""
    extras = extras or {}
    wide = bool(len(points)) and float(np.abs(points).max()) > MAX_FLOAT32_EXTENT
    kind, dtype = ("double", "<f8") if wide else ("float", "<f4")
    further = [f"uchar {name}" for name in RGB if colors is not None]
    further += [f"float {name}" for name in extras]
    columns = [points.astype(dtype)]
    if colors is not None:
        columns.append(np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8))
    columns += [values.astype("<f4")[:, None] for values in extras.values()]
    rows = [np.ascontiguousarray(column).view(np.uint8) for column in columns]
    path.write_bytes(_header(len(points), kind, further) + np.hstack(rows).tobytes())


def _header(count: int, kind: str, further: Iterable[str] = ()) -> bytes:
    properties = [*(f"{kind} {name}" for name in "xyz"), *further]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [*(f"property {one}" for one in properties), "end_header\n"]
    return "\n".join(lines).encode("ascii")


def write_ply_pieces(path: Path, pieces: Iterable[Float[Array, "n 3"]]) -> int:
    """Write points piece by piece as a little-endian binary PLY of doubles; gives their number."""
    count = 0
    with tempfile.TemporaryFile(dir=path.parent) as body:
        for piece in pieces:
            body.write(np.ascontiguousarray(piece, dtype="<f8").tobytes())
            count += len(piece)
        body.seek(0)
        with path.open("wb") as file:
            file.write(_header(count, "double"))
            shutil.copyfileobj(body, file)
    return count


PLY = CloudFormat(
    ".ply",
    "x, y, z; colours; `noise_std` and `range` of each point if they are there",
    read_ply,
    submap_numbers=("noise_std", "range"),
)
