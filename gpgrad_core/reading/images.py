"""Camera images, decoded in a process of their own, and grey PNG images of a known size.

The form of a PNG is that of its specification (W3C, third edition): 5 (chunks), 11.2.1 (header),
7.3 and 9 (filtered rows). Of an image whose size is known, nothing larger is ever unpacked.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8, UInt16

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError, readable
from gpgrad_core.reading.decoding import IMAGE_HEAD, LENGTH, MAX_PIXELS, DecodingError, decode_apart
from gpgrad_core.reading.files import open_regular, read_regular

LARGEST = 256_000_000
"""Bytes of a file."""
TOGETHER = 4
"""Files that one process decodes; starting one takes as long as some images."""

PNG = b"\x89PNG\r\n\x1a\n"
HEADER = struct.Struct(">IIBBBBB")  # width, height, bits, colour type, three methods
FILTERS = 5
"""Kinds of filters that a row of a PNG may begin with."""
TRAILER = 65_536
"""Bytes of its own that a camera may put after a JPEG."""

Image = UInt8[NDArray[np.uint8], "rows columns"]


def read_images(files: Sequence[Path], together: int = TOGETHER) -> Iterator[Image]:
    """Read the grey values of PNG, JPEG and what else OpenCV reads; some are decoded together."""
    for file in files:
        with readable(file):
            length = file.stat().st_size
        if length > LARGEST:
            raise InputError(f"{file}: is larger than {LARGEST:,} bytes, the most for an image")
    for first in range(0, len(files), together):
        chosen = files[first : first + together]
        with readable(chosen[0]):
            contents = [read_regular(file) for file in chosen]
        yield from decode_grey(contents, [str(file) for file in chosen])


def _damage(content: bytes) -> str:
    """Name what is wrong with a PNG or JPEG as a whole; OpenCV fills what is missing with grey."""
    if content.startswith(b"\xff\xd8"):
        return "" if b"\xff\xd9" in content[-TRAILER:] else "is cut short: its end mark is missing"
    if not content.startswith(PNG):
        return ""  # another format, if any
    try:
        _png_chunks(content)
    except ValueError as error:
        return str(error)
    return ""


def _png_chunks(content: bytes) -> list[tuple[bytes, bytes]]:
    """Split a PNG into its chunks: kind and content."""
    chunks: list[tuple[bytes, bytes]] = []
    position, kind = len(PNG), b""
    while kind != b"IEND":
        if position + 12 > len(content):
            raise ValueError("is cut short")
        length = int.from_bytes(content[position : position + 4], "big")
        body = content[position + 4 : position + 8 + length]
        position += 12 + length
        if content[position - 4 : position] != zlib.crc32(body).to_bytes(4, "big"):
            raise ValueError("is cut short, or a checksum in it is wrong")
        kind = body[:4]
        chunks.append((kind, body[4:]))
    if position != len(content):
        raise ValueError("holds more than one image")
    return chunks


def decode_grey(contents: Sequence[bytes], names: Sequence[str]) -> Iterator[Image]:
    """Decode grey values of images in one other process; messages use the names."""
    if not contents:
        return
    for name, content in zip(names, contents, strict=True):
        if reason := _damage(content):
            raise InputError(f"{name}: is not an image that can be read: it {reason}")
    packed = b"".join(LENGTH.pack(len(content)) + content for content in contents)
    try:
        decoded = decode_apart("images", packed, len(contents) * (MAX_PIXELS + IMAGE_HEAD.size))
    except DecodingError as error:
        if len(contents) == 1:
            raise InputError(f"{names[0]}: is not an image that can be read: {error}") from None
        for content, name in zip(contents, names, strict=True):  # to find the one to blame
            yield from decode_grey([content], [name])
        return
    position = 0
    for name in names:
        rows, columns = IMAGE_HEAD.unpack_from(decoded, position)
        position += IMAGE_HEAD.size
        if not rows:
            raise InputError(
                f"{name}: is not an image that can be read, or has over {MAX_PIXELS:,} pixels"
            )
        values = np.frombuffer(decoded, np.uint8, rows * columns, position)
        position += rows * columns
        yield values.reshape(rows, columns)


def read_grey_png(
    path: Path, rows: int, columns: int
) -> UInt16[NDArray[np.uint16], "rows columns"]:
    """Read a grey image of a known size."""
    most = _most_bytes(rows, columns)
    with readable(path), open_regular(path) as file:
        content = file.read(most + 1)
    return decode_grey_png(content, rows, columns, str(path))


def _most_bytes(rows: int, columns: int) -> int:
    return 4 * rows * columns + 65_536


def decode_grey_png(
    content: bytes, rows: int, columns: int, path: str
) -> UInt16[NDArray[np.uint16], "rows columns"]:
    """Decode what `read_grey_png` reads; InputError as there, with the path."""
    import cv2  # noqa: PLC0415 - loads slowly, and few recordings have such images

    if len(content) > _most_bytes(rows, columns):
        raise InputError(f"{path}: is larger than an image of {rows} x {columns} pixels can be")
    bits = _check_grey(content, rows, columns, path)
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape != (rows, columns) or image.dtype.itemsize * 8 != bits:
        raise InputError(f"{path}: is not an image that can be read")
    return image.astype(np.uint16)


def _check_grey(content: bytes, rows: int, columns: int, path: str) -> int:
    """Check the whole file; give the bits of a pixel."""
    if not content.startswith(PNG):
        raise InputError(f"{path}: is not a PNG image")
    try:
        chunks = _png_chunks(content)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    bits = _bits(*chunks[0], rows, columns, path)
    row = 1 + columns * bits // 8
    packed = b"".join(body for kind, body in chunks if kind == b"IDAT")
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(packed, rows * row + 1)
    except zlib.error as error:
        raise InputError(f"{path}: cannot be unpacked: {error}") from None
    if len(unpacked) != rows * row or max(unpacked[::row]) >= FILTERS:
        raise InputError(f"{path}: does not hold {rows} rows of {columns} pixels")
    return bits


def _bits(kind: bytes, header: bytes, rows: int, columns: int, path: str) -> int:
    if kind != b"IHDR" or len(header) != HEADER.size:
        raise InputError(f"{path}: does not begin with the header of a PNG image")
    width, height, bits, *rest = HEADER.unpack(header)
    if (height, width) != (rows, columns) or bits not in (8, 16) or rest != [0, 0, 0, 0]:
        raise InputError(
            f"{path}: must be a grey image of {rows} rows and {columns} columns with 8 or 16 bits, "
            f"not interlaced; it has {height} rows, {width} columns and {bits} bits"
        )
    return int(bits)
