"""Grey PNG images of a known size, with 8 or 16 bits, checked before they are decoded.

The form is that of the PNG specification (W3C, third edition): section 5 has the chunks and their
checksums, 11.2.1 the header, 7.3 and 9 the filtered rows. The size of what is unpacked is known
from the header, so nothing larger is ever unpacked.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
from jaxtyping import UInt16

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER = struct.Struct(">IIBBBBB")  # width, height, bits, colour type, three methods
FILTERS = 5
"""Kinds of filters that a row may begin with."""


def read_grey_png(
    path: Path, rows: int, columns: int
) -> UInt16[NDArray[np.uint16], "rows columns"]:
    """Read a grey image of a size that is known.

    Args:
        path: The file.
        rows: Height that the image must have.
        columns: Width that it must have.

    Raises:
        InputError: If it cannot be read, is no such image, or is damaged anywhere.
    """
    import cv2  # noqa: PLC0415 - loads slowly, and few recordings have such images

    most = 4 * rows * columns + 65_536
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(content) > most:
        raise InputError(f"{path}: is larger than an image of {rows} x {columns} pixels can be")
    bits = _check(content, rows, columns, path)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != (rows, columns) or image.dtype.itemsize * 8 != bits:
        raise InputError(f"{path}: is not an image that can be read")
    return image.astype(np.uint16)


def _check(content: bytes, rows: int, columns: int, path: Path) -> int:
    """Check the whole file; give the bits of a pixel."""
    if not content.startswith(SIGNATURE):
        raise InputError(f"{path}: is not a PNG image")
    position, bits, packed, kind = len(SIGNATURE), 0, b"", b""
    while kind != b"IEND":
        if position + 12 > len(content):
            raise InputError(f"{path}: is cut short")
        length = int.from_bytes(content[position : position + 4], "big")
        kind = content[position + 4 : position + 8]
        body = content[position + 4 : position + 8 + length]
        position += 12 + length
        if content[position - 4 : position] != zlib.crc32(body).to_bytes(4, "big"):
            raise InputError(f"{path}: is cut short, or a checksum in it is wrong")
        if not bits:
            bits = _bits(kind, body[4:], rows, columns, path)
        elif kind == b"IDAT":
            packed += body[4:]
    if position != len(content):
        raise InputError(f"{path}: holds more than one image")
    row = 1 + columns * bits // 8
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(packed, rows * row + 1)
    except zlib.error as error:
        raise InputError(f"{path}: cannot be unpacked: {error}") from None
    if len(unpacked) != rows * row or max(unpacked[::row]) >= FILTERS:
        raise InputError(f"{path}: does not hold {rows} rows of {columns} pixels")
    return bits


def _bits(kind: bytes, header: bytes, rows: int, columns: int, path: Path) -> int:
    if kind != b"IHDR" or len(header) != HEADER.size:
        raise InputError(f"{path}: does not begin with the header of a PNG image")
    width, height, bits, *rest = HEADER.unpack(header)
    if (height, width) != (rows, columns) or bits not in (8, 16) or rest != [0, 0, 0, 0]:
        raise InputError(
            f"{path}: must be a grey image of {rows} rows and {columns} columns with 8 or 16 bits, "
            f"not interlaced; it has {height} rows, {width} columns and {bits} bits"
        )
    return int(bits)
