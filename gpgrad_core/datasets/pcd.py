"""PCD, the point cloud library's format: ascii, binary and binary_compressed.

Open3D's reader is not used, for the same reasons as with PLY: it silently drops the missing rows
of an ascii file that was cut short, and of such a binary file it returns no points and prints a
warning.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from gpgrad_core.arrays import NDArray
from gpgrad_core.datasets.tables import as_floats, cut_short, read_body
from gpgrad_core.errors import InputError

KINDS = {"F": "f", "I": "i", "U": "u"}
SIZES = {"f": (4, 8), "i": (1, 2, 4, 8), "u": (1, 2, 4, 8)}


def read_pcd(path: Path) -> Float[NDArray[np.floating], "n 3"]:
    """Read the points of a PCD file.

    Args:
        path: The file.

    Returns:
        Positions [m], float32 if they are float32 in the file, otherwise float64.

    Raises:
        InputError: If it is not a PCD file, has no x, y and z, or ends too early.
    """
    data = path.read_bytes()
    header, body_start, num_lines = _parse_header(data, path)
    missing = [name for name in "xyz" if name not in header["FIELDS"]]
    if missing:
        raise InputError(f"{path}: its FIELDS have no {' or '.join(missing)}")
    return as_floats(_read_fields(data, header, body_start, num_lines, "xyz", path))


def read_pcd_colors(path: Path) -> Float[NDArray[np.float64], "n 3"] | None:
    """Read the points' red, green and blue in [0, 1]; None if they have no field ``rgb``.

    The point cloud library packs three bytes into its field ``rgb`` or ``rgba``, which may be
    declared as a float.

    Raises:
        InputError: See `read_pcd`.
    """
    data = path.read_bytes()
    header, body_start, num_lines = _parse_header(data, path)
    name = next((name for name in ("rgb", "rgba") if name in header["FIELDS"]), None)
    if name is None or header["SIZE"][header["FIELDS"].index(name)] != "4":
        return None
    packed = _read_fields(data, header, body_start, num_lines, (name,) * 3, path)[:, 0]
    if header["TYPE"][header["FIELDS"].index(name)] == "F":
        packed = packed.astype(np.float32).view(np.uint32)
    whole = packed.astype(np.int64) & 0xFFFFFF
    return np.column_stack([whole >> 16, (whole >> 8) & 0xFF, whole & 0xFF]) / 255.0


def _read_fields(
    data: bytes,
    header: dict[str, list[str]],
    body_start: int,
    num_lines: int,
    fields: Sequence[str],
    path: Path,
) -> NDArray[Any]:
    """Read three fields of every point."""
    names = header["FIELDS"]
    count = int(header["POINTS"][0])
    counts = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
    layout = header["DATA"][0]
    if layout == "ascii":
        starts = np.concatenate([[0], np.cumsum(counts)])
        x, y, z = (int(starts[names.index(name)]) for name in fields)
        text = data[body_start:].decode("latin-1")
        return read_body(text, count, (x, y, z), path, first_line=num_lines + 1)
    dtype = np.dtype(
        [
            (f"{k}", kind, (repeat,))
            for k, (kind, repeat) in enumerate(zip(_types(header, path), counts, strict=True))
        ]
    )
    columns = [names.index(name) for name in fields]
    body = data[body_start:]
    if layout == "binary":
        if len(body) < count * dtype.itemsize:
            raise cut_short(path, count, len(body) // dtype.itemsize)
        table = np.frombuffer(body, dtype, count)
        return np.column_stack([table[str(column)][:, 0] for column in columns])
    if layout == "binary_compressed":
        return _read_compressed(body, dtype, columns, count, path)
    raise InputError(f"{path}: DATA {layout!r} is not one of ascii, binary, binary_compressed")


def _read_compressed(
    body: bytes, dtype: np.dtype[np.void], columns: list[int], count: int, path: Path
) -> NDArray[Any]:
    """Read the layout that stores the values field by field, compressed by LZF."""
    if len(body) < 8:
        raise InputError(f"{path}: is cut short: its compressed points are missing")
    packed_size, size = (int(word) for word in np.frombuffer(body, "<u4", 2))
    if size != count * dtype.itemsize:
        raise InputError(
            f"{path}: its header promises {count * dtype.itemsize:,} bytes of points, "
            f"the compressed block {size:,}; save it again"
        )
    packed = body[8 : 8 + packed_size]
    if len(packed) < packed_size:
        raise InputError(
            f"{path}: is cut short: it should hold {packed_size:,} bytes of compressed points, "
            f"but it holds {len(packed):,}; copy or save it again"
        )
    unpacked = decompress_lzf(packed, size)
    if len(unpacked) != size:
        raise InputError(f"{path}: its compressed points are damaged; copy or save it again")
    values: list[NDArray[Any]] = []
    for column in columns:
        offset = count * sum(dtype[k].itemsize for k in range(column))
        field, (repeat,) = dtype[column].subdtype or (dtype[column], (1,))
        values.append(np.frombuffer(unpacked, field, count * repeat, offset)[::repeat])
    return np.column_stack(values)


def decompress_lzf(packed: bytes, size: int) -> bytes:
    """Undo LibLZF: runs of literal bytes, and copies of what came before.

    Args:
        packed: The compressed bytes.
        size: The expected number of bytes.

    Returns:
        The uncompressed bytes; their number is not ``size`` if the data is damaged.
    """
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


def _parse_header(data: bytes, path: Path) -> tuple[dict[str, list[str]], int, int]:
    """Return the header's words by keyword, where the body starts, and the header's lines."""
    header: dict[str, list[str]] = {}
    position = number = 0
    while (end := data.find(b"\n", position)) >= 0:
        words = data[position:end].decode("latin-1").split()
        position = end + 1
        number += 1
        if not words or words[0].startswith("#"):
            continue
        header[words[0].upper()] = words[1:]
        if number > 100:  # a PCD header has eleven lines, so this is something else
            break
        if words[0].upper() == "DATA":
            _check_header(header, path)
            return header, position, number
    raise InputError(f"{path}: is not a complete PCD file: its header has no 'DATA' line")


def _check_header(header: dict[str, list[str]], path: Path) -> None:
    for keyword in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA"):
        if not header.get(keyword):
            raise InputError(f"{path}: its PCD header has no {keyword!r} line")
    num_fields = len(header["FIELDS"])
    for keyword in ("SIZE", "TYPE", "COUNT"):
        if len(header.get(keyword, header["FIELDS"])) != num_fields:
            raise InputError(f"{path}: its {keyword} line does not have {num_fields} entries")
    for keyword in ("SIZE", "COUNT", "POINTS"):
        if not all(word.isdecimal() for word in header.get(keyword, [])):
            raise InputError(
                f"{path}: its {keyword} line holds something that is not a whole number"
            )


def _types(header: dict[str, list[str]], path: Path) -> list[str]:
    types: list[str] = []
    for kind, size in zip(header["TYPE"], header["SIZE"], strict=True):
        letter = KINDS.get(kind, "")
        if int(size) not in SIZES.get(letter, ()):
            raise InputError(f"{path}: TYPE {kind} of SIZE {size} is not a number type of PCD")
        types.append(f"<{letter}{size}")
    return types
