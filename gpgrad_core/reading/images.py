"""Camera images, decoded in a process of their own."""

import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from gpgrad_core.arrays import NDArray
from gpgrad_core.errors import InputError
from gpgrad_core.reading.child import DecodingError, decode_apart
from gpgrad_core.reading.decoders import IMAGE_HEAD, LENGTH, MAX_PIXELS

LARGEST = 256_000_000
"""Bytes of a file."""
TOGETHER = 4
"""Files that one process decodes; starting one takes as long as some images."""

PNG = b"\x89PNG\r\n\x1a\n"
TRAILER = 65_536
"""Bytes of its own that a camera may put after a JPEG."""

Image = UInt8[NDArray[np.uint8], "rows columns"]


def read_images(files: Sequence[Path]) -> Iterator[Image]:
    """Read the grey values of images.

    Args:
        files: PNG, JPEG, and what else OpenCV reads.

    Yields:
        One image after the other.

    Raises:
        InputError: If a file cannot be read, or is no image, or is larger than allowed.
    """
    for file in files:
        try:
            length = file.stat().st_size
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror or error}") from None
        if length > LARGEST:
            raise InputError(f"{file}: is larger than {LARGEST:,} bytes, the most for an image")
    for first in range(0, len(files), TOGETHER):
        yield from _decoded(files[first : first + TOGETHER])


def _damage(content: bytes) -> str:
    """Say what is wrong with a PNG or JPEG as a whole; OpenCV fills what is missing with grey."""
    if content.startswith(b"\xff\xd8"):
        return (
            "" if b"\xff\xd9" in content[-TRAILER:] else "it is cut short: its end mark is missing"
        )
    if not content.startswith(PNG):
        return ""  # another format, if any
    position = len(PNG)
    while position + 12 <= len(content):
        length = int.from_bytes(content[position : position + 4], "big")
        body = content[position + 4 : position + 8 + length]
        position += 12 + length
        if content[position - 4 : position] != zlib.crc32(body).to_bytes(4, "big"):
            return "a checksum in it is wrong"
        if body == b"IEND":
            return "" if position == len(content) else "it holds more than one image"
    return "it is cut short"


def _decoded(files: Sequence[Path]) -> Iterator[Image]:
    try:
        contents = [file.read_bytes() for file in files]
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror or error}") from None
    for file, content in zip(files, contents, strict=True):
        if reason := _damage(content):
            raise InputError(f"{file}: is not an image that can be read: {reason}")
    packed = b"".join(LENGTH.pack(len(content)) + content for content in contents)
    try:
        decoded = decode_apart("images", packed, len(files) * (MAX_PIXELS + IMAGE_HEAD.size))
    except DecodingError as error:
        if len(files) == 1:
            raise InputError(f"{files[0]}: is not an image that can be read: {error}") from None
        for file in files:  # to find the one to blame
            yield from _decoded([file])
        return
    position = 0
    for file in files:
        rows, columns = IMAGE_HEAD.unpack_from(decoded, position)
        position += IMAGE_HEAD.size
        if not rows:
            raise InputError(
                f"{file}: is not an image that can be read, or has over {MAX_PIXELS:,} pixels"
            )
        values = np.frombuffer(decoded, np.uint8, rows * columns, position)
        position += rows * columns
        yield values.reshape(rows, columns)
