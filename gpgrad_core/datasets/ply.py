"""PLY, the cloud format that every tool writes.

Open3D's reader is not used: for a file that was cut short, Open3D 0.20 prints a warning and
returns zeros for the missing points. trimesh refuses such a file, but does not say how much is
missing. After a check of the number of points in the header, NumPy reads the rest in one call.
"""

import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import Array, NDArray
from gpgrad_core.datasets.tables import as_floats, cut_short, read_body
from gpgrad_core.errors import InputError

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


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[tuple[str, str], ...]  # (name, NumPy type; "" for a list)

    @property
    def has_list(self) -> bool:
        return any(not kind for _, kind in self.properties)

    def dtype(self, byte_order: str) -> np.dtype[np.void]:
        # The fields are numbered, because two properties may have the same name.
        return np.dtype(
            [(str(k), byte_order + kind) for k, (_, kind) in enumerate(self.properties)]
        )


@dataclass(frozen=True)
class _Header:
    layout: str
    elements: tuple[_Element, ...]
    num_bytes: int
    num_lines: int

    def vertex(self, path: Path) -> _Element:
        for element in self.elements:
            if element.name == "vertex":
                return element
        raise InputError(f"{path}: its header has no 'element vertex'; it holds no points")


def read_ply(path: Path) -> Float[NDArray[np.floating], "n 3"]:
    """Read the vertices of a PLY file, ascii or binary of either byte order.

    Args:
        path: The file.

    Returns:
        Positions [m], float32 if they are float32 in the file, otherwise float64.

    Raises:
        InputError: If it is not a PLY file, has no x, y and z, or ends too early.
    """
    data = path.read_bytes()
    header = _parse_header(data, path)
    return as_floats(_read_vertices(data, header, "xyz", path))


def read_ply_colors(path: Path) -> Float[Array, "n 3"] | None:
    """Read the vertices' red, green and blue in [0, 1]; None if they have none.

    Whole numbers are divided by the largest number of their type; floats are not changed.

    Raises:
        InputError: See `read_ply`.
    """
    data = path.read_bytes()
    header = _parse_header(data, path)
    kinds = dict(header.vertex(path).properties)
    if not all(kinds.get(name) for name in RGB):
        return None
    colors = _read_vertices(data, header, RGB, path).astype(np.float64)
    whole = np.dtype(kinds["red"]).kind in "iu"
    return colors / np.iinfo(kinds["red"]).max if whole else colors


def read_ply_property(path: Path, name: str) -> Float[Array, "n"] | None:
    """Read one number of each vertex, such as its ``noise_std`` [m]; None if they have none.

    Raises:
        InputError: See `read_ply`.
    """
    data = path.read_bytes()
    header = _parse_header(data, path)
    if not dict(header.vertex(path).properties).get(name):
        return None
    return _read_vertices(data, header, (name,), path).astype(np.float64).ravel()


def _read_vertices(
    data: bytes, header: _Header, properties: Sequence[str], path: Path
) -> NDArray[Any]:
    vertex = header.vertex(path)
    before = header.elements[: header.elements.index(vertex)]
    columns = _columns(vertex, properties, path)
    if header.layout == "ascii":
        if any(not kind for _, kind in vertex.properties[: max(columns)]):
            wanted = ", ".join(properties)
            raise InputError(f"{path}: {wanted} must come before all list properties of a vertex")
        text = data[header.num_bytes :].decode("latin-1")
        skipped = sum(element.count for element in before)
        return read_body(
            text, vertex.count, columns, path, skipped=skipped, first_line=header.num_lines + 1
        )
    for element in (*before, vertex):
        if element.has_list:
            raise InputError(
                f"{path}: lists in or before 'element vertex' are not supported in a binary PLY; "
                "save only the points"
            )
    order = BYTE_ORDERS[header.layout]
    start = header.num_bytes + sum(e.count * e.dtype(order).itemsize for e in before)
    dtype = vertex.dtype(order)
    available = max(0, len(data) - start) // dtype.itemsize
    if available < vertex.count:
        raise cut_short(path, vertex.count, available)
    rows = np.frombuffer(data, dtype, vertex.count, start)
    return np.column_stack([rows[str(column)] for column in columns])


def _parse_header(data: bytes, path: Path) -> _Header:
    if not data.startswith(b"ply"):
        raise InputError(f"{path}: is not a PLY file: it does not start with 'ply'")
    layout = ""
    elements: list[_Element] = []
    position = 0
    for number in range(1, data.count(b"\n") + 2):
        end = data.find(b"\n", position)
        if end < 0:
            break
        words = data[position:end].decode("latin-1").split()
        position = end + 1
        where = f"{path}, line {number}"
        match words:
            case ["end_header"]:
                if not layout:
                    raise InputError(f"{path}: its header has no 'format' line")
                return _Header(layout, tuple(elements), position, number)
            case ["format", name, *_]:
                if name not in BYTE_ORDERS:
                    raise InputError(
                        f"{where}: format {name!r} is not one of {', '.join(BYTE_ORDERS)}"
                    )
                layout = name
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), ()))
            case ["property", "list", _, _, name] if elements:
                elements[-1] = _with_property(elements[-1], name, "")
            case ["property", kind, name] if elements and kind in SCALARS:
                elements[-1] = _with_property(elements[-1], name, SCALARS[kind])
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise InputError(f"{where}: {' '.join(words)[:60]!r} is not a line of a PLY header")
    raise InputError(f"{path}: is cut short: its header has no 'end_header'; copy or save it again")


def _with_property(element: _Element, name: str, kind: str) -> _Element:
    return _Element(element.name, element.count, (*element.properties, (name, kind)))


def _columns(vertex: _Element, wanted: Sequence[str], path: Path) -> tuple[int, ...]:
    found = {name: column for column, (name, kind) in enumerate(vertex.properties) if kind}
    missing = [name for name in wanted if name not in found]
    if missing:
        raise InputError(f"{path}: its vertices have no property {' or '.join(missing)}")
    return tuple(found[name] for name in wanted)


def write_ply(
    path: Path,
    points: Float[Array, "n 3"],
    colors: Float[Array, "n 3"] | None = None,
    extras: Mapping[str, Float[Array, "n"]] | None = None,
) -> None:
    """Write points as a little-endian binary PLY.

    Positions are float32 if that is precise to a tenth of a millimetre, otherwise double.

    Args:
        path: The file; it is overwritten if it exists.
        points: Positions [m].
        colors: Red, green and blue in [0, 1]; written with eight bits each.
        extras: Further numbers of each point, by name; written as float32.
    """
    extras = extras or {}
    wide = bool(len(points)) and float(np.abs(points).max()) > MAX_FLOAT32_EXTENT
    kind, dtype = ("double", "<f8") if wide else ("float", "<f4")
    header = "\n".join(
        [
            "ply",
            "format binary_little_endian 1.0",
            f"element vertex {len(points)}",
            *(f"property {kind} {name}" for name in "xyz"),
            *(f"property uchar {name}" for name in RGB if colors is not None),
            *(f"property float {name}" for name in extras),
            "end_header\n",
        ]
    )
    columns = [points.astype(dtype)]
    if colors is not None:
        columns.append(np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8))
    columns += [values.astype("<f4")[:, None] for values in extras.values()]
    rows = [np.ascontiguousarray(column).view(np.uint8) for column in columns]
    path.write_bytes(header.encode("ascii") + np.hstack(rows).tobytes())


def write_ply_pieces(path: Path, pieces: Iterable[Float[Array, "n 3"]]) -> int:
    """Write points as a little-endian binary PLY of doubles, one array after the other.

    The header is written last, because only then is the number of points known.

    Args:
        path: The file; it is overwritten if it exists.
        pieces: Positions [m], in any number of arrays.

    Returns:
        The number of points.
    """
    count = 0
    with tempfile.TemporaryFile(dir=path.parent) as body:
        for piece in pieces:
            body.write(np.ascontiguousarray(piece, dtype="<f8").tobytes())
            count += len(piece)
        lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
        header = "\n".join([*lines, *(f"property double {name}" for name in "xyz"), "end_header\n"])
        body.seek(0)
        with path.open("wb") as file:
            file.write(header.encode("ascii"))
            shutil.copyfileobj(body, file)
    return count
